"""The memory of a model: past states, and forests that find those which are like a state now (docs/trail.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wakefold.base.remember import Remembers
from wakefold.base.types import Floats, Ints, Singles
from wakefold.model.kernels import forest, recall
from wakefold.model.kernels.states import feature_count
from wakefold.model.remembering import (
    COARSEST,
    DAY,
    DEFAULT,
    FEW,
    FINEST,
    HORIZONS,
    MOST,
    UNITS,
    Progress,
    Seen,
    base_lag,
    blocks_of,
    features_of,
    forests_of,
    going_of,
    hidden,
    known_agents,
    lags_of,
    numbers,
    numbers_of,
    targets_of,
    weighed,
)

if TYPE_CHECKING:
    from wakefold.model.filtration import Filtration
    from wakefold.tracks.tracks import Tracks

ARRAYS = (
    "points",
    "begins",
    "going",
    "lags",
    "shares",
    "masses",
    "unusual",
    "doubts",
    "agents",
)  # that are kept on disk
UNKNOWN = 0.1  # share of agents that go none of the ways known, where tracks are too few to learn it


@dataclass(frozen=True, eq=False, repr=False)
class Memory(Remembers):
    """Past states and forests over them.

    Attributes:
        points: ``(S, d)`` metres; of a track one after the other, ``step`` seconds apart. One coordinate gets
            a second, 0.
        begins: ``(M + 1,)`` first state of each track.
        going: ``(S, 2)`` velocity over the base lag, m/s.
        lags: ``(K,)`` seconds before now at which ways are compared. base: number of the one that tells velocity.
        step: seconds between states. unit: seconds; lags and horizons are multiples of it.
        slow: m/s, added to speeds before their logarithm. daily: whether the time of day counts.
        dim: number of coordinates of the tracks.
        ways, own: the forests, of the map and of the own frame.
        shares, masses, unusual, doubts: see ``recall.Past``.
        rank: ``(M,)`` leaf rank of each track.
        agents: ``(A,)`` names of those with several tracks, in order; none where hardly any agent comes back.
    """

    points: Floats
    begins: Ints
    going: Singles
    lags: Floats
    step: float
    unit: float
    base: int
    slow: float
    daily: bool
    dim: int
    ways: recall.Trees
    own: recall.Trees
    shares: Floats
    masses: Floats
    unusual: Floats
    doubts: Floats
    rank: Ints
    agents: NDArray[np.str_]

    @classmethod
    def learn(
        cls, tracks: Tracks, filtration: Filtration, threads: int | None = None, progress: Progress | None = None
    ) -> Memory:
        """Past states of tracks, two forests, and the shares of their members by what they foretell of tracks unknown
        to them.

        Scales come from the tracks: the unit of time is a sixteenth of the median duration, and the velocity that a
        forecast starts from is that over half a unit or one, whichever goes on better.

        Args:
            threads: all cores by default; the result does not depend on it.
            progress: called with the share of the work done, 0 to 1.
        """
        moving = tracks.duration[tracks.duration > 0]
        unit = float(np.median(moving)) / UNITS if len(moving) else 1.0
        total = float(tracks.duration.sum())
        step = max(min(max(total / FEW, unit / FINEST), unit / COARSEST), total / MOST)
        daily = bool(np.ptp(tracks.times) > 0.75 * DAY)
        ahead, lags = unit * np.array(HORIZONS), lags_of(tracks, unit)
        seen = Seen.of(tracks, step, unit, lags)
        base = base_lag(seen, lags, ahead, unit)
        going = going_of(seen.raw, seen.d, lags, base)
        slow = 0.2 * float(np.median(np.sqrt(np.square(going).sum(axis=1)))) or 1.0
        block = blocks_of(tracks.times[tracks.offsets[:-1]])[seen.track]
        agents = known_agents(tracks)
        x = features_of(seen, hidden(numbers_of(tracks, agents))[seen.track], lags, base, slow, daily)
        y = targets_of(seen, lags, base, ahead)
        grown, sees = forests_of(x, y, block, threads, progress)
        made = cls(
            seen.points, seen.begins, going, lags, step, unit, base, slow, daily, tracks.dim, *grown,
            shares=np.tile(np.array(DEFAULT), (1, len(ahead), 1)), masses=np.array([0.3, 0.3, 0.3, 0.1]),
            unusual=np.zeros(1), doubts=np.full(1, UNKNOWN), rank=filtration.rank, agents=agents,
        )  # fmt: skip
        found = weighed(made.past, filtration, seen, x, block, sees)
        return made if found is None else replace(made, **found)

    def extend(self, tracks: Tracks, filtration: Filtration, threads: int | None = None) -> Memory:
        """The memory with more tracks.

        Scales and shares stay, and so do the cuts of the trees, which grow on where new states make leaves large.

        Args:
            tracks: those of this memory, and new ones after them. filtration: of all of them.
        """
        lags, ahead = self.lags, self.unit * np.array(HORIZONS)
        seen, old = Seen.of(tracks, self.step, self.unit, lags), len(self.points)
        who = numbers_of(tracks, self.agents)[seen.track]
        x = features_of(seen, who, lags, self.base, self.slow, self.daily)
        y = targets_of(seen, lags, self.base, ahead)
        grown, _ = forests_of(x, y, np.zeros(len(seen.raw), dtype=np.int64), threads, None, (self.ways, self.own), old)
        going = going_of(seen.raw, seen.d, lags, self.base)
        own = {"points": seen.points, "begins": seen.begins, "going": going, "rank": filtration.rank}
        return replace(self, **own, ways=grown[0], own=grown[1])

    @cached_property
    def past(self) -> recall.Past:
        """What kernels take."""
        track = np.repeat(np.arange(len(self.begins) - 1), np.diff(self.begins)).astype(np.int32)
        left = self.begins[track + 1] - 1 - np.arange(len(track))
        longest = np.argsort(-left, kind="stable").astype(np.int32)
        every = recall.Past(
            self.points, self.going, track, self.begins, self.rank, longest, left[longest], self.step,
            self.lags, self.base, self.slow, self.daily, self.ways, self.own,
            self.unit * np.array(HORIZONS), self.unusual, self.shares, self.masses, self.doubts, self.dim,
        )  # fmt: skip
        fixed = [_fixed(part) if isinstance(part, np.ndarray) else part for part in every]
        past = recall.Past._make(fixed)
        return past._replace(
            ways=recall.Trees._make(map(_fixed, self.ways)), own=recall.Trees._make(map(_fixed, self.own))
        )

    def who(self, agent: str | None) -> float:
        """The number of an agent by its name; -1 if it is not known."""
        return float(numbers(np.array(["" if agent is None else agent]), self.agents)[0])

    @property
    def limit(self) -> float:
        """Seconds ahead that can be asked about: how long the longest track lasts."""
        return float((np.diff(self.begins).max() - 1) * self.step)

    def __repr__(self) -> str:
        trees = len(self.ways.first_node) + len(self.own.first_node) - 2
        return f"Memory({len(self.points):,} states every {self.step:.3g} s, {trees} trees)"

    def packed(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Arrays and JSON metadata that ``unpacked`` takes back."""
        arrays = {name: getattr(self, name) for name in ARRAYS}
        for name, trees in (("ways", self.ways), ("own", self.own)):
            arrays |= {f"{name}_{key}": getattr(trees, key) for key in ("nodes", "rows", "first_node", "first_row")}
        return arrays, {name: getattr(self, name) for name in ("step", "unit", "base", "slow", "daily", "dim")}

    @classmethod
    def unpacked(cls, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any], filtration: Filtration) -> Memory:
        """The memory that ``packed`` took apart.

        Raises:
            ValueError: arrays that do not fit together.
            KeyError, TypeError: something is missing or of another kind.
        """
        own = {name: arrays[name] for name in ARRAYS}
        numbers: dict[str, Any] = {name: float(meta[name]) for name in ("step", "unit", "slow")}
        made = cls(
            **own, **numbers, base=int(meta["base"]), daily=bool(meta["daily"]), dim=int(meta["dim"]),
            rank=filtration.rank, ways=_trees_of(arrays, "ways"), own=_trees_of(arrays, "own"),
        )  # fmt: skip
        made._check(len(filtration))
        return made

    def _check(self, tracks: int) -> None:
        """Refuse what a kernel would read beyond its arrays for.

        Raises:
            ValueError: so it is.
        """
        s, d = self.points.shape
        shapes = {
            "begins": (tracks + 1,), "going": (s, 2), "lags": self.lags.shape[:1], "masses": (recall.MAP + 1,),
            "shares": (len(self.unusual), len(HORIZONS), recall.MEMBERS), "doubts": (len(self.unusual),),
        }  # fmt: skip
        kinds = {"begins": np.int64, "going": np.float32}
        sound = all(getattr(self, name).shape == shape for name, shape in shapes.items())
        numbers = [name for name in ARRAYS if name != "agents"]
        sound = sound and all(getattr(self, name).dtype == kinds.get(name, np.float64) for name in numbers)
        sound = sound and all(np.isfinite(getattr(self, name)).all() for name in numbers)
        sound = sound and self.agents.dtype.kind == "U" and self.agents.ndim == 1
        sound = (
            sound
            and d == max(self.dim, 2)
            and self.dim > 0
            and 0 <= self.base < len(self.lags) - 1
            and len(self.unusual) > 0
        )
        sound = (
            sound
            and self.begins[0] == 0
            and self.begins[-1] == s
            and all(0.0 < x < np.inf for x in (self.step, self.unit, self.slow))
        )
        sound = (
            sound and min(self.shares.min(), self.masses.min()) >= 0 and 0 < self.doubts.min() <= self.doubts.max() < 1
        )
        sums = np.append(self.shares.sum(axis=-1), self.masses.sum())
        sound = sound and bool((abs(sums - 1.0) < 1e-6).all()) and self.masses[-1] > 0 and self.lags[0] > 0
        rising = np.diff(self.begins), np.diff(self.lags), np.diff(self.unusual)
        if not (sound and all((gaps > 0).all() for gaps in rising)):
            raise ValueError("its memory is not a number for each of its states")
        for trees in (self.ways, self.own):
            _check_trees(trees, s, feature_count(d, len(self.lags)))


