"""The live agents of a feed and their beliefs."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from wakefold.base.units import LOST
from wakefold.model.dynamics import MAX_SUBSTEPS
from wakefold.service.answers import Answer, Best, Place
from wakefold.service.feed import Observation

if TYPE_CHECKING:
    from wakefold.filters.belief import Belief
    from wakefold.filters.particles import ParticleFilter
    from wakefold.model.model import Model

    Follower = ParticleFilter[Any]

BACK = 3  # lines of an agent in a row that are earlier than its belief, with rising times: its clock was set right
REMEMBERED = 100_000  # agents dropped that are not counted as new when they come back


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
        say: told of every agent that is dropped, and once if fixes are in the plane of a geodetic model.
    """

    def __init__(
        self,
        filter: Follower,
        levels: Sequence[float],
        horizons: Sequence[float],
        max_agents: int,
        max_gap: float,
        say: Callable[[str], None],
    ) -> None:
        self.filter, self.levels, self.horizons = filter, levels, horizons
        self.max_agents, self.say = max_agents, say
        self.max_gap = min(max_gap, longest_step(filter.model))
        self.live: OrderedDict[str, Belief] = OrderedDict()
        self._dropped: OrderedDict[str, None] = OrderedDict()  # of them, the last ``REMEMBERED``
        self.met = 0  # agents, each once, but for those dropped so long ago that they are forgotten
        self._told_plane = False
        self._earlier: dict[str, tuple[int, float]] = {}  # of live agents: lines in a row before the belief, the last

    def __call__(self, seen: Observation) -> tuple[Answer, Belief]:
        """The belief of the agent after an observation.

        Raises:
            ValueError: the observation does not fit the model or the agent's time; its belief stays as it was.
        """
        coarse, at = seen.coarse(self.filter.model.filtration), self._at(seen)
        before = self.live.get(seen.agent)
        if before is None or before.time is None or self._anew(seen, before.time):
            after = self.filter.start(fix=seen.fix, time=seen.time, agent=seen.agent)
            event = "start" if before is None else "restart"
            if coarse:
                after = self.filter.step(after, coarse, time=seen.time)
        else:
            items = coarse if seen.fix is None else [seen.fix, *coarse]
            after = self.filter.step(before, items, time=seen.time)
            event = "recovery" if after.recoveries > before.recoveries else "step"
        if at is not None and seen.fix is not None:
            sd = self.filter.sd if seen.fix.sd is None else seen.fix.sd
            event = "off-map" if np.linalg.norm(after.mean() - at) > LOST * sd else event
        answer = self._answer(seen, event, after)
        self._keep(seen.agent, after)
        return answer, after

    def _anew(self, seen: Observation, last: float) -> bool:
        """Whether a live agent with a belief of the time ``last`` starts anew: after a long silence, or set back."""
        if seen.time >= last:
            self._earlier.pop(seen.agent, None)
            return seen.time - last > self.max_gap
        count, earlier = self._earlier.get(seen.agent, (0, seen.time))
        count = count + 1 if seen.time > earlier else 1
        self._earlier[seen.agent] = count, seen.time
        return count >= BACK

    def _at(self, seen: Observation) -> np.ndarray | None:
        """Where a fix lies in the plane of the model.

        Raises:
            ValueError: it does not fit the model; the message begins with its fields.
        """
        if seen.fix is None:
            return None
        tracks = self.filter.model.tracks
        try:
            at = seen.fix.on_plane(tracks.projection, tracks.dim)
        except ValueError as error:
            fields = ("lon", "lat") if seen.fix.position is None else ("x", "y", "z")[: len(seen.fix.position)]
            raise ValueError(f"{', '.join(fields)}: {error}") from None
        if seen.fix.position is not None and tracks.projection is not None and not self._told_plane:
            self._told_plane = True
            self.say(f"x and y of the fixes are taken as {tracks.projection}, east and north: the model's plane")
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
            self.say(f"agent {oldest} dropped: over {self.max_agents:,} live agents (--max-agents)")

    def _answer(self, seen: Observation, event: str, belief: Belief) -> Answer:
        levels = []
        for level in self.levels:
            best = next(iter(belief.level(level)))
            levels.append(Best(level, best.class_, best.probability, best.size))
        ahead: list[tuple[float, Place]] = []
        if self.horizons:
            later = self.filter.forecast(belief, self.horizons)
            ahead = [(h, self._place(b)) for h, b in zip(self.horizons, later, strict=True)]
        place = self._place(belief)
        return Answer(seen.agent, seen.stamp, event, place, belief.ess, belief.recoveries, levels, ahead)

    @property
    def place_names(self) -> tuple[str, ...]:
        """What positions are given in."""
        tracks = self.filter.model.tracks
        return ("lon", "lat") if tracks.projection is not None else ("x", "y", "z")[: tracks.dim]

    def _place(self, belief: Belief) -> Place:
        mean, projection = belief.mean(), self.filter.model.tracks.projection
        sd = float(np.sqrt(np.trace(belief.cov()) / len(mean)))
        at = mean if projection is None else projection.to_geodetic(mean)[0]
        return Place(self.place_names, tuple(at.tolist()), sd)


def longest_step(model: Model) -> float:
    """Seconds that a belief can be taken ahead at once."""
    return MAX_SUBSTEPS * model.dynamics.interval
