"""The trail filter: past states that are like an agent's own, and what became of them (docs/trail.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Self, overload

import numpy as np
from numpy.typing import NDArray

from wakefold.base.random import agent_key
from wakefold.base.types import Floats, Ints
from wakefold.base.units import Time, timestamp
from wakefold.evidence.coarse import CoarseClass
from wakefold.evidence.evidence import Evidence, in_order
from wakefold.evidence.fix import Fix
from wakefold.filters.belief import Belief, Estimate
from wakefold.filters.kernels import trail as kernel
from wakefold.filters.kernels.fleet import effective
from wakefold.filters.kernels.trail import Trails
from wakefold.filters.trails import LEAST_ODDS, columns, copied, unpacked
from wakefold.model.memory import Memory

if TYPE_CHECKING:
    from wakefold.model.filtration import Filtration
    from wakefold.model.model import Model

SAMPLES = 100
FASTER = 3.0  # times the fastest past state is more than an agent can go
_ONE = np.zeros(1, dtype=np.int64)


class TrailBelief(Belief):
    """Of ``Trail``: the agent's own trail. What follows from it is worked out when it is asked for.

    Attributes:
        trails: its row of columns, (1, ...); see ``filters.kernels.trail.Trails``.
        memory: of the model it is asked of; None of a belief just loaded: ``on`` or a step gives it one.
        ahead: seconds after the clock of the trail that the belief is about; above 0 it is a forecast.
        samples: number of positions that stand for it.
    """

    filter = "Trail"
    trails: Trails
    memory: Memory | None
    ahead: float
    samples: int

    def __init__(
        self,
        tree: Filtration,
        trails: Trails,
        memory: Memory | None,
        *,
        time: float | None = None,
        ahead: float = 0.0,
        recoveries: int = 0,
        samples: int = SAMPLES,
    ) -> None:
        if memory is not None and memory.points.shape[1] != trails.points.shape[2]:
            raise ValueError(f"the belief has {trails.points.shape[2]} coordinates, the memory {memory.dim}")
        own = vars(self)
        own |= {"tree": tree, "trails": trails, "memory": memory, "time": time, "ahead": ahead}
        own |= {"recoveries": recoveries, "samples": samples, "ignored": 0}
        own |= {"key": trails.key[0], "step": int(trails.step[0])}

    def _past(self) -> Any:
        if self.memory is None:
            raise ValueError("this belief was loaded without its model: take it on by belief.on(model)")
        return self.memory.past

    @cached_property
    def _drawn(self) -> tuple[Floats, Ints]:
        past = self._past()
        out = np.empty((1, 1, self.samples, past.points.shape[1]))
        taken = np.empty((1, 1, self.samples), dtype=np.int64)
        kernel.ahead(self.trails, _ONE, past, np.full((1, 1), self.ahead), out, taken)
        return out[0, 0], taken[0, 0]

    @cached_property
    def points(self) -> Floats:  # pyright: ignore[reportIncompatibleVariableOverride]
        """``(N, d)`` positions drawn, each as likely as the others, metres."""
        return self._drawn[0][:, : self._past_dim]

    @property
    def _past_dim(self) -> int:
        assert self.memory is not None
        return self.memory.dim

    @cached_property
    def classes(self) -> Ints:  # pyright: ignore[reportIncompatibleVariableOverride]
        """``(N,)`` single track that each position was drawn from."""
        return self._past().track[self._drawn[1]].astype(np.int64)

    @cached_property
    def log_weights(self) -> Floats:  # pyright: ignore[reportIncompatibleVariableOverride]
        """``(N,)``, all the same."""
        return np.full(self.samples, -math.log(self.samples))

    @cached_property
    def _masses(self) -> Floats:
        out = np.empty((1, len(self.tree)))
        kernel.masses(self.trails, _ONE, self._past(), out)
        return out[0]

    @cached_property
    def _sums(self) -> tuple[Floats, float]:
        return np.concatenate([[0.0], np.cumsum(self._masses)]), 0.0

    @property
    def ess(self) -> float:
        """Effective number of tracks that the agent may be on."""
        return float(effective(self._masses))

    @cached_property
    def _none(self) -> float:
        out = np.empty(1)
        kernel.none(self.trails, _ONE, self._past(), out)
        return float(out[0])

    def probability(self, class_: int | None) -> float:
        """Probability of one class, given that the agent goes a way like one known; of None: that it does not.

        Raises:
            ValueError: no such class.
        """
        return self._none if class_ is None else super().probability(class_)

    @cached_property
    def ended(self) -> float:
        """Probability that the voyage has ended by now, or by the time a forecast is about: the agent is at rest, gone
        or out of the area. The positions of a forecast are those in case that it has not.
        """
        out = np.empty((1, 1))
        kernel.ended(self.trails, _ONE, self._past(), np.full((1, 1), self.ahead), out)
        return float(out[0, 0])

    @cached_property
    def log_evidence(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Log-density of the fixes that the trail keeps, each foretold from those kept before it."""
        out = np.empty(1)
        kernel.evidence(self.trails, _ONE, self._past(), out)
        return float(out[0])

    @property
    def log_evidence_since(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The same: a trail begins where the agent was last lost and found again."""
        return self.log_evidence

    def cov(self, estimate: Estimate = "base", *, level: float | None = None) -> Floats:
        """Covariance ``(d, d)`` of the position, square metres: of the positions drawn, and of the last fix."""
        cov = super().cov(estimate, level=level)
        return cov + np.eye(len(cov)) * float(self.trails.sd[0]) ** 2 if self.trails.fixes[0] else cov

    def forecast(self, horizon: float) -> TrailBelief:
        """The belief about so many seconds from now, as ``Trail.forecast`` gives it.

        Raises:
            ValueError: seconds that are negative or not finite.
        """
        if not 0.0 <= horizon < math.inf:
            raise ValueError(f"horizon must be a finite number of seconds >= 0, got {horizon}")
        then = None if self.time is None else self.time + horizon
        return self._of(self.trails, ahead=self.ahead + horizon, time=then)

    def _of(self, trails: Trails, **changed: Any) -> TrailBelief:
        kept = {name: getattr(self, name) for name in ("time", "ahead", "recoveries", "samples")}
        return TrailBelief(self.tree, trails, changed.pop("memory", self.memory), **{**kept, **changed})

    def on(self, model: Model) -> Self:
        """The same trail before the memory of another model: this one extended, say, or without its old tracks.

        Reports that were made about classes of the old tree are forgotten if the new tree has no such class.
        """
        from wakefold.model.growth import carried

        own, told = copied(self.trails), 0
        for r in range(int(own.told[0]) if model.filtration is not self.tree else 0):
            lo, hi = own.reports[0, r].tolist()
            old = int(np.flatnonzero((self.tree.lo == lo) & (self.tree.hi == hi))[0])
            new = int(carried(self.tree, model.filtration, np.array([old]))[0])
            if new >= 0:
                own.reports[0, told] = model.filtration.lo[new], model.filtration.hi[new]
                own.odds[0, told] = own.odds[0, r]
                told += 1
        if model.filtration is not self.tree:
            own.told[0] = told
        moved: Any = TrailBelief(
            model.filtration, own, model.memory, time=self.time, ahead=self.ahead, recoveries=self.recoveries,
            samples=self.samples,
        )  # fmt: skip
        return moved

    def _arrays(self) -> dict[str, NDArray[Any]]:
        return {**self.trails._asdict(), "settings": np.array([self.ahead, self.samples], dtype=np.float64)}

    def _meta(self) -> dict[str, Any]:
        return {"step": self.step, "time": self.time, "recoveries": self.recoveries, "ignored": 0}

    @classmethod
    def _stored(cls, tree: Filtration, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> TrailBelief:
        """The belief that was stored so.

        Raises:
            KeyError, TypeError, ValueError: something is missing or unsound.
        """
        trails = unpacked(arrays, tree)
        ahead, samples = arrays["settings"].tolist()
        if not (0.0 <= ahead < math.inf and 2 <= samples < 2**31):
            raise ValueError("its settings are out of range")
        time = None if meta["time"] is None else float(meta["time"])
        return cls(tree, trails, None, time=time, ahead=ahead, recoveries=int(meta["recoveries"]), samples=int(samples))

    def __repr__(self) -> str:
        if self.memory is None or not self.trails.fixes[0]:
            return f"TrailBelief({int(self.trails.fixes[0])} fixes, step {self.step})"
        where = ", ".join(f"{x:.1f}" for x in self.mean())
        return f"TrailBelief({int(self.trails.fixes[0])} fixes, step {self.step}, at ({where}), none {self._none:.2f})"


class Trail:
    """A filter without particles: the belief is the agent's own trail; past tracks that came the same way say the rest.

    Args:
        model: what ``wakefold.learn`` made; its memory is learned now if it has none.
        samples: positions that stand for a forecast.
        sd: of a fix that does not tell its own, metres; the model's by default.
        seed: of all agents' random streams.

    Raises:
        ValueError: a setting out of range; the message names it.
    """

    kind = TrailBelief

    def __init__(self, model: Model, samples: int = SAMPLES, *, sd: float | None = None, seed: int = 0) -> None:
        if isinstance(samples, bool) or not isinstance(samples, (int, np.integer)) or samples < 2:
            raise ValueError(f"samples must be a whole number of at least 2, got {samples}")
        sd = model.sd if sd is None else sd
        if not 0.0 < sd < math.inf:
            raise ValueError(f"sd must be a positive number of metres, got {sd}")
        self.model, self.memory = model, model.memory
        self.samples, self.sd, self.seed = int(samples), float(sd), int(seed)
        speeds = np.sqrt(np.square(self.memory.going.astype(np.float64)).sum(axis=1))
        self.fastest = FASTER * float(np.quantile(speeds, 0.999))

    @property
    def window(self) -> float:
        """Seconds that a fix may be late and is still put in its place."""
        return float(self.memory.past.lags[-1])

    @property
    def limit(self) -> float:
        """Seconds ahead that a forecast may be asked for: as long as the longest past track lasts."""
        return self.memory.limit

    def start(
        self,
        *,
        fix: Fix | None = None,
        at: Literal["any"] = "any",
        time: Time | None = None,
        agent: str | None = None,
    ) -> TrailBelief:
        """The belief about an agent just met: its first fix, or that it may be anywhere along the past tracks.

        Args:
            fix: the first.
            at: only "any".
            time: of the belief, seconds UTC, a date, datetime or datetime64, or ISO 8601 text.
            agent: a name; agents of different names draw different random numbers from the same seed.
        """
        if at != "any":
            raise ValueError(f"at must be 'any' for a Trail, got {at!r}")
        trails = columns(1, self.model.tracks.dim)
        trails.key[0], trails.who[0] = agent_key(self.seed, agent), self.memory.who(agent)
        now = None if time is None else timestamp(time)
        trails.clock[0] = 0.0 if now is None else now
        if fix is not None:
            self._put(trails, fix, trails.clock[0])
        return TrailBelief(self.model.filtration, trails, self.memory, time=now, samples=self.samples)

    def step(
        self,
        belief: Belief,
        evidence: Sequence[Evidence] = (),
        dt: float | None = None,
        *,
        time: Time | None = None,
    ) -> TrailBelief:
        """The belief after ``dt`` seconds (or at ``time``) and the evidence; no evidence is a missing observation.

        A time before the belief's, by ``window`` at most, is that of late evidence: its fixes are put in their place
        and the belief is about the same time as before.

        Raises:
            ValueError, TypeError: evidence that does not fit the model, or a time that runs back by more.
        """
        own = self._own(belief)
        items = in_order(evidence, self.model.filtration)
        trails = copied(own.trails)
        trails.clock[0] += own.ahead
        at, now = self._moment(own, trails, dt, time)
        trails.step[0] += 1
        trails.clock[0] = max(float(trails.clock[0]), at)
        lost = False
        for level, item in items:
            if isinstance(item, Fix):
                lost |= self._put(trails, item, at)
            else:
                interval, odds = self.interval(item, level)
                if odds != 1.0:
                    kernel.report(trails, 0, *interval, odds)
        return own._of(trails, time=now, ahead=0.0, recoveries=own.recoveries + lost, memory=self.memory)

    def _moment(
        self, belief: TrailBelief, trails: Trails, dt: float | None, time: Time | None
    ) -> tuple[float, float | None]:
        """The time of evidence by the clock of the trail, and that of the belief after it."""
        if (dt is None) == (time is None):
            raise ValueError("step takes either dt or time")
        clock = float(trails.clock[0])
        if dt is not None:
            if not (0.0 <= dt < math.inf and clock + dt < math.inf):
                raise ValueError(f"dt must be a finite number of seconds >= 0, got {dt}")
            return clock + float(dt), None if belief.time is None else clock + float(dt)
        at = timestamp(time)  # pyright: ignore[reportArgumentType]
        if belief.time is None:  # it was never told a time: the trail so far moves there
            shift = at - clock
            trails.times[0] += shift
            trails.clock[0] += shift
            return at, at
        if at < clock - self.window:
            raise ValueError(
                f"time runs backwards: evidence of {at:.3f} is more than {self.window:g} s before {clock:.3f}"
            )
        return at, max(at, clock)

    def _put(self, trails: Trails, fix: Fix, at: float) -> bool:
        """Put a fix in its place; whether the agent was lost at it."""
        position = np.zeros(trails.points.shape[2])
        position[: self.model.tracks.dim] = fix.on_plane(self.model.tracks.projection, self.model.tracks.dim)
        return bool(kernel.put(trails, 0, float(at), position, self.sd if fix.sd is None else fix.sd, self.fastest))

    def interval(self, item: CoarseClass, level: float) -> tuple[tuple[int, int], float]:
        """The leaf ranks of the class of a report, and the odds of each other class of the level against it."""
        tree = self.model.filtration
        others = len(tree.cuts(level)) - 2
        if others == 0:
            return (0, len(tree)), 1.0
        odds = (1.0 - item.confidence) / (others * item.confidence)
        return (int(tree.lo[item.class_]), int(tree.hi[item.class_])), min(max(odds, LEAST_ODDS), 1.0 / LEAST_ODDS)

    @overload
    def forecast(self, belief: Belief, horizon: float) -> TrailBelief: ...
    @overload
    def forecast(self, belief: Belief, horizon: Sequence[float]) -> list[TrailBelief]: ...
    def forecast(self, belief: Belief, horizon: float | Sequence[float]) -> TrailBelief | list[TrailBelief]:
        """The belief about ``horizon`` seconds from now, in case that the agent is still on its way then.

        Several horizons, in rising order, give a list of beliefs.

        Raises:
            ValueError: horizons that fall or are negative, or beyond ``limit``.
        """
        own = self._own(belief)
        one = isinstance(horizon, (int, float))
        horizons, before = [float(horizon)] if one else [float(h) for h in horizon], 0.0
        for h in horizons:
            if not before <= h <= self.limit:
                if h > self.limit:
                    raise ValueError(f"{h:g} s is too far ahead: no past track lasts longer than {self.limit:g} s")
                raise ValueError(f"horizons must be seconds >= 0 in rising order, got {h} after {before}")
            before = h
        out = [own.forecast(h) for h in horizons]
        return out[0] if one else out

    def _own(self, belief: Belief) -> TrailBelief:
        """Refuse a belief of another kind of filter, or about other classes.

        Raises:
            TypeError: it is no belief.
            ValueError: another kind of filter made it, or it is of another filtration.
        """
        if not isinstance(belief, TrailBelief):
            if not isinstance(belief, Belief):
                raise TypeError(f"a filter takes a Belief, as start and step return it, got {belief!r}")
            raise ValueError(f"the belief was made by another filter, {belief.filter}: start a new one with this Trail")
        if belief.tree is not self.model.filtration and not belief.tree.same_as(self.model.filtration):
            raise ValueError("the belief is about the classes of another filtration: take it on by belief.on(model)")
        return belief if belief.memory is self.memory else belief._of(belief.trails, memory=self.memory)
