"""How well the ships of the demo are followed: every method is asked the same questions about the same voyages.

Of a voyage a fix is given at most every two minutes. After each fix but the first a method says where the ship is at
the AIS positions before the next fix, which it is never shown, and where it will be in 5 and 15 minutes, as long as the
voyage lasts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from wakefold.base.parallel import thread_map
from wakefold.base.types import Floats
from wakefold.tracks.tracks import Tracks

EVERY = 120.0  # seconds between fixes at least
HORIZONS = (300.0, 900.0)
HEADING = np.cos(np.radians(45.0))  # the nearest track must go about the same way


class Question(NamedTuple):
    """What is asked after a fix.

    Attributes:
        row: of the fix, within the voyage.
        ahead: ``(n,)`` seconds after the fix, rising.
        truth: ``(n, 2)`` where the ship was then, metres.
        kind: ``(n,)`` 0 for an AIS position that is not shown, otherwise the horizon.
    """

    row: int
    ahead: Floats
    truth: Floats
    kind: Floats


Method = Callable[[str, Floats, Floats, Sequence[Question]], Iterator[Floats]]
"""From the name, positions ``(n, 2)`` and times ``(n,)`` of a voyage to an answer ``(n, 2)`` for each question, for
which it reads the rows of the voyage up to the question's."""


def questions(points: Floats, times: Floats) -> list[Question]:
    """One for every fix that is given, the first among them (it asks nothing)."""
    rows = [0]
    for row in range(1, len(times)):
        if times[row] - times[rows[-1]] >= EVERY:
            rows.append(row)
    out = []
    for row, following in zip(rows, [*rows[1:], len(times)], strict=True):
        now = times[row]
        hidden = times[row + 1 : following] - now
        later = np.array([h for h in HORIZONS if now + h <= times[-1]])
        ahead = np.concatenate([hidden, later])
        kind = np.concatenate([np.zeros(len(hidden)), later])
        order = np.argsort(ahead, kind="stable") if row else []  # a first fix tells no velocity: nothing is asked
        ahead, kind = ahead[order], kind[order]
        truth = np.stack([np.interp(now + ahead, times, points[:, axis]) for axis in (0, 1)], axis=1)
        out.append(Question(row, ahead, truth, kind))
    return out


def errors(method: Method, voyages: Tracks, progress: Callable[[float], None] | None = None) -> dict[float, Floats]:
    """Distances from the truth, metres, of all answers about all voyages: by kind of question."""

    def one(i: int) -> tuple[Floats, Floats]:
        points, times = voyages[i], voyages.times_of(i)
        asked = questions(points, times)
        given = method(str(voyages.ids[i]), points, times, asked)
        off = [np.linalg.norm(answer - ask.truth, axis=1) for ask, answer in zip(asked, given, strict=True)]
        return np.concatenate([ask.kind for ask in asked]), np.concatenate(off)

    found = thread_map(one, range(len(voyages)), progress=progress)
    kinds, off = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return {kind: off[kinds == kind] for kind in (0.0, *HORIZONS)}


def summary(found: Mapping[str, Mapping[float, Floats]]) -> list[dict[str, Any]]:
    """A row for each method: mean and median of its errors, metres, and their number."""
    names = {0.0: "between fixes", **{h: f"in {h / 60:.0f} min" for h in HORIZONS}}
    return [
        {
            "method": method,
            **{
                names[kind]: {"mean": float(off.mean()), "median": float(np.median(off)), "answers": len(off)}
                for kind, off in by_kind.items()
            },
        }
        for method, by_kind in found.items()
    ]
