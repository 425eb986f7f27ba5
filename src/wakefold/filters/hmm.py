"""Hidden Markov model with Gaussian emissions: what the relational particle filter is compared with.

Rabiner, "A tutorial on hidden Markov models and selected applications in speech recognition", Proc. IEEE 77 (1989);
Manfredotti et al. 2011, Section 3, name the model but not its set-up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.cluster.vq import kmeans2

from wakefold.base import small
from wakefold.base.types import Floats
from wakefold.filters.kernels import hmm as kernel


class StateBelief(NamedTuple):
    """What is known of the hidden state.

    Attributes:
        log_probability: ``(K,)`` of each state.
        log_evidence: log p of all observations so far.
        begun: whether the first observation was heard.
    """

    log_probability: Floats
    log_evidence: float
    begun: bool


@dataclass(frozen=True, eq=False)
class GaussianHMM:
    """A hidden state of K that changes as a Markov chain and is seen as a Gaussian vector of F features.

    An observation with a NaN says nothing. Sequences are given as a list of arrays ``(T, F)``, in any units.

    Attributes:
        initial: ``(K,)`` probability of each state at first.
        transition: ``(K, K)`` from state i to state j.
        mean: ``(K, F)``.
        cov: ``(K, F, F)``, positive definite.

    Raises:
        ValueError: shapes that do not fit, rows that do not sum to 1, or a covariance that is not positive definite.
    """

    initial: Floats
    transition: Floats
    mean: Floats
    cov: Floats
    _log_initial: Floats = field(init=False, repr=False)
    _log_transition: Floats = field(init=False, repr=False)
    _whiten: Floats = field(init=False, repr=False)  # inverse Cholesky factors of cov

    def __post_init__(self) -> None:
        for name in ("initial", "transition", "mean", "cov"):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), dtype=np.float64))
        states = len(self.initial)
        if self.mean.ndim != 2 or len(self.mean) != states:
            raise ValueError(f"mean must be ({states}, F), got shape {self.mean.shape}")
        features = self.mean.shape[1]
        if self.transition.shape != (states, states):
            raise ValueError(f"transition must be ({states}, {states}), got shape {self.transition.shape}")
        if self.cov.shape != (states, features, features):
            raise ValueError(f"cov must be ({states}, {features}, {features}), got shape {self.cov.shape}")
        for name, rows in (("initial", self.initial[None]), ("transition", self.transition)):
            if not ((rows >= 0).all() and (np.abs(rows.sum(axis=1) - 1.0) <= 1e-5).all()):
                raise ValueError(f"{name} must hold probabilities that sum to 1")
        whiten = np.zeros_like(self.cov)
        if not kernel.whiten(self.cov, whiten):
            raise ValueError("cov must be positive definite")
        object.__setattr__(self, "_log_initial", small.log(self.initial))
        object.__setattr__(self, "_log_transition", small.log(self.transition))
        object.__setattr__(self, "_whiten", whiten)

    # One observation after the other

    def start(self) -> StateBelief:
        """The belief before anything was seen."""
        return StateBelief(self._log_initial, 0.0, False)

    def step(self, belief: StateBelief, observation: ArrayLike) -> StateBelief:
        """The belief one time step later (or at the first step) and after its observation ``(F,)``.

        Raises:
            ValueError: the wrong number of features, or an observation that is impossible in every state.
        """
        ahead = belief.log_probability
        if belief.begun:
            ahead = np.logaddexp.reduce(ahead[:, None] + self._log_transition, axis=0)
        joint = ahead + self.log_emission(np.atleast_2d(np.asarray(observation, dtype=np.float64)))[0]
        total = float(np.logaddexp.reduce(joint))
        if total == -np.inf:
            raise ValueError("the observation is impossible in every state")
        return StateBelief(joint - total, belief.log_evidence + total, True)

    # Whole sequences

    def log_emission(self, x: ArrayLike) -> Floats:
        """``(T, K)`` log density of each observation in each state; 0 where it says nothing (NaN).

        Raises:
            ValueError: the wrong number of features.
        """
        rows = np.asarray(x, dtype=np.float64)
        features = self.mean.shape[1]
        if rows.ndim != 2 or rows.shape[1] != features:
            raise ValueError(f"observations must be (T, {features}), got shape {rows.shape}")
        out = np.empty((len(rows), len(self.initial)))
        kernel.log_emission(np.ascontiguousarray(rows), self.mean, self._whiten, out)
        return out

    def log_likelihood(self, x: ArrayLike) -> float:
        """Log density of a whole sequence ``(T, F)``."""
        log_b = self.log_emission(x)
        return float(kernel.forward(log_b, self._log_transition, self._log_initial, np.empty_like(log_b)))

    def posterior(self, x: ArrayLike) -> Floats:
        """``(T, K)`` probability of each state at each moment given the whole sequence (forward-backward).

        Raises:
            ValueError: no path of states explains the sequence.
        """
        log_b = self.log_emission(x)
        alpha, beta = np.empty_like(log_b), np.empty_like(log_b)
        total = kernel.forward(log_b, self._log_transition, self._log_initial, alpha)
        if total == -np.inf:
            raise ValueError("no path of states explains the sequence")
        kernel.backward(log_b, self._log_transition, beta)
        return small.exp(alpha + beta - total)

    def viterbi(self, x: ArrayLike) -> tuple[NDArray[np.int64], float]:
        """The likeliest path of states ``(T,)`` and the log density of path and sequence together."""
        log_b = self.log_emission(x)
        path = np.empty(len(log_b), dtype=np.int64)
        return path, float(kernel.viterbi(log_b, self._log_transition, self._log_initial, path))

    # Learning

    def improve(
        self, sequences: Sequence[ArrayLike], *, rounds: int = 50, gain: float = 1e-4, floor: ArrayLike = 0.0
    ) -> GaussianHMM:
        """Expectation-maximisation (Baum-Welch) from here on.

        Args:
            sequences: each ``(T, F)``.
            rounds: at most.
            gain: of the log-likelihood per observation, below which it ends.
            floor: added to every variance, one number or ``(F,)``: a state that explains a single point stays sound.

        Raises:
            ValueError: no observations.
        """
        x, offsets = joined(sequences)
        heard = np.isfinite(x).all(axis=1)
        seen = slice(None) if heard.all() else heard
        model, before = self, -np.inf
        for _ in range(rounds):
            log_b = model.log_emission(x)
            gamma, totals = np.empty_like(log_b), np.empty(len(offsets) - 1)
            starts, moves = np.zeros(len(self.initial)), np.zeros_like(self.transition)
            kernel.expectations(log_b, offsets, model._log_transition, model._log_initial, gamma, starts, moves, totals)
            total = float(totals.sum())
            if total - before < gain * len(x):
                break
            before = total
            model = _maximised(model, x[seen], gamma[seen], starts, moves, floor)
        return model

    @classmethod
    def learn(
        cls,
        sequences: Sequence[ArrayLike],
        states: int,
        rng: np.random.Generator,
        *,
        restarts: int = 1,
        rounds: int = 50,
        floor: float = 1e-3,
    ) -> GaussianHMM:
        """The best model of several runs of expectation-maximisation, each from k-means.

        Args:
            sequences: each ``(T, F)``.
            states: K.
            rng: of the beginnings.
            restarts: how many runs.
            rounds: of each at most.
            floor: added to every variance, as a share of the feature's own.

        Raises:
            ValueError: fewer different observations than states.
        """
        x, _ = joined(sequences)
        x = x[np.isfinite(x).all(axis=1)]
        if len(np.unique(x, axis=0)) < states:
            raise ValueError(f"{states} states cannot be learned from fewer different observations")
        scale = x.std(axis=0) + 1e-12
        least = floor * scale**2
        best, most = None, -np.inf
        for _ in range(restarts):
            _, label = kmeans2(x / scale, states, minit="++", rng=rng, missing="warn")
            model = _from_labels(x, label, states, least)
            model = model.improve(sequences, rounds=rounds, floor=least)
            if restarts == 1:
                return model
            fit = sum(model.log_likelihood(s) for s in sequences)
            if best is None or fit > most:
                best, most = model, fit
        assert best is not None
        return best

    @classmethod
    def learn_labelled(
        cls, sequences: Sequence[ArrayLike], labels: Sequence[ArrayLike], states: int, *, floor: float = 1e-3
    ) -> GaussianHMM:
        """Maximum likelihood where the states are known; half a count is added to every transition seen in principle.

        Args:
            sequences: each ``(T, F)``.
            labels: each ``(T,)``, states from 0.
            states: K.
            floor: added to every variance, as a share of the feature's own.

        Raises:
            ValueError: a state with no observation.
        """
        x, offsets = joined(sequences)
        label = np.concatenate([np.asarray(part, dtype=np.int64) for part in labels])
        seen = np.isfinite(x).all(axis=1)
        least = floor * (x[seen].std(axis=0) + 1e-12) ** 2
        if (empty := np.bincount(label[seen], minlength=states) == 0).any():
            raise ValueError(f"no observation of state {int(np.argmax(empty))}")
        starts = np.bincount(label[offsets[:-1]], minlength=states)
        moves = np.zeros((states, states))
        inner = np.ones(len(label), dtype=bool)
        inner[offsets[:-1]] = False
        at = np.flatnonzero(inner)
        np.add.at(moves, (label[at - 1], label[at]), 1)
        base = _from_labels(x[seen], label[seen], states, least)
        return cls(_shares(starts + 0.5), _shares(moves + 0.5), base.mean, base.cov)


def joined(sequences: Sequence[ArrayLike]) -> tuple[Floats, NDArray[np.int64]]:
    """All observations ``(P, F)`` one after the other and the offsets ``(N + 1,)`` of the sequences."""
    parts = [np.asarray(s, dtype=np.float64) for s in sequences]
    if not parts or any(part.ndim != 2 or not len(part) for part in parts):
        raise ValueError("sequences must be arrays (T, F) with T > 0, and one at least")
    return np.concatenate(parts), np.cumsum([0, *map(len, parts)])


def _from_labels(x: Floats, label: NDArray[np.int64], states: int, floor: ArrayLike) -> GaussianHMM:
    """Gaussians of labelled observations; to stay is ten times as likely as any one move."""
    mean, cov = np.empty((1, x.shape[1])), np.empty((1, x.shape[1], x.shape[1]))
    kernel.moments(x, np.ones((len(x), 1)), mean, cov)
    wide = np.tile(cov[0] * (len(x) / (len(x) - 1)) + np.diag(floor), (states, 1, 1))
    even = np.ones((states, states)) + 9 * np.eye(states)
    blank = GaussianHMM(np.full(states, 1 / states), _shares(even), np.tile(x.mean(axis=0), (states, 1)), wide)
    mean, cov = _moments(blank, x, np.eye(states)[label], floor)
    return GaussianHMM(blank.initial, blank.transition, mean, cov)


def _moments(model: GaussianHMM, x: Floats, member: Floats, floor: ArrayLike) -> tuple[Floats, Floats]:
    """Mean and covariance of each state, given its share ``member`` (P, K) in each observation.

    A state without any observation keeps those of the model.
    """
    mean, cov = model.mean.copy(), model.cov.copy()
    kernel.moments(x, member, mean, cov)
    cov[member.sum(axis=0) > 1e-9] += np.diag(np.broadcast_to(floor, x.shape[1]))
    return mean, cov


def _maximised(
    model: GaussianHMM, x: Floats, gamma: Floats, starts: Floats, moves: Floats, floor: ArrayLike
) -> GaussianHMM:
    """The M-step: equations 40a to 40c and 53, 54; ``x`` and ``gamma`` of the observations that say something."""
    mean, cov = _moments(model, x, gamma, floor)
    transition = np.where(moves.sum(axis=1, keepdims=True) > 0, _shares(moves), model.transition)
    return GaussianHMM(_shares(starts) if starts.sum() > 0 else model.initial, transition, mean, cov)


def _shares(counts: NDArray[Any]) -> Floats:
    total = counts.sum(axis=-1, keepdims=True)
    return counts / np.where(total > 0, total, 1)
