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
from wakefold.service.agents import Agents, Answered
from wakefold.service.answers import Answer, Best, Place
from wakefold.service.feed import Observation, Refused
from wakefold.service.remarks import Remarks

if TYPE_CHECKING:
    from wakefold.filters.belief import Belief
    from wakefold.filters.particles import ParticleFilter
    from wakefold.model.model import Model

    Follower = ParticleFilter[Any]

WAIT = 0.05  # seconds that an answer may wait for others


class _Step(NamedTuple):
    """What came of an observation; ``spots`` are where the agent is now and at each horizon, metres, and its sd."""

    seen: Observation
    event: str
    belief: Belief
    best: Sequence[Best]
    spots: Sequence[tuple[Floats, float]]


class Fleet(Agents):
    """Agents followed one by one, each with a belief of its own.

    Args:
        filter: takes the steps.
        levels, horizons, max_agents, max_gap, remarks: see ``Agents``.
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
        super().__init__(filter.model, levels, horizons, max_agents, min(max_gap, longest_step(filter.model)), remarks)
        self.filter = filter
        self.live: OrderedDict[str, Belief] = OrderedDict()

    def __call__(self, block: Sequence[Observation | Refused]) -> Iterator[list[Answered | Refused]]:
        """Answers to observations, in order; of each agent one after the other.

        They come in lists, each with what was worked out within ``WAIT`` seconds. An observation that does not fit the
        model or the agent's time is refused and leaves the agent's belief as it was. What was refused before passes.
        """
        tracks = self.model.tracks
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
        coarse, at = seen.coarse(self.model.filtration), self._at(seen, fix)
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

    def _keep(self, agent: str, belief: Belief) -> None:
        if agent not in self.live:
            self._meet(agent)
        self._earlier.pop(agent, None)
        self.live[agent] = belief
        self.live.move_to_end(agent)
        if len(self.live) > self.max_agents:
            self._drop(self.live.popitem(last=False)[0])

    def _answers(self, done: Sequence[_Step | Refused]) -> list[Answered | Refused]:
        """What has been done, as answers: all positions go to longitudes and latitudes at once."""
        spots = [spot for one in done if not isinstance(one, Refused) for spot in one.spots]
        projection, names = self.model.tracks.projection, self.place_names
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


def _spot(belief: Belief) -> tuple[Floats, float]:
    """Where an agent is held to be, in the plane, and the standard deviation per axis."""
    mean = belief.mean()
    return mean, float(np.sqrt(np.trace(belief.cov()) / len(mean)))


def longest_step(model: Model) -> float:
    """Seconds that a belief can be taken ahead at once."""
    return MAX_SUBSTEPS * model.dynamics.interval
