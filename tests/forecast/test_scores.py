"""Scores of samples are those of the definitions, and regions hold what they say."""

import naive_scores as naive
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wakefold.forecast import classes, kernels, samples


def one(points: np.ndarray, truth: np.ndarray) -> samples.Judged:
    return samples.judged(points[None, None], truth[None, None])


@given(st.integers(0, 10_000), st.integers(2, 25), st.sampled_from([1.0, 1e-3, 1e5]))
def test_scores_are_those_of_the_definitions(seed: int, count: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    points = scale * rng.normal(0, 1, (count, 2))
    points[: count // 3] = points[0]  # some in one place
    truth = scale * rng.normal(0, 1, 2)
    found = one(points, truth)
    middle = found.point[0, 0]
    total = np.linalg.norm(points - middle, axis=1).sum()
    for _ in range(40):  # no place nearby is nearer to all
        other = middle + scale * rng.normal(0, 0.05, 2)
        assert total <= np.linalg.norm(points - other, axis=1).sum() * (1 + 1e-7)
    assert np.isclose(found.error[0, 0], np.linalg.norm(truth - middle))
    assert np.isclose(found.energy[0, 0], naive.energy_score(points, truth))
    if np.median(np.linalg.norm(points - middle, axis=1)) > 1e-6 * scale:
        assert np.isclose(found.depth[0, 0], naive.denser(points, middle, truth, kernels.WIDTH))


def test_samples_in_one_place_are_a_region_without_extent() -> None:
    points = np.ones((100, 2))
    assert [one(points, np.array(at)).depth[0, 0] for at in ([1.0, 1.0], [1.0, 1.1])] == [0.0, 1.0]


def test_regions_hold_the_share_that_they_say() -> None:
    """Truths drawn as the samples are lie inside as often as the region says: 4,000 draws, sd below .008."""
    rng = np.random.default_rng(5)
    n = 4000
    every = rng.standard_t(3, (n, 1, 101, 2)) * [3.0, 1.0]
    found = samples.judged(np.ascontiguousarray(every[:, :, :100]), every[:, :, 100])
    for mass in (0.5, 0.9):
        assert abs(np.mean(found.within(mass)) - mass) < 4 * np.sqrt(mass * (1 - mass) / n) + 0.01


def test_what_is_not_asked_has_no_score() -> None:
    rng = np.random.default_rng(0)
    truth = rng.normal(0, 1, (3, 2, 2))
    truth[1, 1] = np.nan
    found = samples.judged(rng.normal(0, 1, (3, 2, 100, 2)), truth)
    for values in (found.error, found.energy, found.depth, found.within(0.9)):
        assert np.argwhere(np.isnan(values)).tolist() == [[1, 1]]


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=40).filter(lambda w: sum(w) > 1e-3))
def test_systematic_samples_are_as_many_as_the_weights_say(weights: list[float]) -> None:
    chosen = np.bincount(samples.systematic(np.array(weights)), minlength=len(weights))
    assert np.abs(chosen - 100 * np.array(weights) / sum(weights)).max() < 1.0 + 1e-9
    assert chosen.sum() == 100


def test_the_spiral_is_a_normal_distribution() -> None:
    points = samples.normal_samples()
    assert np.abs(points.mean(axis=0)).max() < 0.03
    assert np.abs(np.cov(points.T) - np.eye(2)).max() < 0.06


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.booleans()), min_size=1, max_size=30))
def test_calibration_error_is_that_of_the_definition(pairs: list[tuple[float, bool]]) -> None:
    top, hit = [p for p, _ in pairs], [float(h) for _, h in pairs]
    assert classes.calibration_error(np.array(top), np.array(hit)) == pytest.approx(naive.calibration_error(top, hit))


@given(st.integers(0, 10_000))
def test_the_kalman_filter_is_that_of_the_matrices(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, times = rng.normal(0, 100, (9, 2)).cumsum(axis=0), rng.exponential(60, 9).cumsum()
    states, covs = np.empty((9, 2, 2)), np.empty((9, 3))
    kernels.kalman(points, times, np.array([0, 9]), 0.01, 20.0, 5.0, states, covs)
    for k, (mean, cov) in enumerate(naive.kalman_track(points, times, 0.01, 20.0, 5.0)):
        assert np.allclose(states[k], mean)
        assert np.allclose(covs[k], [cov[0, 0], cov[0, 1], cov[1, 1]])
