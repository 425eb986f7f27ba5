"""Fixes of any accuracy leave sound beliefs of ``Calibrated``."""

import math
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import bundles

import wakefold as wf


@pytest.fixture(scope="module")
def model():
    return wf.learn(bundles(), sd=1.5)


@pytest.mark.parametrize("far", [1e7, 1e200, 1e308])
def test_a_fix_out_of_this_world_is_a_counted_recovery_never_nan(model, far):
    f = wf.Calibrated(model, 40)
    belief = f.start()
    for sign in (1, -1):
        belief = f.step(belief, [wf.Fix((sign * far, far), sd=1.0)], dt=1.0)
        assert np.isfinite(belief.points).all()
        assert not np.isnan(belief.log_weights).any()
        assert not math.isnan(belief.log_evidence)
    assert belief.recoveries == 2
    assert belief.weights.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("sd", [1e-3, 1e-160, 1e-300])
def test_a_fix_surer_than_the_arithmetic(model, sd):
    f = wf.Calibrated(model, 40)
    belief = f.start(fix=wf.Fix(model.tracks[4][0] + 1e-4, sd=sd))
    assert np.isfinite(belief.mean()).all()
    assert np.linalg.norm(belief.mean() - model.tracks[4][0]) < 0.01


@given(
    seed=st.integers(0, 1000),
    count=st.integers(1, 4),
    dim=st.integers(1, 3),
    size=st.sampled_from([1e-9, 1.0, 1e6]),
    exponents=st.lists(st.floats(-30.0, 9.0), min_size=1, max_size=8),
)
def test_any_accuracy_leaves_finite_beliefs_with_sound_covariances(seed, count, dim, size, exponents):
    rng = np.random.default_rng(seed)
    tracks = [size * np.cumsum(rng.normal(0.7, 0.5, (int(rng.integers(1, 9)), dim)), axis=0) for _ in range(count)]
    model = wf.learn(wf.Tracks.from_arrays(tracks), sd=size)
    f = wf.Calibrated(model, int(rng.integers(1, 9)), seed=seed)
    belief = f.start(fix=wf.Fix(tracks[0][0], sd=10.0 ** exponents[0])) if seed % 2 else f.start()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for exponent in exponents:
            at = tracks[0][0] + size * rng.normal(size=dim) * rng.choice([0.0, 1e-12, 1.0])
            belief = f.step(belief, [wf.Fix(at, sd=10.0**exponent)], dt=float(rng.choice([0.0, 0.5, 3.0])))
            covs = belief.gaussians.covs
            assert np.isfinite(belief.points).all()
            assert np.isfinite(covs).all()
            variance = np.einsum("nii->ni", covs)
            assert (variance >= 0).all()
            least = np.linalg.eigvalsh(covs)[:, 0] >= -1e-12 * variance.max(axis=1)
            assert dim > 2 or least.all()
            assert not np.isnan(belief.log_weights).any()
            assert belief.weights.sum() == pytest.approx(1.0)