def _fixed(array: NDArray[Any]) -> NDArray[Any]:
    """The array, read-only, as one that was loaded is: kernels are compiled for one kind alone."""
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view


def _trees_of(arrays: Mapping[str, NDArray[Any]], name: str) -> recall.Trees:
    nodes = arrays[f"{name}_nodes"]
    if nodes.dtype != np.int32 or nodes.ndim != 2 or nodes.shape[1] != 4:
        raise ValueError("its trees are no nodes of four numbers")
    return recall.Trees(
        nodes, nodes.view(np.float32), *(arrays[f"{name}_{key}"] for key in ("rows", "first_node", "first_row"))
    )


def _check_trees(trees: recall.Trees, states: int, features: int) -> None:
    nodes, rows = trees.nodes, trees.rows
    sound = rows.dtype == np.int32 and rows.ndim == 1 and len(rows) > 0 and 0 <= rows.min() <= rows.max() < states
    for first, size in ((trees.first_node, len(nodes)), (trees.first_row, len(rows))):
        sound = sound and first.dtype == np.int64 and first.ndim == 1 and len(first) > 1
        sound = sound and first[0] == 0 and first[-1] == size and bool((np.diff(first) >= 0).all())
    sound = sound and len(trees.first_node) == len(trees.first_row) and bool((np.diff(trees.first_row) > 0).all())
    if sound:
        tree = np.repeat(np.arange(len(trees.first_node) - 1), np.diff(trees.first_node))
        own = np.arange(len(nodes)) - trees.first_node[tree]
        count = np.diff(trees.first_node)[tree]
        left, right = (nodes[:, 0] & forest.LEFT) == 0, (nodes[:, 0] & forest.RIGHT) == 0
        sound = bool((nodes[:, 0] & forest.FEATURE < features).all() and (own + 1 < count)[left].all())
        sound = sound and bool(((nodes[:, 3] > own) & (nodes[:, 3] < count))[right].all())
    if not sound:
        raise ValueError("its trees point beyond themselves")
