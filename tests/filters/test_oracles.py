"""Exact oracles: where the true posterior is known, the filters must agree with it within Monte Carlo error.

200 seeds; the mean over the seeds must lie within 5 standard errors of the exact answer: for each of the 6 numbers of a
test 1.3e-6 if the filter is right (Student's t), together below 1e-5. A mean that is off by a run's standard deviation
over two is 7 standard errors away, and found with probability .98. A particle filter's own bias is O(1/N): N is chosen
so that it is well below the standard error.
"""

import math
import warnings

import numpy as np
import pytest

import wakefold as wf

SEEDS, N = 200, 1000
SPEED, Q, SD = 1.0, 0.3, 0.5
VELOCITIES = np.array([[SPEED, 0.0], [0.6, 0.8]])


def straight(velocity, count=60):
    return np.arange(count)[:, None] * velocity


def kalman(fixes, dts, velocity, start, spread):
    """Exact filter of a point at constant known velocity, Brownian noise Q and fixes of SD; per axis the same variance.

    Returns means, variances and the log-likelihood of all the fixes.
    """
    mean, var, total = np.array(start, dtype=float), spread, 0.0
    means, variances = [], []
    for fix, dt in zip(fixes, dts, strict=True):
        mean, var = mean + velocity * dt, var + Q * Q * dt
        if fix is not None:
            innovation = var + SD * SD
            total += -math.log(2 * math.pi * innovation) - 0.5 * np.sum((fix - mean) ** 2) / innovation
            gain = var / innovation
            mean, var = mean + gain * (fix - mean), (1 - gain) * var
        means.append(mean)
        variances.append(var)
    return np.array(means), np.array(variances), total


def observations(rng, velocity, steps):
    """Irregular steps with missing fixes along a straight line."""
    dts = rng.choice([0.5, 1.0, 1.7], size=steps)
    truth = np.cumsum(dts)[:, None] * velocity + np.cumsum(rng.normal(size=(steps, 2)) * Q * np.sqrt(dts)[:, None], 0)
    return dts, [None if i % 4 == 3 else z + rng.normal(size=2) * SD for i, z in enumerate(truth)]


def within(values, exact, what):
    """The mean over seeds within 5 standard errors of the exact answer."""
    values = np.asarray(values)
    error = values.std(axis=0, ddof=1) / math.sqrt(len(values))
    gap = np.abs(values.mean(axis=0) - exact)
    assert (gap <= 5 * error + 1e-12).all(), f"{what}: {values.mean(axis=0)} against {exact}, standard error {error}"


@pytest.mark.parametrize("kind", ["MHPF arxiv2016", "MHPF gsi2017", "BL1", "BL2"])
def test_one_straight_track_is_the_kalman_filter(kind):
    model = wf.learn(wf.Tracks.from_arrays([straight(VELOCITIES[0])]), scale=Q, sd=SD)
    dts, fixes = observations(np.random.default_rng(11), VELOCITIES[0], 12)
    exact_means, exact_variances, exact_log = kalman(fixes, dts, VELOCITIES[0], [0.0, 0.0], 0.0)
    means, covariances, likelihood = [], [], []
    for seed in range(SEEDS):
        if kind.startswith("MHPF"):
            f = wf.MHPF(model, N, rule=kind.split()[1], depletion=0.0, seed=seed)
        else:
            f = getattr(wf, kind)(model, N, depletion=0.0, seed=seed)
        belief = f.start(at="begin")
        for fix, dt in zip(fixes, dts, strict=True):
            belief = f.step(belief, [] if fix is None else [wf.Fix(fix)], dt=float(dt))
        means.append(belief.mean())
        covariances.append(belief.cov())
        likelihood.append(belief.log_evidence)
        assert belief.recoveries == 0
    if kind == "MHPF arxiv2016":
        # With a single class the class ratio r is 1 and the rule makes no difference.
        assert np.allclose(belief.weights.sum(), 1.0)
    within(means, exact_means[-1], "mean")
    within([c[0, 0] for c in covariances], exact_variances[-1] * (1 - 1 / N), "variance along")
    within([c[1, 1] for c in covariances], exact_variances[-1] * (1 - 1 / N), "variance across")
    within([c[0, 1] for c in covariances], 0.0, "covariance")
    if kind == "MHPF arxiv2016":
        assert belief.log_evidence is None
        return
    # log of an unbiased estimate is biased down by half its variance
    spread = np.var(likelihood, ddof=1)
    within(likelihood, exact_log - spread / 2, "log-likelihood")


@pytest.mark.parametrize("kind", ["MHPF", "BL1"])
def test_two_straight_tracks_are_the_kalman_mixture(kind):
    tracks = [straight(v) for v in VELOCITIES]
    model = wf.learn(wf.Tracks.from_arrays(tracks), scale=Q, sd=SD)
    dts, fixes = observations(np.random.default_rng(5), VELOCITIES.mean(axis=0), 3)
    logs = [kalman(fixes, dts, v, [0.0, 0.0], 0.0)[2] for v in VELOCITIES]
    exact = np.exp(logs - np.logaddexp(*logs))
    assert 0.05 < exact[0] < 0.95  # a real mixture
    log_evidence = np.logaddexp(*logs) - math.log(2)
    got, evidence = [], []
    for seed in range(SEEDS):
        make = wf.MHPF if kind == "MHPF" else wf.BL1
        f = make(
            model, 4 * N, depletion=0.0, seed=seed
        )  # by its default rule; the share of a class is biased by O(1/N)
        belief = f.start(at="begin")
        for fix, dt in zip(fixes, dts, strict=True):
            belief = f.step(belief, [] if fix is None else [wf.Fix(fix)], dt=float(dt))
        got.append([belief.probability(0), belief.probability(1)])
        evidence.append(belief.log_evidence)
    within(got, exact, "class probabilities")
    within(evidence, log_evidence - np.var(evidence, ddof=1) / 2, "log-likelihood")


def test_a_rule_that_is_not_bayes_warns_once_and_claims_no_evidence():
    from wakefold.filters import mhpf

    model = wf.learn(wf.Tracks.from_arrays([straight(v) for v in VELOCITIES]), scale=Q, sd=SD)
    mhpf._warn_twice.cache_clear()
    with pytest.warns(UserWarning, match="arxiv2016.*gsi2017"):
        f = wf.MHPF(model, 10, rule="arxiv2016")
    assert f.start().log_evidence is None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wf.MHPF(model, 10, rule="arxiv2016")  # said already
        assert wf.MHPF(model, 10).rule == "gsi2017"
        assert wf.MHPF(model, 10).start().log_evidence == 0.0
        mhpf._warn_twice.cache_clear()
        assert wf.MHPF(model, 10, rule="arxiv2016", likelihood="log").start().log_evidence is None


def test_coarse_evidence_is_bayes_rule_on_the_classes():
    """Two tracks, one report of the class with confidence p and no fix: exact odds p : 1 - p."""
    model = wf.learn(wf.Tracks.from_arrays([straight(v) for v in VELOCITIES]), scale=Q, sd=SD)
    got, evidence = [], []
    for seed in range(SEEDS):
        f = wf.MHPF(model, N, depletion=0.0, seed=seed)
        belief = f.step(f.start(at="begin"), [wf.CoarseClass(1, confidence=0.8)], dt=1.0)
        got.append(belief.probability(1))
        evidence.append(belief.log_evidence)
    within(got, 0.8, "class probability")
    within(evidence, math.log(0.5) - np.var(evidence, ddof=1) / 2, "log-likelihood")
