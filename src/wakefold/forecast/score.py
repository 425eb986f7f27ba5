"""``wakefold.score``: every method is asked the same questions about held-out tracks."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from wakefold.base.parallel import Progress
from wakefold.base.types import Floats, Ints
from wakefold.base.units import Duration, seconds
from wakefold.base.wording import counted, duration_text
from wakefold.forecast import classes
from wakefold.forecast.classes import Ledger
from wakefold.forecast.followed import Filter
from wakefold.forecast.methods import CONSTANT_VELOCITY, NAMES, SLOW, Method, answered, of_filter
from wakefold.forecast.questions import Questions, Which, ask, thinning
from wakefold.forecast.samples import SAMPLES, Judged, judged
from wakefold.forecast.scores import Scores
from wakefold.forecast.workshop import Workshop
from wakefold.model.model import Model
from wakefold.tracks.tracks import Tracks

SHIPS = (300.0, 900.0, 1800.0, 3600.0)  # horizons of geodetic tracks, seconds
EVERY = 120.0  # seconds between the fixes of a ship
PARTS = (1 / 8, 1 / 4, 1 / 2, 1.0)  # horizons of other tracks: of their median duration
FIXES = 25  # of another track of median duration
AGE = 4  # times between fixes, of other tracks, from which on questions are asked
LEVELS = 3
SLOW_TRACKS, SLOW_MOMENTS = 50, 200  # about which slow filters are asked
ROOM = 20_000_000  # numbers in the samples that are held at once


def score(
    model: Model,
    tracks: Tracks,
    *,
    horizons: Sequence[Duration] | None = None,
    every: Duration | None = None,
    after: Duration | None = None,
    questions: Which = "all",
    levels: Sequence[float] | None = None,
    methods: Sequence[str] | Mapping[str, Filter | None] | None = None,
    whole: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> Scores:
    """How well each method tells where the agents of held-out tracks will be, and which class a track is of.

    See docs/forecasts.md for what is asked and how it is scored.

    Args:
        model: learned from other tracks.
        tracks: held out, as they were recorded, in two coordinates; of the model's kind, geodetic or planar.
        horizons: seconds ahead, or such as "5min"; by default 5, 15, 30 and 60 minutes for geodetic tracks, an eighth,
            a quarter, a half and all of the median duration for others.
        every: time between fixes at least; by default 2 minutes for geodetic tracks, for others a 25th of the
            median duration in whole sampling intervals, one at least.
        after: age of a track from which on questions are asked; by default 2 minutes for geodetic tracks, for others
            four times ``every``.
        questions: "all", or the "first" of each track alone.
        levels: of classes, metres; three picked by entropy by default.
        methods: names of ``wakefold.forecast.methods.NAMES``, all by default; or filters by a name, taken as they are
            and scored beside constant velocity. A value may be None for a method of that name.
        whole: ask slow filters (``SLOW``) everything too; otherwise they are asked after 200 fixes of 50 tracks.
        seed: of the filters and of the intervals.
        progress: called with the share of the work done, 0 to 1.

    Raises:
        ValueError: tracks of another kind than the model's, nothing to ask about them, or a setting out of range.
    """
    held_out = _on_plane(model, tracks)
    ship = held_out.projection is not None
    step = seconds(every) if every is not None else EVERY if ship else _usual(held_out)
    if not (math.isfinite(step) and step > 0):
        raise ValueError("every must be above 0, and tracks of single points have no sampling interval: give it")
    age = seconds(after) if after is not None else EVERY if ship else AGE * step
    ahead = [seconds(h) for h in horizons] if horizons is not None else SHIPS if ship else from_durations(held_out)
    if not len(ahead) or min(ahead) <= 0:
        raise ValueError("horizons must be above 0, and one at least")
    asked = ask(held_out, ahead, step, age, questions)
    if not len(asked):
        raise ValueError(
            f"nothing can be asked: none of {counted(len(tracks), 'track')} goes on for {duration_text(min(ahead))} "
            f"after a fix at an age of {duration_text(age)} or more; give shorter horizons"
        )
    heights = model.filtration.levels(LEVELS).tolist() if levels is None else sorted({float(b) for b in levels})
    tell = progress or _silent
    shop = Workshop(model, (asked.horizons.tolist(), step, age, questions), heights, seed)
    made = _made(shop, methods, lambda share: tell(0.3 * share))
    truth = classes.nearest_past(model, held_out) if heights else np.zeros(len(held_out), dtype=np.int64)
    found: dict[str, Found] = {}
    for number, method in enumerate(made):

        def rest(share: float, number: int = number) -> None:
            tell(0.3 + 0.7 * (number + share) / len(made))

        slow = method.name in SLOW and not whole
        some, moments, which = _some(asked) if slow else (asked, asked.row, np.arange(len(truth)))
        ledgers = [Ledger(model.filtration, truth[which[tracks]], heights) for tracks in _parts(some)]
        each = _found(method, made[0], some, ledgers, rest)
        found[method.name] = _scattered(each, asked, moments, which) if slow else each
    told = {name: each.classes for name, each in found.items() if np.isfinite(each.classes).any()}
    if heights:
        told["prior"] = classes.prior(model.filtration, truth, heights)
    asks = f"a fix every {duration_text(step)} at least, asked from {duration_text(age)} on"
    terms = {"every": step, "from": age, "which": questions, "asks": asks}
    return Scores(
        asked,
        terms,
        {name: each.judged for name, each in found.items()},
        {name: each.unanswered for name, each in found.items()},
        tuple(heights),
        told,
        {name: each.speed for name, each in found.items()},
        {method.name: method.setting for method in made if method.setting},
        {method.name: partial(_again, method) for method in made},
        (*shop.notes, *_overlap(model.tracks, held_out), *_sparse(held_out, asked)),
        seed,
        "m" if ship else "units",
    )


def _usual(tracks: Tracks) -> float:
    """Seconds between fixes: about a 25th of the median duration, in whole sampling intervals."""
    interval = tracks.median_interval
    if not interval > 0:  # NaN of single points
        return math.nan
    return interval * max(1, round(float(np.median(tracks.duration)) / FIXES / interval))


def from_durations(tracks: Tracks) -> list[float]:
    """Horizons, seconds: parts of the median duration, each rounded to two figures."""
    middle = float(np.median(tracks.duration))
    return sorted({float(f"{middle * part:.2g}") for part in PARTS if middle > 0})


def _again(method: Method, asked: Questions) -> Floats:
    return method.answer(asked, None)


def _silent(share: float) -> None:
    pass


def _on_plane(model: Model, tracks: Tracks) -> Tracks:
    place = model.tracks.projection
    if not len(tracks):
        raise ValueError("no tracks to ask about")
    if (place is None) != (tracks.projection is None):
        kinds = ("planar", "geodetic") if place is None else ("geodetic", "planar")
        raise ValueError(f"the model was learned from {kinds[0]} tracks, these are {kinds[1]}")
    if (dim := tracks.dim) != 2 or model.tracks.dim != 2:
        raise ValueError(f"scores are of positions in the plane: these tracks have {dim} coordinates, not 2")
    return tracks if place is None else tracks.project(place)


def _overlap(past: Tracks, tracks: Tracks) -> list[str]:
    """A note if agents of the held-out tracks were learned from at the same time."""
    spans = [_spans(past), _spans(tracks)]
    shared = sum(
        any(a <= d and c <= b for a, b in spans[0][name] for c, d in spans[1][name])
        for name in spans[0].keys() & spans[1].keys()
    )
    if not shared:
        return []
    agents = counted(shared, "agent")
    return [f"{agents} of these tracks, and their times, are in the model too: scores on what was learned flatter"]


def _sparse(tracks: Tracks, asked: Questions) -> list[str]:
    """A note if positions are so rare that truths lie on straight lines that nobody may have gone."""
    if not tracks.median_interval > asked.horizons[0]:
        return []
    every = duration_text(tracks.median_interval)
    return [f"positions are {every} apart (median): what is asked in less lies on straight lines between them"]


def _spans(tracks: Tracks) -> dict[str, list[tuple[float, float]]]:
    """Begin and end of the tracks of each agent."""
    out: dict[str, list[tuple[float, float]]] = {}
    names = np.asarray(tracks.attributes.get("agent", tracks.ids)).astype(str).tolist()
    for name, begin, end in zip(names, tracks.offsets[:-1], tracks.offsets[1:], strict=True):
        out.setdefault(name, []).append((float(tracks.times[begin]), float(tracks.times[end - 1])))
    return out


def _made(
    shop: Workshop, methods: Sequence[str] | Mapping[str, Filter | None] | None, progress: Progress
) -> list[Method]:
    """The methods asked for; constant velocity is always the first, as it stands for answers that are not given."""
    given = methods if isinstance(methods, Mapping) else dict.fromkeys(NAMES if methods is None else methods)
    given = {CONSTANT_VELOCITY: None, **given}
    named = [name for name, filter in given.items() if filter is None]
    if unknown := [name for name in named if name not in NAMES]:
        raise ValueError(f"there is no method {unknown[0]!r}: there are {', '.join(NAMES)}")
    made = {method.name: method for method in shop.make(named, progress)}
    return [made[name] if filter is None else of_filter(name, filter) for name, filter in given.items()]


def _parts(asked: Questions) -> list[Ints]:
    """The tracks in parts whose samples are held in memory at once."""
    most = max(1, ROOM // (asked.fixes.dim * SAMPLES * len(asked.horizons)))  # moments
    before = np.searchsorted(asked.track, np.arange(len(asked.fixes)))
    return [np.flatnonzero(before // most == k) for k in np.unique(before // most)]


class Found(NamedTuple):
    """What one method was found to be worth; see ``Scores``."""

    judged: Judged
    unanswered: Ints
    classes: Floats
    speed: float


def _found(method: Method, plain: Method, asked: Questions, ledgers: list[Ledger], progress: Progress) -> Found:
    """Ask one method, a part of the tracks at a time."""
    method.answer(asked.of(asked.track[:1]).thinned(1), None)  # compiles and builds indices, once
    scores, missing, spent, parts = [], [], 0.0, _parts(asked)
    for k, (tracks, ledger) in enumerate(zip(parts, ledgers, strict=True)):
        some = asked.of(tracks)
        begin = time.process_time()
        samples = method.answer(some, ledger if ledger.levels else None)
        spent += time.process_time() - begin
        samples, unanswered = answered(samples, some, lambda some=some: plain.answer(some, None))
        missing.append(unanswered)
        scores.append(judged(samples, some.truth))
        progress((k + 1) / len(parts))
    every = Judged(*(np.concatenate(each) for each in zip(*scores, strict=True)))
    book = np.concatenate([ledger.found for ledger in ledgers])
    told = int(np.isfinite(book[:, :, :1, classes.TRUE]).sum())
    speed = float(asked.asked.sum() + told) / spent if spent > 0 else math.nan
    return Found(every, np.sum(missing, axis=0), book, speed)


def _some(asked: Questions) -> tuple[Questions, Ints, Ints]:
    """The questions that slow filters are asked, and which moments and tracks of all they are."""
    tracks = thinning(len(asked.fixes), SLOW_TRACKS)
    moments = np.flatnonzero(np.isin(asked.track, tracks))
    few = asked.of(tracks)
    kept = thinning(len(few), SLOW_MOMENTS)
    return few.thinned(SLOW_MOMENTS), moments[kept], tracks


def _scattered(found: Found, asked: Questions, moments: Ints, tracks: Ints) -> Found:
    """The same with NaN for what a slow filter was not asked."""

    def spread(values: Floats, rows: Ints, count: int) -> Floats:
        out = np.full((count, *values.shape[1:]), np.nan)
        out[rows] = values
        return out

    every = Judged(*(spread(values, moments, len(asked)) for values in found.judged))
    return found._replace(judged=every, classes=spread(found.classes, tracks, len(asked.fixes)))
