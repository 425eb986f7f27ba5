"""The live agents of a feed and their beliefs."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from itertools import islice
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from wakefold.base.types import Floats
from wakefold.base.units import LOST
from wakefold.evidence.fix import Fix, on_plane
from wakefold.model.dynamics import MAX_SUBSTEPS
from wakefold.service.answers import Answer, Best, Place
from wakefold.service.feed import Observation, Refused
from wakefold.service.remarks import Remarks

if TYPE_CHECKING:
    from wakefold.filters.belief import Belief
    from wakefold.filters.particles import ParticleFilter
    from wakefold.model.model import Model

    Follower = ParticleFilter[Any]

BACK = 3  # lines of an agent in a row that are earlier than its belief, with rising times: its clock was set right
WAIT = 0.05  # seconds that an answer may wait for others
REMEMBERED = 100_000  # agents dropped that are not counted as new when they come back


class Answered(NamedTuple):
    """An observation, the answer to it, and the belief that it is taken from."""

    seen: Observation
    answer: Answer
    belief: Belief


class _Step(NamedTuple):
    """What came of an observation; ``spots`` are where the agent is now and at each horizon, metres, and its sd."""

    seen: Observation
    event: str
    belief: Belief
    best: Sequence[Best]
    spots: Sequence[tuple[Floats, float]]


class Crowd:
    """The live agents of a feed and their beliefs.

    One wrong time far ahead must not silence an agent for good: it starts anew with the third line in a row that is
    earlier than its belief, if the times of the three rise.

    Args:
        filter: takes the steps.
        levels: metres, of which the likeliest classes are told.
        horizons: seconds, of the forecasts.
        max_agents: beyond that many, the agent unheard of for longest is dropped.
        max_gap: seconds of silence after which an agent starts anew.
        remarks: told of every agent that is dropped, every fix that is off the map, and of fixes in the plane of a
            geodetic model.
    """

    def __init__(
        self,
        filter: Follower,
        levels: Sequence[float],
        horizons: Sequence[float],
        max_agents: int,
        max_gap: float,
        remarks: Remarks,
    ) -> None:
        self.filter, self.levels, self.horizons = filter, levels, horizons
        self.max_agents, self.remarks = max_agents, remarks
        self.max_gap = min(max_gap, longest_step(filter.model))
        self.live: OrderedDict[str, Belief] = OrderedDict()
        self._dropped: OrderedDict[str, None] = OrderedDict()  # of them, the last ``REMEMBERED``
        self.met = 0  # agents, each once, but for those dropped so long ago that they are forgotten
        self._earlier: dict[str, tuple[int, float]] = {}  # of live agents: lines in a row before the belief, the last

    def __call__(self, block: Sequence[Observation | Refused]) -> Iterator[list[Answered | Refused]]:
        """Answers to observations, in order; of each agent one after the other.

        They come in lists, each with what was worked out within ``WAIT`` seconds. An observation that does not fit the
        model or the agent's time is refused and leaves the agent's belief as it was. What was refused before passes.
        """
        tracks = self.filter.model.tracks
        fixes = on_plane([None if isinstance(s, Refused) else s.fix for s in block], tracks.projection, tracks.dim)
        done: list[_Step | Refused] = []
        begin = monotonic()
        for seen, fix in zip(block, fixes, strict=True):
            if isinstance(seen, Refused):
                done.append(seen)
                continue
            try:
                done.append(self._step(seen, fix))
            except ValueError as error:
                done.append(Refused(seen.line, str(error)))
            if monotonic() - begin > WAIT:
                yield self._answers(done)
                done, begin = [], monotonic()
        if done:
            yield self._answers(done)

    def _step(self, seen: Observation, fix: Fix | None) -> _Step:
        """The belief of the agent after an observation; the fix lies in the plane of the model.

        Raises:
            ValueError: the observation does not fit the model or the agent's time; its belief stays as it was.
        """
        coarse, at = seen.coarse(self.filter.model.filtration), self._at(seen, fix)
        before = self.live.get(seen.agent)
        if before is None or before.time is None or self._anew(seen, before.time):
            after = self.filter.start(fix=fix, time=seen.time, agent=seen.agent)
            event = "start" if before is None else "restart"
            if coarse:
                after = self.filter.step(after, coarse, time=seen.time)
        else:
            items = coarse if fix is None else [fix, *coarse]
            after = self.filter.step(before, items, time=seen.time)
            event = "recovery" if after.recoveries > before.recoveries else "step"
        spots = [_spot(after)]
        if at is not None and fix is not None:
            sd = self.filter.sd if fix.sd is None else fix.sd
            event = "off-map" if np.linalg.norm(spots[0][0] - at) > LOST * sd else event
        best = [Best(b, r.class_, r.probability, r.size) for b in self.levels for r in [next(iter(after.level(b)))]]
        if self.horizons:
            spots += [_spot(later) for later in self.filter.forecast(after, self.horizons)]
        self._keep(seen.agent, after)
        if event == "off-map":
            what = f"line {seen.line}: agent {seen.agent} is off the map, over {LOST:g} sd from its fix"
            self.remarks("fixes off the map", what)
        return _Step(seen, event, after, best, spots)

    def _anew(self, seen: Observation, last: float) -> bool:
        """Whether a live agent with a belief of the time ``last`` starts anew: after a long silence, or set back."""
        if seen.time >= last:
            self._earlier.pop(seen.agent, None)
            return seen.time - last > self.max_gap
        count, earlier = self._earlier.get(seen.agent, (0, seen.time))
        count = count + 1 if seen.time > earlier else 1
        self._earlier[seen.agent] = count, seen.time
        return count >= BACK

    def _at(self, seen: Observation, fix: Fix | None) -> Floats | None:
        """Where the fix of an observation lies in the plane of the model.

        Raises:
            ValueError: it does not fit the model; the message begins with its fields.
        """
        if seen.fix is None or fix is None:
            return None
        tracks = self.filter.model.tracks
        try:
            at = fix.on_plane(tracks.projection, tracks.dim)
        except ValueError as error:
            fields = ("lon", "lat") if fix.position is None else ("x", "y", "z")[: len(fix.position)]
            raise ValueError(f"{', '.join(fields)}: {error}") from None
        if seen.fix.position is not None and tracks.projection is not None:
            how = f"x and y of the fixes are taken as {tracks.projection}, east and north: the model's plane"
            self.remarks.once("plane", how)
        return at

    def _keep(self, agent: str, belief: Belief) -> None:
        if agent not in self.live and agent not in self._dropped:
            self.met += 1
        self._dropped.pop(agent, None)
        self._earlier.pop(agent, None)
        self.live[agent] = belief
        self.live.move_to_end(agent)
        if len(self.live) > self.max_agents:
            oldest, _ = self.live.popitem(last=False)
            self._earlier.pop(oldest, None)
            self._dropped[oldest] = None
            if len(self._dropped) > REMEMBERED:
                self._dropped.popitem(last=False)
            self.remarks(
                "agents dropped", f"agent {oldest} dropped: over {self.max_agents:,} live agents (--max-agents)"
            )

    def _answers(self, done: Sequence[_Step | Refused]) -> list[Answered | Refused]:
        """What has been done, as answers: all positions go to longitudes and latitudes at once."""
        spots = [spot for one in done if not isinstance(one, Refused) for spot in one.spots]
        projection, names = self.filter.model.tracks.projection, self.place_names
        values = np.array([mean for mean, _ in spots])
        if projection is not None and spots:
            values = projection.to_geodetic(values)
        places = (Place(names, tuple(at), sd) for at, (_, sd) in zip(values.tolist(), spots, strict=True))
        out: list[Answered | Refused] = []
        for one in done:
            if isinstance(one, Refused):
                out.append(one)
                continue
            seen, event, belief, best, own = one
            now, *ahead = islice(places, len(own))
            later = list(zip(self.horizons, ahead, strict=True))
            row = Answer(seen.agent, seen.stamp, event, now, belief.ess, belief.recoveries, best, later)
            out.append(Answered(seen, row, belief))
        return out

    @property
    def place_names(self) -> tuple[str, ...]:
        """What positions are given in."""
        tracks = self.filter.model.tracks
        return ("lon", "lat") if tracks.projection is not None else ("x", "y", "z")[: tracks.dim]


def _spot(belief: Belief) -> tuple[Floats, float]:
    """Where an agent is held to be, in the plane, and the standard deviation per axis."""
    mean = belief.mean()
    return mean, float(np.sqrt(np.trace(belief.cov()) / len(mean)))


def longest_step(model: Model) -> float:
    """Seconds that a belief can be taken ahead at once."""
    return MAX_SUBSTEPS * model.dynamics.interval
