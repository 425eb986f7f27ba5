"""The Kalman smoother of one agent against the joint Gaussian of all its positions and velocities."""

import numpy as np
import pytest

from wakefold.relations.smoothing import constant_velocity


def by_conditioning(seen, times, sd, q, speed, until):
    """Mean and covariance of every state given the positions up to ``until`` of one axis: no recursion."""
    n = len(times)
    heard = [t for t in range(n) if np.isfinite(seen[t])]
    first = heard[0]
    size = 2 * (n - first)
    # Every state is a linear map of the first state and the independent steps between.
    cov = np.zeros((size, size))
    lead = np.eye(2)
    maps = [np.eye(2)]
    noises = [np.diag([1e7, speed**2])]
    for t in range(first + 1, n):
        dt = times[t] - times[t - 1]
        maps.append(np.array([[1, dt], [0, 1]]))
        noises.append(q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))
    spread = noises[0]
    for i in range(n - first):
        if i:
            spread = maps[i] @ spread @ maps[i].T + noises[i]
        cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = spread
        lead = np.eye(2)
        for j in range(i + 1, n - first):
            lead = maps[j] @ lead
            cov[2 * j : 2 * j + 2, 2 * i : 2 * i + 2] = lead @ spread
            cov[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = (lead @ spread).T
    rows = [t for t in heard if t <= until]
    pick = [2 * (t - first) for t in rows]
    noise = np.diag([sd[t] ** 2 for t in rows])
    gain = np.linalg.solve(cov[np.ix_(pick, pick)] + noise, cov[pick]).T
    mean = gain @ seen[rows]
    after = cov - gain @ cov[pick]
    return mean.reshape(-1, 2), [after[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(n - first)]


@pytest.mark.parametrize("seed", range(4))
def test_filter_and_smoother_are_exact(seed):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.5, 3, 9))
    sd = rng.uniform(0.5, 2, 9)
    seen = np.cumsum(rng.normal(size=(9, 2)), axis=0)
    seen[rng.choice(np.arange(9), 3, replace=False)] = np.nan
    first = int(np.argmax(np.isfinite(seen[:, 0])))
    whole = constant_velocity(seen, times, sd, q=0.3, speed=2.0)
    sofar = constant_velocity(seen, times, sd, q=0.3, speed=2.0, smooth=False)
    for axis in range(2):
        mean, cov = by_conditioning(seen[:, axis], times, sd, 0.3, 2.0, 9)
        assert np.allclose(whole.position[first:, axis], mean[:, 0], atol=1e-4)
        assert np.allclose(whole.velocity[first:, axis], mean[:, 1], atol=1e-4)
        assert np.allclose(whole.cov[first:], cov, atol=1e-4)
        for t in range(first, 9):
            mean, cov = by_conditioning(seen[:, axis], times, sd, 0.3, 2.0, t)
            assert np.allclose(sofar.position[t, axis], mean[t - first, 0], atol=1e-4)
            assert np.allclose(sofar.cov[t], cov[t - first], atol=1e-4)


def test_before_the_first_position_nothing_is_known():
    seen = np.array([[np.nan] * 2, [0.0, 0.0], [1.0, 1.0]])
    states = constant_velocity(seen, [0, 1, 2], 1.0, q=1.0)
    assert np.isnan(states.position[0]).all()
    assert np.isfinite(states.position[1:]).all()


def test_wrong_input_is_refused():
    with pytest.raises(ValueError, match="above 0"):
        constant_velocity(np.zeros((3, 2)), np.arange(3), 0.0, q=1.0)
    with pytest.raises(ValueError, match="T = 2"):
        constant_velocity(np.zeros((3, 2)), np.arange(2), 1.0, q=1.0)
