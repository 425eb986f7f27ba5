"""Resampling: unbiased, in range, and by effective sample size."""

import math

import numpy as np
import pytest
from made import bundles

import wakefold as wf
from wakefold.filters.resampling import resample


@pytest.fixture(scope="module")
def model():
    return wf.learn(bundles(), scale=0.4, sd=1.5)


@pytest.mark.parametrize("scheme", ["systematic", "stratified", "multinomial", "residual"])
def test_resampling_is_unbiased_and_in_range(scheme):
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.full(12, 0.5))
    weights[3] = 0.0
    weights /= weights.sum()
    with np.errstate(divide="ignore"):
        logs = np.log(weights) + 700.0  # not normalised
    runs = 4000
    counts = np.zeros(12)
    for _ in range(runs):
        u = rng.random(1 if scheme == "systematic" else 12)
        kept = resample(logs, u, scheme)
        assert (np.diff(kept) >= 0).all()
        counts += np.bincount(kept, minlength=12)
        if scheme in ("systematic", "residual"):
            assert (np.bincount(kept, minlength=12) >= np.floor(12 * weights - 1e-9)).all()
    assert counts[3] == 0
    # at most the multinomial variance; 12 comparisons at 5 standard errors
    error = 5 * np.sqrt(12 * weights * (1 - weights) / runs)
    assert (np.abs(counts / runs - 12 * weights) <= error + 1e-12).all()


@pytest.mark.parametrize("scheme", ["systematic", "stratified", "multinomial", "residual"])
def test_resampling_clips_at_the_last_particle(scheme):
    logs = np.log(np.full(7, 0.1))
    assert resample(logs, np.full(1 if scheme == "systematic" else 7, np.nextafter(1, 0)), scheme).max() == 6
    one = np.full(5, -np.inf)
    one[2] = 0.0
    assert (resample(one, np.full(1 if scheme == "systematic" else 5, 0.0), scheme) == 2).all()


def test_even_weights_survive_systematic_and_residual_resampling_untouched():
    logs = np.full(100, -math.log(100))
    for u in (0.01, 0.3, 0.99):
        assert resample(logs, np.array([u]), "systematic").tolist() == list(range(100))
    assert resample(logs, np.random.default_rng(0).random(100), "residual").tolist() == list(range(100))


def test_resampling_by_effective_sample_size(model):
    f = wf.BL1(model, 50, ess_threshold=0.5, depletion=0.0, seed=0)
    belief = f.start()
    weak = f.step(belief, [wf.Fix(model.tracks[2][0], sd=1e3)], dt=0.0)
    assert weak.ess > 25
    kept = f.step(weak, [], dt=0.0)
    assert np.array_equal(kept.log_weights, weak.log_weights)  # nothing was resampled
    strong = f.step(kept, [wf.Fix(kept.points[0], sd=0.5)], dt=0.0)
    assert strong.ess < 25  # over seeds 4, sd 2.3
    assert np.allclose(f.step(strong, [], dt=0.0).weights, 1 / 50)
