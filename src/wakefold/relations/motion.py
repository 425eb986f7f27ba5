"""How objects that are related move: exact transition and noise of linear drift and diffusion over a time step."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from wakefold.base import small
from wakefold.base.types import Floats
from wakefold.relations.model import Coupling


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
    if dt > 0.0:
        out = small.transition(*(np.frombuffer(x).reshape(n, n).copy() for x in (drag, pull, diffusion)), dt)
    else:
        out = np.eye(2 * n), np.zeros((2 * n, 2 * n))
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
            rest = np.eye(len(members)) - 1.0 / len(members)
            centre = float((q[members] ** 2).sum()) / len(members) ** 2  # variance of the mean
            diffusion[np.ix_(members, members)] = centre + 0.5 * noise[members[0]] ** 2 * rest
    return drag, pull, diffusion


def moving(q: Floats, couplings: list[tuple[int, int, Coupling]], dt: float) -> tuple[Floats, Floats]:
    """``transition`` of a ``group``: most sets of objects have moved so before."""
    return _motion(np.asarray(q, dtype=np.float64).tobytes(), tuple(couplings), float(dt))


@lru_cache(maxsize=4096)
def _motion(q: bytes, couplings: tuple[tuple[int, int, Coupling], ...], dt: float) -> tuple[Floats, Floats]:
    return transition(*group(np.frombuffer(q), list(couplings)), dt)


@lru_cache(maxsize=4096)
def row(drag: float, pull: float, diffusion: float, dt: float) -> Floats:
    """``(7,)`` motion of one object, or of the difference of two, as ``kernels.pairs`` reads it."""
    f, q = transition(np.array([[drag]]), np.array([[pull]]), np.array([[diffusion]]), dt)
    out = np.array([*f.ravel(), q[0, 0], q[0, 1], q[1, 1]])
    out.flags.writeable = False  # shared by all who ask again
    return out
