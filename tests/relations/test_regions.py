"""Gaussians of a pair given that a statement holds: against the chi-squared law, and against many points."""

import math

import numpy as np
import pytest
from numba import njit
from scipy.stats import ncx2

from wakefold.relations.kernels import predicates, regions
from wakefold.relations.model import ahead, closing, near, same_velocity, slow


@njit
def given(ops, numbers, g, own):
    return predicates.evaluate(ops, numbers, g, own, True, np.empty((predicates.depth_of(ops), 8)))


@njit
def balls(mean2, variance, radius):
    return regions.ball(mean2, variance, radius)


@njit
def parted(g, inside, t):
    out = np.empty(7)
    predicates.blend(g, inside, t, out)
    return out


def test_a_ball_is_that_of_the_non_central_law():
    """P, and both moments by its densities with 4 and 6 degrees of freedom.

    Of a large ball the border is integrated over by three nodes: the variance is .021 off at most, where P is .002.
    """
    rng = np.random.default_rng(0)
    for _ in range(400):
        b, variance = np.exp(rng.uniform(-3, 3.5)), np.exp(rng.uniform(-3, 3))
        a = max(b + rng.uniform(-4.9, 4.9), 0.0) if rng.random() < 0.8 else 0.0
        p, left, after = balls(a * a * variance, variance, b * math.sqrt(variance))
        exact, f4, f6 = ncx2.cdf(b * b, 2, a * a), ncx2.pdf(b * b, 4, a * a), ncx2.pdf(b * b, 6, a * a)
        assert p == pytest.approx(exact, abs=1e-4)
        if exact > 1e-3:
            shift = 2 * f4 / exact
            square = (exact - 2 * f4 - 2 * a * a * (f6 - f4) / 2) / exact
            assert a * (1 - left) == pytest.approx(a * shift, abs=5e-3)
            assert after / variance == pytest.approx(square - shift**2 * a * a / 2, abs=0.025)


POINTS = {
    "near": lambda u, w, a, b: np.hypot(*u.T) <= 2.0,
    "same": lambda u, w, a, b: np.hypot(*w.T) <= 0.5,
    "slow": lambda u, w, a, b: (np.hypot(*a.T) <= 0.8) & (np.hypot(*b.T) <= 0.8),
    "closing": lambda u, w, a, b: -(u * w).sum(axis=1) >= 0.5 * np.hypot(*u.T),
}


def in_front(u, w, a, b):
    way = a / np.hypot(*a.T)[:, None]
    along, beside = (u * way).sum(axis=1), u[:, 1] * way[:, 0] - u[:, 0] * way[:, 1]
    return (along > 0) & (along <= 3.0) & (np.abs(beside) <= 1.0)


CASES = [
    (near(2.0), POINTS["near"], 0.005),
    (near(2.0) & same_velocity(0.5), lambda *x: POINTS["near"](*x) & POINTS["same"](*x), 0.02),
    (near(2.0) | same_velocity(0.5), lambda *x: POINTS["near"](*x) | POINTS["same"](*x), 0.02),
    (slow(0.8), POINTS["slow"], 0.02),
    (~slow(0.8) & near(2.0), lambda *x: ~POINTS["slow"](*x) & POINTS["near"](*x), 0.02),
    (closing(0.5), POINTS["closing"], 0.01),
    (~closing(0.5), lambda *x: ~POINTS["closing"](*x), 0.01),
    (ahead(3.0, 1.0), in_front, 0.02),
    (ahead(3.0, 1.0) & closing(0.5), lambda *x: in_front(*x) & POINTS["closing"](*x), 0.02),
]


@pytest.mark.parametrize("case", range(len(CASES)))
@pytest.mark.parametrize("place", [(1.2, 0.8), (2.0, 0.3)])
def test_what_a_statement_tells_is_that_of_many_points(case, place):
    """200,000 points of one seed: a probability errs by .0011 (sd), a mean by .003 or less."""
    said, holds, within = CASES[case]
    rng = np.random.default_rng(case)
    mean = np.array([[[0, 0], [0.5, 0.2]], [place, [0.2, 0.3]]], dtype=float)  # of each: position, velocity
    cov = np.array([[[0.1, 0.06], [0.06, 0.12]], [[0.15, 0.1], [0.1, 0.2]]])
    both = [
        m + np.einsum("ij,njk->nik", np.linalg.cholesky(c), rng.normal(size=(200_000, 2, 2)))
        for m, c in zip(mean, cov, strict=True)
    ]
    away = both[1] - both[0]
    true = holds(away[:, 0], away[:, 1], both[0][:, 1], both[1][:, 1])
    total = cov.sum(axis=0)
    g = np.array([*(mean[1] - mean[0]).ravel(), total[0, 0], total[0, 1], total[1, 1]])
    own = np.array([*mean[0, 1], *mean[1, 1], cov[0, 0, 1], cov[0, 1, 1], cov[1, 0, 1], cov[1, 1, 1]])
    inside = g.copy()
    assert given(*said.arrays(), inside, own) == pytest.approx(true.mean(), abs=within)
    centre = away[true].mean(axis=0)
    np.testing.assert_allclose(inside[:4], centre.ravel(), atol=4 * within)
    off = away[true] - centre
    moments = [(off[:, i] * off[:, j]).mean() for i, j in ((0, 0), (0, 1), (1, 1))]
    np.testing.assert_allclose(inside[4:7], moments, atol=4 * within)


def test_inside_and_outside_make_up_the_whole():
    """The moments given an outcome of chance .3 inside and .1 outside, and given the other, are a mixture of before."""
    g = np.array([1.5, 0.5, 0.1, -0.2, 0.4, 0.1, 0.3])
    inside, own = g.copy(), np.zeros(8)
    p = given(*near(2.0).arrays(), inside, own)
    parts, shares = [], []
    for within, outside in ((0.3, 0.1), (0.7, 0.9)):
        total = outside + (within - outside) * p
        parts.append(parted(g, inside, (within - outside) * p / total))
        shares.append(total)
    mean = sum(s * x[:4] for s, x in zip(shares, parts, strict=True))
    np.testing.assert_allclose(mean, g[:4], atol=1e-12)
    spread = sum(s * (x[4] + 0.5 * ((x[:2] - g[:2]) ** 2).sum()) for s, x in zip(shares, parts, strict=True))
    assert spread == pytest.approx(g[4])
