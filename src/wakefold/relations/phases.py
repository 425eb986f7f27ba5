"""Two objects that go through phases together, such as two ships that approach, meet and part.

The relational filter of one pair (Manfredotti, Fleet, Hamilton and Zilles, "Relational Particle Filtering", 2011)
without sampling: the objects' joint Gaussian is kept for each phase of their relation. Objects move given the phase of
before, the phase changes given the objects of now (Eq. 1), sensors see objects only (Eq. 2). As the Gaussian is joint,
seeing one object tells of the pair too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold.base import small
from wakefold.base.types import Floats
from wakefold.relations.kernels import phases as kernel
from wakefold.relations.model import Coupling
from wakefold.relations.motion import group, transition


@dataclass(frozen=True)
class Phase:
    """How two objects move while a phase lasts.

    Args:
        name: of the phase.
        q: diffusion of either velocity, m/s per square root of a second.
        drag: rate at which either velocity fades, 1/s.
        couples: how they keep together; None: not at all.
        stages: of equal mean time that a phase goes through before it is left. With one its time is exponential, with
            more it is less spread (Erlang).
        starts: probability of being the first phase.
    """

    name: str
    q: float
    drag: float = 0.0
    couples: Coupling | None = None
    stages: int = 1
    starts: float = 0.0

    def __post_init__(self) -> None:
        where = f"phase {self.name!r}"
        if not 0.0 < self.q < math.inf:
            raise ValueError(f"{where}: q must be a positive number, got {self.q}")
        if not 0.0 <= self.drag < math.inf:
            raise ValueError(f"{where}: drag must be a number >= 0, got {self.drag}")
        if isinstance(self.stages, bool) or not isinstance(self.stages, int) or self.stages < 1:
            raise ValueError(f"{where}: stages must be a whole number of at least 1, got {self.stages}")
        if not 0.0 <= self.starts <= 1.0:
            raise ValueError(f"{where}: starts must be a probability, got {self.starts}")


@dataclass(frozen=True)
class Turn:
    """One phase follows another, at ``rate`` per second times the probability of what the objects must be like.

    That is a product of exp(-x² / (2 s²)) over the distance, the difference of the velocities and either speed, each
    with its s; one that is not given asks nothing.

    Args:
        before, after: names of phases.
        rate: per second.
        near: metres, for their distance.
        same_velocity: m/s, for the difference of their velocities.
        slow: m/s, for the speed of either.
    """

    before: str
    after: str
    rate: float
    near: float = math.inf
    same_velocity: float = math.inf
    slow: float = math.inf

    def __post_init__(self) -> None:
        where = f"turn from {self.before!r} to {self.after!r}"
        for name in ("rate", "near", "same_velocity", "slow"):
            value = getattr(self, name)
            if not value > 0.0 or (name == "rate" and value == math.inf):
                raise ValueError(f"{where}: {name} must be a positive number, got {value}")


class PairPhases(NamedTuple):
    """Belief about P pairs; K phases, those of several stages counted as often. Made by ``PhaseFilter``.

    Attributes:
        mean: ``(P, K, 4, 2)`` positions of both objects, then velocities, in each phase, metres and m/s.
        cov: ``(P, K, 4, 4)`` their covariance in either coordinate.
        log_p: ``(P, K)`` log-probability of each phase.
        begun: ``(P, 2)`` whether each object has been seen.
    """

    mean: Floats
    cov: Floats
    log_p: Floats
    begun: NDArray[np.bool_]


class PhaseFilter:
    """Tells the phases of pairs, and where the objects are, from positions of both, of one, or of none.

    Args:
        phases: of distinct names; their ``starts`` sum to 1.
        turns: between them.
        speed: standard deviation of the velocity of a new object per axis, m/s.

    Raises:
        ValueError: phases or turns that do not fit together.
    """

    def __init__(self, phases: Sequence[Phase], turns: Sequence[Turn], *, speed: float) -> None:
        self.phases, self.turns, self.speed = tuple(phases), tuple(turns), float(speed)
        names = [phase.name for phase in self.phases]
        if len(set(names)) < len(names):
            raise ValueError(f"phases must have distinct names, got {', '.join(names)}")
        for turn in self.turns:
            for name in (turn.before, turn.after):
                if name not in names:
                    raise ValueError(f"a turn is about {name!r}, which is no phase: {', '.join(names)}")
        if abs(sum(phase.starts for phase in self.phases) - 1.0) > 1e-9:
            raise ValueError("the phases' starts must sum to 1")
        if not 0.0 < self.speed < math.inf:
            raise ValueError(f"speed must be a positive number, got {self.speed}")
        self._of = np.repeat(np.arange(len(names)), [phase.stages for phase in self.phases])
        self._motions = lru_cache(maxsize=64)(self._motions_of)  # most steps are as long as one before
        self._turns = lru_cache(maxsize=64)(self._turns_of)
        self._first = {name: int(np.searchsorted(self._of, k)) for k, name in enumerate(names)}

    def start(self, count: int) -> PairPhases:
        """The belief about ``count`` pairs before anything is seen."""
        k = len(self._of)
        share = np.zeros(k)
        for phase in self.phases:
            share[self._first[phase.name]] = phase.starts
        log_p = np.tile(small.log(share), (count, 1))
        return PairPhases(np.zeros((count, k, 4, 2)), np.zeros((count, k, 4, 4)), log_p, np.zeros((count, 2), bool))

    def step(self, belief: PairPhases, seen: ArrayLike, sd: float, dt: float) -> PairPhases:
        """The belief after ``dt`` seconds and what was seen then.

        Args:
            seen: ``(P, 2, 2)`` positions of both objects of each pair, metres; NaN where one was not seen.
            sd: of their noise in either coordinate, metres, above 0.

        Raises:
            ValueError: shapes that do not fit, or numbers out of range.
        """
        z = np.ascontiguousarray(seen, dtype=np.float64)
        if z.shape != (len(belief.log_p), 2, 2):
            raise ValueError(f"seen must have shape ({len(belief.log_p)}, 2, 2), got {z.shape}")
        if np.isinf(z).any() or (np.isnan(z[..., 0]) != np.isnan(z[..., 1])).any():
            raise ValueError("seen must hold finite positions, or NaN in both coordinates")
        if not (0.0 < sd < math.inf and 0.0 <= dt < math.inf):
            raise ValueError(f"sd must be above 0 and dt must not be negative, got {sd} and {dt}")
        after = PairPhases(belief.mean.copy(), belief.cov.copy(), belief.log_p.copy(), belief.begun.copy())
        kernel.step(after, z, sd * sd, self.speed**2, self._motions(dt), self._turns(dt))
        return after

    def probabilities(self, belief: PairPhases) -> Floats:
        """``(P, phases)`` probability of each phase, in the order given."""
        return np.add.reduceat(small.exp(belief.log_p), list(self._first.values()), axis=1)

    def log_odds(self, belief: PairPhases, names: Sequence[str]) -> Floats:
        """``(P,)`` of being in one of the phases named; at most 700 either way."""
        inside = np.isin(self._of, [k for k, phase in enumerate(self.phases) if phase.name in names])
        sides = [np.logaddexp.reduce(belief.log_p[:, which], axis=1) for which in (inside, ~inside)]
        return np.clip(sides[0], -700.0, None) - np.clip(sides[1], -700.0, None)

    def position(self, belief: PairPhases) -> Floats:
        """``(P, 2, 2)`` mean position of both objects, metres; NaN where one has not been seen yet."""
        place = (small.exp(belief.log_p)[:, :, None, None] * belief.mean[:, :, :2]).sum(axis=1)
        return np.where(belief.begun[:, :, None], place, np.nan)

    def _motions_of(self, dt: float) -> tuple[Floats, Floats]:
        """Of each phase ``(K, 4, 4)``: what a state becomes, and the noise."""
        motions = []
        for phase in self.phases:
            drag, pull, diffusion = group(np.full(2, phase.q), [] if phase.couples is None else [(0, 1, phase.couples)])
            motions += [transition(drag + phase.drag * np.eye(2), pull, diffusion, dt)] * phase.stages
        return np.array([f for f, _ in motions]), np.array([q for _, q in motions])

    def _turns_of(self, dt: float) -> tuple[NDArray, NDArray, Floats, Floats]:
        """Turns as the kernel reads them, those from stage to stage among them."""
        rows: list[tuple[int, int, float, tuple[float, ...]]] = []
        for turn in self.turns:
            stages = next(phase.stages for phase in self.phases if phase.name == turn.before)
            last = self._first[turn.before] + stages - 1
            rows.append((last, self._first[turn.after], turn.rate * stages, (turn.near, turn.same_velocity, turn.slow)))
        for phase in self.phases:
            rate = sum(turn.rate for turn in self.turns if turn.before == phase.name) * phase.stages
            first = self._first[phase.name]
            rows += [(k, k + 1, rate, (math.inf,) * 3) for k in range(first, first + phase.stages - 1)]
        before, after = (np.array([row[k] for row in rows], dtype=np.int64) for k in (0, 1))
        chance = np.array([-math.expm1(-dt * row[2]) for row in rows])
        return before, after, small.log(chance), np.array([row[3] for row in rows]).reshape(-1, 3) ** 2
