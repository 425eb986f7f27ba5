"""What filters answer does not depend on the processor: digests under other kernels of BLAS, other sets of numpy."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.special import roots_jacobi

from benchmarks.digests import differing, legal_settings
from wakefold.base import small
from wakefold.evidence.confusion import gauss_jacobi
from wakefold.relations.kernels import sampled as kernel
from wakefold.relations.learning.logistic import logistic, probability
from wakefold.relations.motion import transition

ROOT = Path(__file__).resolve().parents[1]
# The two kernels that drew other particles (signs of eigenvectors), and numpy without any vector instructions.
TRIED = ("OpenBLAS Haswell", "OpenBLAS Nehalem", "OpenBLAS SkylakeX", "numpy without AVX2")


def test_results_are_the_same_under_other_kernels_and_instruction_sets(tmp_path):
    settings = {name: variables for name, variables in legal_settings().items() if name in TRIED}
    found = {}
    for name, variables in settings.items():
        file = tmp_path / "digests.json"
        run = [sys.executable, "-m", "benchmarks.digests", "--only", "parts", "--json", str(file)]
        subprocess.run(run, cwd=ROOT, env={**os.environ, **variables}, check=True, capture_output=True)
        found[name] = json.loads(file.read_text())
    first, *others = found.values()
    assert len(first) > 20
    assert others
    for name, digests in zip(list(found)[1:], others, strict=True):
        assert not differing(digests, first), name


def test_a_difference_of_digests_is_named():
    assert differing({"a": "1", "b": "2", "c": "3"}, {"a": "1", "b": "9"}) == ["b"]


def van_loan(drag, pull, diffusion, dt):
    """Transition and noise by the exponential of one matrix (Van Loan 1978)."""
    n = len(drag)
    a, g = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    a[:n, n:], a[n:, :n], a[n:, n:], g[n:, n:] = np.eye(n), -pull, -drag, diffusion
    e = expm(np.block([[-a, g], [np.zeros_like(a), a.T]]) * dt)
    f = e[2 * n :, 2 * n :].T
    return f, f @ e[: 2 * n, 2 * n :]


@pytest.mark.parametrize("n", [1, 2, 5])
def test_transition_is_that_of_one_large_exponential(n):
    rng = np.random.default_rng(n)
    for dt in (1e-3, 0.4, 3.0):
        drag, pull = rng.uniform(-0.3, 1.0, (2, n, n))
        root = rng.normal(size=(n, n))
        given = drag, pull, root @ root.T, dt
        for got, wanted in zip(transition(*given), van_loan(*given), strict=True):
            np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-11 * np.abs(wanted).max())


def test_roots_of_covariances_give_them_back_even_if_singular():
    rng = np.random.default_rng(0)
    for size in (1, 2, 4, 6):
        for rank in range(size + 1):
            low = rng.normal(size=(3, size, rank))
            cov = low @ low.transpose(0, 2, 1)
            drawn = np.zeros((3 * size, size, 1))
            # each unit vector as the noise: the columns of the root
            noise = np.tile(np.eye(size)[:, :, None], (3, 1, 1))
            kernel.draw(np.repeat(cov, size, axis=0), np.arange(3 * size), np.arange(size), noise, drawn)
            root = drawn.reshape(3, size, size).transpose(0, 2, 1)
            np.testing.assert_allclose(root @ root.transpose(0, 2, 1), cov, atol=1e-6 * max(1.0, np.abs(cov).max()))


@pytest.mark.parametrize(("a", "b"), [(0.0, 0.0), (-0.5, -0.5), (2.0, 0.5), (-0.999, 3.0), (49.0, 0.0)])
def test_nodes_of_the_quadrature_are_those_of_scipy(a, b):
    x, w = gauss_jacobi(16, a, b)
    wanted, weights = roots_jacobi(16, a, b)
    np.testing.assert_allclose(x, wanted, atol=1e-13)
    np.testing.assert_allclose(w, weights / weights.sum(), rtol=1e-9)


def test_a_regression_ends_where_its_loss_is_level():
    rng = np.random.default_rng(1)
    x = np.column_stack([rng.normal(size=(500, 3)) * [1.0, 30.0, 0.01], np.ones(500)])
    y = rng.random(500) < probability(x @ [1.0, -0.2, 40.0, 0.3])
    heavy, offset = rng.uniform(0.1, 5.0, 500), rng.normal(size=500)
    w = logistic(x, y, heavy, offset, 0.1)
    slope = x.T @ (heavy * (probability(x @ w + offset) - y)) + np.array([0.1, 0.1, 0.1, 1e-9]) * w
    assert np.abs(slope).max() < 1e-5


def test_small_algebra_is_that_of_numpy():
    rng = np.random.default_rng(2)
    points, weights = rng.normal(size=(50, 3)), rng.dirichlet(np.ones(50))
    mean = small.mean(weights, points)
    np.testing.assert_allclose(mean, weights @ points)
    away = points - mean
    np.testing.assert_allclose(small.covariance(weights, points, mean), (away * weights[:, None]).T @ away)
    np.testing.assert_allclose(small.times(points, mean), points @ mean)
    a = away.T @ away
    np.testing.assert_allclose(small.solve(a, mean), np.linalg.solve(a, mean))
    x = rng.uniform(0.1, 5.0, (4, 3)).T
    for got, wanted in ((small.exp(x), np.exp(x)), (small.log(x), np.log(x)), (small.power(x, 0.3), x**0.3)):
        np.testing.assert_allclose(got, wanted, rtol=1e-14)
    assert small.log(np.zeros(1))[0] == -np.inf
