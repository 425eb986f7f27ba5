"""What all crowds of live agents share: who is met, dropped or set back, and what fits the model."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol

from wakefold.base.types import Floats
from wakefold.evidence.fix import Fix
from wakefold.service.answers import Answer
from wakefold.service.feed import Observation, Refused
from wakefold.service.remarks import Remarks

if TYPE_CHECKING:
    from wakefold.filters.belief import Belief
    from wakefold.model.model import Model

BACK = 3  # lines of an agent in a row that are earlier than its belief, with rising times: its clock was set right
REMEMBERED = 100_000  # agents dropped that are not counted as new when they come back


class Answered(NamedTuple):
    """An observation, the answer to it, and the belief that it is taken from."""

    seen: Observation
    answer: Answer
    belief: Belief


class Crowd(Protocol):
    """The live agents of a feed: observations in, answers out."""

    model: Model
    levels: Sequence[float]
    horizons: Sequence[float]
    remarks: Remarks
    met: int
    doubting: bool

    def __call__(self, block: Sequence[Observation | Refused]) -> Iterator[list[Answered | Refused]]: ...

    @property
    def place_names(self) -> tuple[str, ...]: ...


class Agents:
    """Who is met, dropped or set back.

    One wrong time far ahead must not silence an agent for good: it starts anew with the third line in a row that is
    earlier than its belief, if the times of the three rise.

    Args:
        model: of the filter.
        levels: metres, of which the likeliest classes are told.
        horizons: seconds, of the forecasts.
        max_agents: beyond that many, the agent unheard of for longest is dropped.
        max_gap: seconds of silence after which an agent starts anew.
        remarks: told of every agent that is dropped, every fix that is off the map, and of fixes in the plane of a
            geodetic model.
    """

    doubting = False  # whether answers tell how likely it is that an agent goes none of the ways known

    def __init__(
        self,
        model: Model,
        levels: Sequence[float],
        horizons: Sequence[float],
        max_agents: int,
        max_gap: float,
        remarks: Remarks,
    ) -> None:
        self.model, self.levels, self.horizons = model, levels, horizons
        self.max_agents, self.max_gap, self.remarks = max_agents, max_gap, remarks
        self._dropped: OrderedDict[str, None] = OrderedDict()  # of them, the last ``REMEMBERED``
        self.met = 0  # agents, each once, but for those dropped so long ago that they are forgotten
        self._earlier: dict[str, tuple[int, float]] = {}  # of live agents: lines in a row before the belief, the last

    def _meet(self, agent: str) -> None:
        """Take note of an agent that is new to the living."""
        self.met += agent not in self._dropped
        self._dropped.pop(agent, None)

    def _drop(self, oldest: str) -> None:
        """Take note that an agent is dropped for others."""
        self._earlier.pop(oldest, None)
        self._dropped[oldest] = None
        if len(self._dropped) > REMEMBERED:
            self._dropped.popitem(last=False)
        self.remarks("agents dropped", f"agent {oldest} dropped: over {self.max_agents:,} live agents (--max-agents)")

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
        tracks = self.model.tracks
        try:
            at = fix.on_plane(tracks.projection, tracks.dim)
        except ValueError as error:
            fields = ("lon", "lat") if fix.position is None else ("x", "y", "z")[: len(fix.position)]
            raise ValueError(f"{', '.join(fields)}: {error}") from None
        if seen.fix.position is not None and tracks.projection is not None:
            how = f"x and y of the fixes are taken as {tracks.projection}, east and north: the model's plane"
            self.remarks.once("plane", how)
        return at

    @property
    def place_names(self) -> tuple[str, ...]:
        """What positions are given in."""
        tracks = self.model.tracks
        return ("lon", "lat") if tracks.projection is not None else ("x", "y", "z")[: tracks.dim]
