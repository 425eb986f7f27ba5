"""How objects that are related move: exact transition and noise of linear drift and diffusion over a time step."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from wakefold.relations.model import Coupling

Floats = NDArray[np.float64]


def transition(drag: Floats, pull: Floats, diffusion: Floats, dt: float) -> tuple[Floats, Floats]:
    """Exact transition and noise covariance, both ``(2n, 2n)``, of n objects on one axis over ``dt`` seconds.

    The state is (positions, velocities); dx = v dt, dv = -(drag v + pull x) dt + noise of covariance ``diffusion`` per
    second.

    Args:
        drag: ``(n, n)``, 1/s; pull: ``(n, n)``, 1/s²; diffusion: ``(n, n)``, m²/s³.
    """
    return _transition(drag.tobytes(), pull.tobytes(), diffusion.tobytes(), len(drag), float(dt))


@lru_cache(maxsize=4096)
def _transition(drag: bytes, pull: bytes, diffusion: bytes, n: int, dt: float) -> tuple[Floats, Floats]:
    a, g = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    a[:n, n:] = np.eye(n)
    a[n:, :n], a[n:, n:] = -np.frombuffer(pull).reshape(n, n), -np.frombuffer(drag).reshape(n, n)
    g[n:, n:] = np.frombuffer(diffusion).reshape(n, n)
    # Van Loan (1978) over a short time, then doubled: over a long one e^(drag dt) would drown the noise
    fastest = float(np.abs(a[n:]).sum(axis=1).max())
    doublings = max(0, math.ceil(math.log2(fastest * dt))) if fastest * dt > 0.0 else 0
    h = dt / 2**doublings
    both = np.zeros((4 * n, 4 * n))
    both[: 2 * n, : 2 * n], both[: 2 * n, 2 * n :], both[2 * n :, 2 * n :] = -a, g, a.T
    e: Floats = np.asarray(expm(both * h), dtype=np.float64)
    f: Floats = e[2 * n :, 2 * n :].T
    q: Floats = f @ e[: 2 * n, 2 * n :]
    for _ in range(doublings):
        q = q + f @ q @ f.T
        f = f @ f
    out = np.asarray(f, dtype=np.float64), np.asarray(0.5 * (q + q.T), dtype=np.float64)
    for a in out:
        a.flags.writeable = False  # shared by all who ask again
    return out


def group(q: Floats, couplings: list[tuple[int, int, Coupling]]) -> tuple[Floats, Floats, Floats]:
    """Drag, pull and diffusion, ``(n, n)`` each, of objects with diffusions ``q (n,)`` under couplings (i, j, how).

    The differences within a set of coupled objects diffuse as their coupling says (the strongest noise of several), its
    centre as the mean of independent members. i follows j where a coupling is not mutual.
    """
    n = len(q)
    drag, pull, diffusion = np.zeros((n, n)), np.zeros((n, n)), np.diag(q**2)
    label, noise = np.arange(n), np.zeros(n)
    for i, j, how in couplings:
        for matrix, rate in ((drag, how.k), (pull, how.pull)):
            share = 0.5 * rate if how.mutual else rate
            matrix[i, i] += share
            matrix[i, j] -= share
            if how.mutual:
                matrix[j, j] += share
                matrix[j, i] -= share
        together = (label == label[i]) | (label == label[j])
        noise[together] = max(noise[together].max(), how.noise)
        label[together] = label[i]
    for at in np.unique(label):
        members = np.flatnonzero(label == at)
        if len(members) > 1:
            centre = np.full((len(members), len(members)), 1.0 / len(members))
            rest = np.eye(len(members)) - centre
            diffusion[np.ix_(members, members)] = (
                centre @ np.diag(q[members] ** 2) @ centre + 0.5 * noise[members[0]] ** 2 * rest
            )
    return drag, pull, diffusion


def moving(q: Floats, couplings: list[tuple[int, int, Coupling]], dt: float) -> tuple[Floats, Floats]:
    """``transition`` of a ``group``: most sets of objects have moved so before."""
    return _motion(np.asarray(q, dtype=np.float64).tobytes(), tuple(couplings), float(dt))


@lru_cache(maxsize=4096)
def _motion(q: bytes, couplings: tuple[tuple[int, int, Coupling], ...], dt: float) -> tuple[Floats, Floats]:
    return transition(*group(np.frombuffer(q), list(couplings)), dt)


@lru_cache(maxsize=4096)
def row(drag: float, pull: float, diffusion: float, dt: float) -> Floats:
    """``(7,)`` motion of one object, or of the difference of two, as kernels/pairs.py reads it."""
    f, q = transition(np.array([[drag]]), np.array([[pull]]), np.array([[diffusion]]), dt)
    out = np.array([*f.ravel(), q[0, 0], q[0, 1], q[1, 1]])
    out.flags.writeable = False  # shared by all who ask again
    return out
