"""The live agents of a feed in columns: a block of observations is one compiled call, and so are the answers to it."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from wakefold.base.random import agent_key
from wakefold.base.types import Floats
from wakefold.evidence.evidence import in_order
from wakefold.evidence.fix import Fix, on_plane
from wakefold.filters.kernels import fleet as kernel
from wakefold.filters.kernels.trail import Trails
from wakefold.filters.trail import Trail, TrailBelief
from wakefold.filters.trails import columns
from wakefold.service.agents import Agents, Answered
from wakefold.service.answers import Answer, Best, Place
from wakefold.service.feed import Observation, Refused
from wakefold.service.remarks import Remarks

BLOCK = 128  # observations that are answered together: some tens of milliseconds
FEWEST = 64  # rows that columns begin with


class _Taken(NamedTuple):
    """An observation that fits: its row, whether the agent starts there, and what to call that."""

    seen: Observation
    row: int
    event: str
    at: Floats | None
    sd: float
    reports: list[tuple[tuple[int, int], float]]


class Columns(Agents):
    """Agents followed by a ``Trail``; what is told of each is what its belief tells, to the bit.

    Args:
        filter: takes the steps.
        levels, horizons, max_agents, max_gap, remarks: see ``Agents``.
    """

    doubting = True

    def __init__(
        self,
        filter: Trail,
        levels: Sequence[float],
        horizons: Sequence[float],
        max_agents: int,
        max_gap: float,
        remarks: Remarks,
    ) -> None:
        super().__init__(filter.model, levels, horizons, max_agents, max_gap, remarks)
        self.filter = filter
        self._recoveries: dict[str, int] = {}  # of agents that were ever lost
        self.live: OrderedDict[str, int] = OrderedDict()  # the row of each agent
        self._last: dict[str, float] = {}  # their clocks
        self._trails = columns(FEWEST, self.model.tracks.dim)
        self._free = list(range(FEWEST))[::-1]
        cuts = [self.model.filtration.cuts(float(level)) for level in levels]
        self._cuts = np.concatenate([*cuts, np.zeros(0, dtype=np.int64)]).astype(np.int64)
        self._first_cut = np.append(0, np.cumsum([len(part) for part in cuts])).astype(np.int64)
        self._classes = [self.model.filtration.alive(float(level)) for level in levels]

    def __call__(self, block: Sequence[Observation | Refused]) -> Iterator[list[Answered | Refused]]:
        for begin in range(0, len(block), BLOCK):
            yield self._together(block[begin : begin + BLOCK])

    def belief(self, agent: str) -> TrailBelief:
        """The belief about a live agent."""
        row = self.live[agent]
        return self._belief(Trails._make(column[row : row + 1].copy() for column in self._trails), self._last[agent])

    def _belief(self, trails: Trails, time: float) -> TrailBelief:
        own = self.filter
        return TrailBelief(self.model.filtration, trails, own.memory, time=time, samples=own.samples)

    def _together(self, block: Sequence[Observation | Refused]) -> list[Answered | Refused]:
        tracks = self.model.tracks
        fixes = on_plane([None if isinstance(s, Refused) else s.fix for s in block], tracks.projection, tracks.dim)
        done: list[_Taken | Refused] = []
        for seen, fix in zip(block, fixes, strict=True):
            if isinstance(seen, Refused):
                done.append(seen)
                continue
            try:
                done.append(self._take(seen, fix))
            except ValueError as error:
                done.append(Refused(seen.line, str(error)))
        taken = [one for one in done if not isinstance(one, Refused)]
        answers = iter(self._answered(taken) if taken else [])
        return [one if isinstance(one, Refused) else next(answers) for one in done]

    def _take(self, seen: Observation, fix: Fix | None) -> _Taken:
        """An observation checked, and its agent's row; nothing is changed if it does not fit.

        Raises:
            ValueError: the observation does not fit the model or the agent's time.
        """
        items, at = in_order(seen.coarse(self.model.filtration), self.model.filtration), self._at(seen, fix)
        reports = [self.filter.interval(item, level) for level, item in items if not isinstance(item, Fix)]
        reports = [report for report in reports if report[1] != 1.0]
        last = self._last.get(seen.agent)
        if last is None:
            event = "start"
        elif self._anew(seen, last):
            event = "restart"
        else:
            event = "step"
            if seen.time < last - self.filter.window:
                window = f"{self.filter.window:g} s"
                raise ValueError(f"time: {seen.time:.3f} is more than {window} before the agent's last, {last:.3f}")
        if event == "start":
            self._make_room()
            self.live[seen.agent] = self._free.pop()
            self._meet(seen.agent)
        self.live.move_to_end(seen.agent)
        if event == "step" and seen.time >= (last or 0.0):
            self._earlier.pop(seen.agent, None)
        self._last[seen.agent] = seen.time if event != "step" else max(seen.time, last or seen.time)
        sd = self.filter.sd if fix is None or fix.sd is None else fix.sd
        return _Taken(seen, self.live[seen.agent], event, at, sd, reports)

    def _make_room(self) -> None:
        """A free row for one more agent; of too many the one unheard of for longest goes."""
        if len(self.live) >= self.max_agents:
            oldest, row = self.live.popitem(last=False)
            del self._last[oldest]
            self._recoveries.pop(oldest, None)
            self._free.append(row)
            self._drop(oldest)
        if not self._free:
            old = len(self._trails.fixes)
            more = columns(old, self.model.tracks.dim)
            self._trails = Trails._make(np.concatenate(pair) for pair in zip(self._trails, more, strict=True))
            self._free = list(range(old, 2 * old))[::-1]

    def _answered(self, taken: Sequence[_Taken]) -> list[Answered]:
        """The observations put into the trails, and what is believed after each."""
        n, dim, own, past = len(taken), self.model.tracks.dim, self.filter, self.filter.memory.past
        after, begun = columns(n, dim), np.zeros(n, dtype=bool)
        kernel.follow(self._trails, self._block(taken), own.fastest, after, begun)
        seconds, levels = np.array([0.0, *self.horizons]), len(self.levels)
        means, spreads = np.empty((n, len(seconds), dim)), np.empty((n, len(seconds)))
        best, probability = np.empty((n, levels), dtype=np.int64), np.empty((n, levels))
        tracks, doubts = np.empty(n), np.empty(n)
        kernel.answers(
            after, past, dim, seconds, own.samples, self._cuts, self._first_cut, means, spreads, best, probability,
            tracks, doubts,
        )  # fmt: skip
        projection, names = self.model.tracks.projection, self.place_names
        values = means.reshape(-1, dim)
        spots = (values if projection is None else projection.to_geodetic(values)).tolist()
        sds, doubt, effective = spreads.reshape(-1).tolist(), doubts.tolist(), tracks.tolist()
        out, each = [], len(seconds)
        for i, one in enumerate(taken):
            places = [Place(names, tuple(spots[k]), sds[k]) for k in range(i * each, (i + 1) * each)]
            tops = [self._best(level, int(best[i, level]), float(probability[i, level])) for level in range(levels)]
            event = "recovery" if begun[i] else one.event
            lost = self._lost(one, bool(begun[i]))
            later = list(zip(self.horizons, places[1:], strict=True))
            row = Answer(
                one.seen.agent, one.seen.stamp, event, places[0], effective[i], lost, tops, later, none=doubt[i]
            )
            belief = self._belief(Trails._make(column[i : i + 1] for column in after), float(after.clock[i]))
            out.append(Answered(one.seen, row, belief))
        return out

    def _lost(self, one: _Taken, begun: bool) -> int:
        """How often the agent was lost so far."""
        count = begun + (self._recoveries.pop(one.seen.agent, 0) if one.event == "step" else 0)
        if count:
            self._recoveries[one.seen.agent] = count
        return count

    def _best(self, level: int, number: int, probability: float) -> Best:
        first = self._first_cut[level] + number
        size = int(self._cuts[first + 1] - self._cuts[first])
        return Best(float(self.levels[level]), int(self._classes[level][number]), probability, size)

    def _block(self, taken: Sequence[_Taken]) -> kernel.Block:
        dim = self._trails.points.shape[2]
        positions, reports = np.zeros((len(taken), dim)), [report for one in taken for report in one.reports]
        for i, one in enumerate(taken):
            if one.at is not None:
                positions[i, : len(one.at)] = one.at
        fresh = np.array([one.event != "step" for one in taken])
        keys, who = np.zeros((len(taken), 2), dtype=np.uint64), np.zeros(len(taken))
        for i in np.flatnonzero(fresh).tolist():
            keys[i] = agent_key(self.filter.seed, taken[i].seen.agent)
            who[i] = self.filter.memory.who(taken[i].seen.agent)
        return kernel.Block(
            np.array([one.row for one in taken]), fresh, keys, who, np.array([one.seen.time for one in taken]),
            np.array([one.at is not None for one in taken]), positions, np.array([one.sd for one in taken]),
            np.append(0, np.cumsum([len(one.reports) for one in taken])),
            np.array([report[0] for report in reports], dtype=np.int64).reshape(-1, 2),
            np.array([report[1] for report in reports], dtype=np.float64),
        )  # fmt: skip
