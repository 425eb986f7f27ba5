"""New tracks for a model: shaped as its own were, named so that no name is used twice."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from wakefold.base.types import Bools, Ints
from wakefold.base.wording import counted
from wakefold.model.filtration import Filtration
from wakefold.tracks.projection import YEAR
from wakefold.tracks.tracks import Tracks

CUTS = {"max_gap": 1800.0, "max_speed": None, "stop_radius": None, "stop_time": None}  # of `Tracks.segment`
SHAPING: dict[str, float | None] = {**CUTS, "min_length": 0.0, "spacing": None}  # what `wakefold learn` does by itself
_PIECE = re.compile(r"(.*)#(\d+)", re.DOTALL)


def shaped(new: Tracks, known: Tracks, shaping: Mapping[str, Any]) -> Tracks:
    """Tracks as they were read, cut and resampled as the tracks of a model were, in their plane.

    Args:
        new: one track an agent.
        known: those of the model.
        shaping: of the model; what it does not tell is as ``wakefold learn`` does it, with the median spacing of
            ``known``.

    Raises:
        ValueError: planar tracks for a geodetic model, the other way round, or other coordinates.
    """
    new, how = on_plane(new, known), {**SHAPING, **shaping}
    cuts = {name: how[name] for name in CUTS}
    if any(value is not None for value in cuts.values()):
        new = new.segment(**cuts)
    new = new.filter(min_length=how["min_length"] or 0.0)
    again = _known_already(new, known)
    if again.any():
        note = f"extend: {counted(again.sum(), 'track')} left out, of agents and times that the model has"
        new = replace(new.select(~again), notes=(*new.notes, note))
    if not len(new):
        return new
    spacing = how["spacing"] or known.median_spacing
    new = replace(new, ids=_numbered_on(new.ids.tolist(), known.ids.tolist()))
    return new.resample(spacing=spacing) if spacing > 0 else new  # NaN where no track has two points


def on_plane(new: Tracks, known: Tracks) -> Tracks:
    """New tracks in the plane of those known.

    Raises:
        ValueError: planar tracks for a geodetic model, the other way round, or other coordinates.
    """
    if (new.projection is None) != (known.projection is None) or new.dim != known.dim:
        kinds = [f"{t.dim}-D, with {'x and y' if t.projection is None else 'lon and lat'}" for t in (new, known)]
        raise ValueError(f"the new tracks are {kinds[0]}, those of the model {kinds[1]}")
    return new if known.projection is None else new.project(known.projection)


def recent(tracks: Tracks, age: float) -> Bools:
    """``(M,)`` whether a track ends at most ``age`` seconds before the last to end.

    Raises:
        ValueError: times that are no dates.
    """
    earliest = float(tracks.times.min())
    if earliest < YEAR:
        raise ValueError(f"the times of the tracks are no dates (the earliest is {earliest:g} s): none of them is old")
    ends = tracks.times[tracks.offsets[1:] - 1]
    return ends >= ends.max() - age


def carried(old: Filtration, new: Filtration, classes: Ints) -> Ints:
    """What classes of one filtration are in another, any shape; -1 where it has none of the tracks.

    A single track is the track of the same id. Any other class becomes the smallest that holds all those of its tracks
    that are there.
    """
    asked, back = np.unique(classes, return_inverse=True)
    numbers = new.numbers
    found = np.full(len(asked), -1)
    for k, c in enumerate(asked.tolist()):
        ids = old.ids[old.members(c)].tolist()
        tracks = [numbers[name] for name in ids if name in numbers]
        if tracks:
            ranks = new.rank[tracks]
            joined = float(new.gaps[ranks.min() : ranks.max()].max(initial=0.0))
            found[k] = tracks[0] if len(tracks) == 1 else new.ancestor(tracks[0], joined)
    return found[back].reshape(np.shape(classes))


def _known_already(new: Tracks, known: Tracks) -> Bools:
    """``(K,)`` whether a track shares some time with one of the same agent; of times that are no dates none does."""
    again = np.zeros(len(new), dtype=bool)
    if not len(new) or min(new.times.min(), known.times.min()) < YEAR:
        return again
    theirs = _agents(known)
    spans = defaultdict(list)
    for i in np.flatnonzero(np.isin(theirs, _agents(new))).tolist():
        spans[theirs[i]].append(known.times_of(i)[[0, -1]])
    for k, agent in enumerate(_agents(new).tolist()):
        if agent in spans:
            begin, end = new.times_of(k)[[0, -1]]
            begins, ends = np.transpose(spans[agent])
            again[k] = ((begin < ends) & (begins < end)).any()
    return again


def _agents(tracks: Tracks) -> np.ndarray:
    return tracks.attributes.get("agent", tracks.ids).astype(np.str_)


def _numbered_on(new: list[str], known: list[str]) -> np.ndarray:
    """Ids of pieces, "NAME#k", counted on from the last piece of the same name that is known."""
    bases = {match[1] for name in new if (match := _PIECE.fullmatch(name))}
    first: dict[str, int] = {}
    for name in known:
        match = _PIECE.fullmatch(name)
        if match and match[1] in bases:
            first[match[1]] = max(first.get(match[1], 0), int(match[2]) + 1)
    out = []
    for name in new:
        match = _PIECE.fullmatch(name)
        out.append(f"{match[1]}#{int(match[2]) + first.get(match[1], 0)}" if match else name)
    return np.array(out, dtype=np.str_)
