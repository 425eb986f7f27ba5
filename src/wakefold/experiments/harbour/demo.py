"""The demo: learn a week of New York Harbor ship traffic, follow the ships of the day after (docs/demo.md).

The data are the AIS tracks that come with the PyPI package ``tracktable-data``. Nothing of 8 December is used to learn
or to choose a setting: the settings below were chosen on 7 December by ``python -m benchmarks.demo_settings``.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from wakefold import plot
from wakefold.base.types import Floats
from wakefold.evidence.coarse import CONFIDENCE, CoarseClass
from wakefold.evidence.fix import Fix
from wakefold.experiments.harbour.report import report_page
from wakefold.filters.belief import Belief
from wakefold.filters.bootstrap import BL1, BL2
from wakefold.filters.mhpf import MHPF
from wakefold.filters.trail import Trail
from wakefold.forecast.followed import Filter
from wakefold.forecast.methods import NAMES
from wakefold.forecast.questions import ask
from wakefold.forecast.rivals import ConstantVelocity
from wakefold.forecast.score import EVERY, score
from wakefold.io import read_tracks
from wakefold.model.linkage.distance import distances_from
from wakefold.model.model import Model, learn
from wakefold.tracks.tracks import Tracks

WEEK, DAY = "NYHarbor_2020_12_first_week.traj", "NYHarbor_2020_12_08.traj"
SEED = 8
SPACING = 200.0  # metres between the points of a learned track
EPSILON = 300.0  # metres
SCALE, SD = 8.0, 50.0  # m/sqrt(s), metres; chosen on 7 December
PARTICLES, DEPLETION = 500, 0.0009  # so small a share redraws no class at random, but lets a recovery find any
LEVELS = 3
HORIZONS = (300.0, 900.0)  # seconds: of the ship that is shown
FOLLOWER = "Trail"  # the filter that is shown


class Step(NamedTuple):
    """One step of the followed voyage.

    Attributes:
        time: seconds UTC.
        evidence: "fix" or what was reported.
        best: (class, probability, tracks) at each level, coarsest last.
        belief: after the evidence.
        truth: ``(2,)`` metres.
        position_error: of the estimate after the evidence, metres.
        ahead: by horizon, s: error of the forecast and of constant velocity, metres; where the voyage lasts that long.
    """

    time: float
    evidence: str
    best: list[tuple[int, float, int]]
    belief: Belief
    truth: Floats
    position_error: float
    ahead: dict[float, tuple[float, float]]


def data(name: str) -> Path:
    """A file of New York Harbor AIS in the installed package ``tracktable-data``.

    Raises:
        ImportError: the package is not installed.
    """
    try:
        return Path(str(resources.files("tracktable_data") / "python_example_data" / name))
    except ModuleNotFoundError:
        raise ImportError('the demo needs its sample data: pip install "wakefold[demo]"') from None


def voyages(tracks: Tracks) -> Tracks:
    """Tracks cut where a ship is silent for 30 minutes or lies within 150 m for 10; those of 2 km and more."""
    pieces = tracks.segment(max_gap="30min", stop_radius="150m", stop_time="10min", min_points=3)
    return pieces.filter(min_length="2km")


def week() -> Tracks:
    """The voyages of 1 to 7 December 2020."""
    return voyages(read_tracks(data(WEEK))[0])


def day_after(past: Tracks) -> Tracks:
    """The voyages of 8 December in the plane of the past ones; none may share a moment with them.

    Raises:
        ValueError: a voyage began before the last of the past ones ended.
    """
    assert past.projection is not None
    held_out = voyages(read_tracks(data(DAY))[0]).project(past.projection)
    if held_out.times.min() <= past.times.max():
        raise ValueError("a held-out voyage begins within the training week")
    return held_out


def teach(past: Tracks, scale: float = SCALE) -> Model:
    """The model of voyages; ``scale`` of the motion noise, m/sqrt(s)."""
    return learn(past.resample(spacing=SPACING), epsilon=EPSILON, scale=scale)


def filters(model: Model) -> dict[str, Filter]:
    """The filters whose settings were chosen on 7 December, by the names of the methods."""
    settings: dict[str, Any] = {"depletion": DEPLETION, "sd": SD, "seed": SEED}
    return {
        "BL1": BL1(model, PARTICLES, **settings),
        "BL2": BL2(model, **settings),  # slow: fewer particles
        "MHPF": MHPF(model, PARTICLES, levels=[], **settings),  # levels do not change the base estimate
        "Trail": Trail(model, seed=SEED),
    }


def chosen(held_out: Tracks) -> int:
    """The voyage that is followed in the pictures: of those of one to two hours, the one that gets farthest."""
    fits = (held_out.duration >= 3600) & (held_out.duration <= 7200)
    ends = np.stack([held_out.points[held_out.offsets[:-1]], held_out.points[held_out.offsets[1:] - 1]])
    return int(np.argmax(np.where(fits, np.linalg.norm(ends[1] - ends[0], axis=1), -1.0)))


def destined(model: Model, voyage: Floats, level: float) -> int:
    """The class at a level of the past voyage that is nearest to the whole of this one: a truthful coarse report."""
    whole = Tracks.from_arrays([voyage]).resample(spacing=SPACING)
    away = distances_from(whole, model.tracks, np.arange(len(model.tracks)))
    return model.filtration.class_at(int(np.argmin(away)), level)


def follow(model: Model, voyage: Tracks) -> list[Step]:
    """Follow one voyage with a fix every two minutes and, on departure, the report of its class at the coarsest level.

    Returns:
        a step for the prior (class and position unknown), one for each fix, one for the report.
    """
    tree, name = model.filtration, str(voyage.ids[0])
    levels = tree.levels(LEVELS).tolist()
    f: Any = filters(model)[FOLLOWER]
    truly = CoarseClass(destined(model, voyage[0], levels[-1]), levels[-1], CONFIDENCE)
    asked = ask(voyage, HORIZONS, EVERY, 0.0)
    places, times = asked.fixes.points, asked.fixes.times.tolist()
    naive = ConstantVelocity(EVERY).ensemble(asked)[:, :, 0]

    def step(belief: Belief, row: int, evidence: str, ahead: dict[float, tuple[float, float]]) -> Step:
        point = places[row]
        best = [next(iter(belief.level(b))) for b in levels]
        off = float(np.linalg.norm(belief.mean() - point))
        classes = [(b.class_, b.probability, b.size) for b in best]
        return Step(times[row], evidence, classes, belief, point, off, ahead)

    out = [step(f.start(time=times[0], agent=name), 0, "nothing yet", {})]
    belief = f.start(fix=Fix(places[0]), time=times[0], agent=name)
    out.append(step(belief, 0, "fix", {}))
    belief = f.step(belief, [truly], dt=0.0)
    out.append(step(belief, 0, f"bound for class {truly.class_}", {}))
    for row in range(1, len(times)):
        belief = f.step(belief, [Fix(places[row])], time=times[row])
        ahead = {}
        for q in np.flatnonzero(asked.row == row):
            for h in np.flatnonzero(np.isfinite(asked.truth[q, :, 0])):
                ours, truth = f.forecast(belief, float(asked.horizons[h])).mean(), asked.truth[q, h]
                off = [float(np.linalg.norm(place - truth)) for place in (ours, naive[q, h])]
                ahead[float(asked.horizons[h])] = (off[0], off[1])
        out.append(step(belief, row, "fix", ahead))
    return out


def run(out: Path, progress: Callable[..., None], show: Callable[[str], None]) -> dict[str, Any]:
    """The whole demo: learn, follow, score, draw, write ``report.html`` into the directory ``out``.

    Args:
        progress: told the share done.
        show: told every line of text.

    Returns:
        all numbers, in plain types.

    Raises:
        ImportError: the sample data are not installed.
    """
    begin = time.perf_counter()
    out.mkdir(parents=True, exist_ok=True)
    past = week()
    held_out = day_after(past)
    progress(0.05)
    model = teach(past)
    tree = model.filtration
    show(f"learned  {len(past):,} voyages of 1-7 December 2020, New York Harbor: {model!r}")
    progress(0.15)
    one = chosen(held_out)
    name, points, times = str(held_out.ids[one]), held_out[one], held_out.times_of(one)
    steps = follow(model, held_out.select([one]))
    progress(0.3)
    show(f"followed {name}, 8 December: {held_out.length[one] / 1000:.1f} km, a fix every {EVERY / 60:.0f} min")
    levels = tree.levels(LEVELS).tolist()
    for line in table(steps, levels):
        show(line)

    methods: dict[str, Any] = {**dict.fromkeys(NAMES), **filters(model)}
    scores = score(
        model, held_out, methods=methods, levels=levels, seed=SEED, progress=lambda share: progress(0.3 + 0.6 * share)
    )
    show(f"\nall {len(held_out)} voyages of 8 December, seed {SEED}\n{scores.table()}")
    told = scores.to_dict()
    (out / "scores.json").write_text(json.dumps(told, indent=1, allow_nan=False), encoding="utf-8")

    pictures, drawn = draw(out, model, steps, levels, points, times)
    results = {
        "learned": {"voyages": len(past), "points": len(model.tracks.points), "classes": len(tree.birth)},
        "settings": {
            "epsilon": EPSILON,
            "scale": SCALE,
            "sd": SD,
            "particles": PARTICLES,
            "depletion": DEPLETION,
            "confidence": CONFIDENCE,
            "seed": SEED,
        },
        "held_out": {"voyages": len(held_out), "fixes": len(scores.asked.fixes.points)},
        "levels": levels,
        "followed": {"voyage": name, "steps": [_plain(step) for step in steps]},
        "forecast_at": drawn,
        "scores": told,
        "verdict": scores.verdict(),
        "seconds": round(time.perf_counter() - begin, 1),
    }
    page = out / "report.html"
    page.write_text(report_page(results, pictures), encoding="utf-8")
    progress(1.0)
    show(f"\nwrote {page} ({results['seconds']:.0f} s)")
    return results


def table(steps: list[Step], levels: list[float]) -> list[str]:
    """The followed voyage in lines of text."""
    head = f"{'time':<9}{'evidence':<22}"
    head += "".join(f"{f'level {level:,.0f} m':>16}" for level in levels)
    head += f"{'error':>9}" + "".join(f"{f'in {h / 60:.0f} min':>10}{'(c.v.)':>10}" for h in HORIZONS)
    lines = ["class and probability per level; error in metres now and ahead, beside it constant velocity (c.v.)", head]
    for step in steps:
        line = f"{_clock(step.time)} {step.evidence:<22}"
        line += "".join(f"{c:>9} {p:>6.1%}" for c, p, _ in step.best) + f"{step.position_error:>9,.0f}"
        for horizon in HORIZONS:
            ours, naive = step.ahead.get(horizon, (None, None))
            line += "".join(f"{'' if off is None else f'{off:,.0f}':>10}" for off in (ours, naive))
        lines.append(line.rstrip())
    return lines


def draw(
    out: Path, model: Model, steps: list[Step], levels: list[float], points: Floats, times: Floats
) -> tuple[dict[str, Path], str]:
    """The pictures, by name: the tree, the belief over time and level, a forecast; and the time of the forecast."""
    tracks, tree = model.tracks, model.filtration
    shown = [0, 1, 2, *np.linspace(4, len(steps) - 1, 3).astype(int).tolist()]  # what is seen, then how it went
    moments = []
    for i in shown:
        step = steps[i]
        tables = {b: (t.classes, t.probability) for b in levels for t in [step.belief.level(b)]}
        seen = np.reshape([s.truth for s in steps[: i + 1] if s.evidence == "fix"], (-1, 2))
        guess = step.belief.mean() if i else None
        moments.append(plot.Moment(step.time, tables, estimate=guess, truth=step.truth, observed=seen))
    last = next(i for i, step in enumerate(steps) if i > len(steps) / 4 and len(step.ahead) == len(HORIZONS))
    fixes = np.array([step.truth for step in steps[: last + 1] if step.evidence == "fix"])
    now, before = steps[last], steps[last - 1]
    velocity = (now.truth - before.truth) / (now.time - before.time)
    f: Any = filters(model)[FOLLOWER]
    ahead = []
    for h, later in zip(HORIZONS, f.forecast(now.belief, list(HORIZONS)), strict=True):
        there = np.array([np.interp(now.time + h, times, points[:, axis]) for axis in (0, 1)])
        ahead.append(plot.Ahead(h, later.points, later.weights, there, now.truth + h * velocity))
    rest = points[(times >= now.time) & (times <= now.time + HORIZONS[-1])]
    figures = {
        "tree": plot.filtration(tracks, tree),
        "belief": plot.beliefs(tracks, tree, moments),
        "forecast": plot.forecast(tracks, fixes, ahead, truth=rest),
    }
    paths = {name: out / f"{name}.png" for name in figures}
    for name, figure in figures.items():
        plot.save(figure, paths[name])
    return paths, _clock(now.time)


def _clock(time: float) -> str:
    return f"{datetime.fromtimestamp(time, UTC):%H:%M:%S}"


def _plain(step: Step) -> dict[str, Any]:
    return {
        "time": datetime.fromtimestamp(step.time, UTC).isoformat(),
        "evidence": step.evidence,
        "best": [{"class": c, "probability": round(p, 4), "tracks": n} for c, p, n in step.best],
        "ess": round(step.belief.ess, 1),
        "recoveries": step.belief.recoveries,
        "position_error": round(step.position_error, 1),
        "forecast_error": {
            f"{h / 60:.0f} min": {FOLLOWER: round(a, 1), "constant velocity": round(b, 1)}
            for h, (a, b) in step.ahead.items()
        },
    }
