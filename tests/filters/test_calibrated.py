"""The calibrated filter against its definition as loops, against exact oracles, and what must always hold."""

import itertools
import math

import naive
import numpy as np
import pytest
from made import bundles
from scipy.integrate import quad
from scipy.stats import multivariate_normal

import wakefold as wf

Q, SD, RATE = 0.3, 0.5, 0.2
VELOCITIES = np.array([[1.0, 0.0], [0.6, 0.8]])


def beside(model, spread=0.8, ratios=(1.0,)):
    return wf.Deviation(np.full(len(model.tracks), spread), np.array(ratios), RATE, Q)


@pytest.fixture(scope="module")
def model():
    return wf.learn(bundles(), sd=1.5)


# The definition


def heading_of(v):
    return np.outer(v, v) / (v @ v) if v.any() else np.zeros((len(v), len(v)))


def naive_predict(model, deviation, component, h):
    """One sub-step of a component (mean, covariance, track, spread)."""
    mean, cov, track, spread = component
    d, points = model.dynamics, model.tracks[track]
    members = [(points, naive.forward_difference(points, model.tracks.times_of(track)))]
    v = np.array(naive.local_velocity(mean, members, d.epsilon, d.floor))
    along = heading_of(v)
    across = np.eye(len(v)) - along
    nearest = points[np.argmin([np.linalg.norm(p - mean) for p in points])]
    keep = math.exp(-deviation.rate * h)
    f = along + keep * across
    grown = spread**2 * (1 - keep**2)
    q = along * max(deviation.along**2 * h, grown) + across * grown
    return mean + h * v + (np.eye(len(v)) - f) @ (nearest - mean), f @ cov @ f.T + q, track, spread


def naive_correct(component, fix, sd):
    """Kalman update by a fix, and the likelihood of the fix."""
    mean, cov, track, spread = component
    s = cov + sd**2 * np.eye(len(mean))
    gain = cov @ np.linalg.inv(s)
    likelihood = multivariate_normal(mean, s).pdf(fix)
    return (mean + gain @ (fix - mean), cov - gain @ s @ gain.T, track, spread), likelihood


@pytest.mark.parametrize("dim", [1, 2, 3, 5])
def test_a_step_is_the_naive_step(dim):
    model = wf.learn(bundles(dim, dim=dim), sd=1.5)
    deviation, tree = beside(model, ratios=(0.5, 1.0, 2.0)), model.filtration
    f = wf.Calibrated(model, 30, deviation=deviation, reliability=None, switching=0.05)
    belief = f.start(at="begin")
    components = [
        (np.array(p), np.eye(dim) * s**2, int(c), float(s))
        for p, c, s in zip(belief.points, belief.classes, belief.gaussians.spreads, strict=True)
    ]
    assert sorted(c[2] for c in components) == sorted(3 * list(range(9)))
    weights = np.full(27, 1 / 27)
    rng = np.random.default_rng(0)
    for k in range(5):
        dt = float(rng.choice([0.0, 0.7, 1.0, 2.3]))
        mass = np.array([sum(w for w, x in zip(weights, components, strict=True) if x[2] == t) for t in range(9)])
        weights = np.array([w * (0.95 + 0.05 / 9 / mass[x[2]]) for w, x in zip(weights, components, strict=True)])
        parts = math.ceil(dt / model.dynamics.interval - 1e-9)
        for _ in range(parts):
            components = [naive_predict(model, deviation, x, dt / parts) for x in components]
        fix = model.tracks[4][min(k, len(model.tracks[4]) - 1)] + rng.normal(size=dim)
        level = float(rng.choice(tree.birth[tree.birth > 0]))
        named = tree.class_at(4, level)
        others = len(tree.alive(level)) - 1
        updated = [naive_correct(x, fix, 1.2) for x in components]
        components = [x for x, _ in updated]
        g = [(0.8 if naive.holds(tree, named, x[2]) else 0.2 / others) if others else 1.0 for x in components]
        joint = weights * np.array([likelihood for _, likelihood in updated]) * g
        weights = joint / joint.sum()
        before = belief.log_evidence
        belief = f.step(belief, [wf.CoarseClass(named, level=level, confidence=0.8), wf.Fix(fix, sd=1.2)], dt=dt)
        assert belief.recoveries == 0
        np.testing.assert_allclose(belief.points, [x[0] for x in components], atol=1e-9)
        np.testing.assert_allclose(belief.gaussians.covs, [x[1] for x in components], atol=1e-9)
        np.testing.assert_allclose(belief.weights, weights, atol=1e-9)
        assert belief.log_evidence - before == pytest.approx(math.log(joint.sum()), abs=1e-8)


# Exact oracles


def straight(velocity, count=60):
    return np.arange(count)[:, None] * velocity


def kalman(fixes, dts, velocity, spread):
    """Kalman filter beside a straight track from its first point, in coordinates along and across it."""
    turn = np.array([velocity, [-velocity[1], velocity[0]]])  # rows: along, across; velocity has length 1
    mean, var, total = np.zeros(2), np.full(2, spread**2), 0.0
    for fix, dt in zip(fixes, dts, strict=True):
        keep = math.exp(-RATE * dt)
        grown = spread**2 * (1 - keep**2)
        mean = np.array([mean[0] + dt, keep * mean[1]])
        var = np.array([var[0] + along_noise(dt, spread), keep**2 * var[1] + grown])
        if fix is not None:
            gap, s = turn @ fix - mean, var + SD**2
            total += -0.5 * np.sum(gap**2 / s + np.log(2 * math.pi * s))
            mean, var = mean + var / s * gap, var * SD**2 / s
    return turn.T @ mean, turn.T @ np.diag(var) @ turn, total


def along_noise(dt, spread):
    parts = math.ceil(dt)
    return parts * max(Q**2 * dt / parts, spread**2 * (1 - math.exp(-2 * RATE * dt / parts)))


def observations(rng, velocity, steps):
    """Irregular steps with missing fixes along a straight line."""
    dts = rng.choice([0.5, 1.0, 1.7], size=steps)
    truth = np.cumsum(dts)[:, None] * velocity
    return dts, [None if i % 4 == 3 else z + rng.normal(size=2) * SD for i, z in enumerate(truth)]


@pytest.mark.parametrize("seed", range(5))
def test_one_straight_track_is_the_kalman_filter(seed):
    """Not within Monte Carlo error: nothing is drawn, so it is equal to rounding."""
    model = wf.learn(wf.Tracks.from_arrays([straight(VELOCITIES[0])]), sd=SD)
    dts, fixes = observations(np.random.default_rng(seed), VELOCITIES[0], 12)
    f = wf.Calibrated(model, 100, deviation=beside(model), switching=0.0, seed=seed)
    belief = f.start(at="begin")
    for fix, dt in zip(fixes, dts, strict=True):
        belief = f.step(belief, [] if fix is None else [wf.Fix(fix)], dt=float(dt))
    mean, cov, total = kalman(fixes, dts, VELOCITIES[0], 0.8)
    np.testing.assert_allclose(belief.mean(), mean, atol=1e-9)
    np.testing.assert_allclose(belief.cov(), cov, atol=1e-9)
    assert belief.log_evidence == pytest.approx(total, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_two_straight_tracks_are_the_kalman_mixture(seed):
    model = wf.learn(wf.Tracks.from_arrays([straight(v) for v in VELOCITIES]), sd=SD)
    dts, fixes = observations(np.random.default_rng(seed), VELOCITIES.mean(axis=0), 3)
    exact = [kalman(fixes, dts, v, 0.8) for v in VELOCITIES]
    logs = np.array([total for _, _, total in exact])
    share = np.exp(logs - np.logaddexp(*logs))
    f = wf.Calibrated(model, 100, deviation=beside(model), switching=0.0, seed=seed)
    belief = f.start(at="begin")
    for fix, dt in zip(fixes, dts, strict=True):
        belief = f.step(belief, [] if fix is None else [wf.Fix(fix)], dt=float(dt))
    assert share.min() > 1e-4  # a real mixture
    np.testing.assert_allclose([belief.probability(0), belief.probability(1)], share, atol=1e-9)
    assert belief.log_evidence == pytest.approx(np.logaddexp(*logs) - math.log(2), abs=1e-9)
    mean = share @ [m for m, _, _ in exact]
    np.testing.assert_allclose(belief.mean(), mean, atol=1e-9)
    between = sum(p * (c + np.outer(m - mean, m - mean)) for p, (m, c, _) in zip(share, exact, strict=True))
    np.testing.assert_allclose(belief.cov(), between, atol=1e-9)


def reports(model, rng, number):
    """Classes and levels, and the probability of each under each track: the definition of a genuine report."""
    tree, out = model.filtration, []
    for _ in range(number):
        level = float(rng.choice(tree.birth[len(tree) : tree.root]))
        alive = tree.alive(level)
        named = int(rng.choice(alive))
        g = [0.7 if naive.holds(tree, named, t) else 0.3 / (len(alive) - 1) for t in range(len(tree))]
        out.append((wf.CoarseClass(named, level=level, confidence=0.7), np.array(g), 1.0 / len(alive)))
    return out


def test_reports_alone_are_the_forward_pass_of_a_hidden_markov_model(model):
    rng, share = np.random.default_rng(3), 0.1
    f = wf.Calibrated(model, 100, reliability=None, switching=share)
    belief, mass, total = f.start(), np.full(9, 1 / 9), 0.0
    for item, g, _ in reports(model, rng, 12):
        mass = ((1 - share) * np.eye(9) + share / 9) @ mass * g  # change of class, then the report
        total += math.log(mass.sum())
        mass /= mass.sum()
        belief = f.step(belief, [item], dt=0.5)
        np.testing.assert_allclose([belief.probability(t) for t in range(9)], mass, atol=1e-12)
    assert belief.log_evidence == pytest.approx(total, abs=1e-10)


@pytest.mark.parametrize("prior", [(1.0, 1.0), (4.0, 1.5)])
def test_reliability_is_the_integral_over_it(model, prior):
    """Class masses, evidence and the share of genuine reports against adaptive numerical integration."""
    rng = np.random.default_rng(8)
    f = wf.Calibrated(model, 100, reliability=prior, switching=0.0)
    belief, told = f.start(), reports(model, rng, 15)
    for item, _, _ in told:
        belief = f.step(belief, [item], dt=0.0)
    a, b = prior
    norm = math.gamma(a + b) / math.gamma(a) / math.gamma(b)

    def density(rho, t):
        return norm * rho ** (a - 1) * (1 - rho) ** (b - 1) * math.prod(rho * g[t] + (1 - rho) * u for _, g, u in told)

    area = [quad(density, 0, 1, args=(t,), epsabs=0, epsrel=1e-10)[0] for t in range(9)]
    first = [quad(lambda rho, t=t: rho * density(rho, t), 0, 1, epsabs=0, epsrel=1e-10)[0] for t in range(9)]
    np.testing.assert_allclose([belief.probability(t) for t in range(9)], np.array(area) / sum(area), rtol=1e-8)
    assert f.genuine(belief) == pytest.approx(sum(first) / sum(area), rel=1e-8)
    assert belief.log_evidence == pytest.approx(math.log(sum(area) / 9), abs=1e-8)


def test_start_from_a_fix_keeps_every_tracks_exact_mass(model):
    deviation = beside(model, ratios=(0.5, 1.0, 2.0))
    f = wf.Calibrated(model, 100, deviation=deviation)
    fix = model.tracks[4][2] + 0.3
    belief = f.start(fix=wf.Fix(fix, sd=1.2))
    mass = []
    for t in range(9):
        points, times = model.tracks[t], model.tracks.times_of(t)
        total = 0.0
        for p, v in zip(points, naive.forward_difference(points, times), strict=True):
            length2 = (np.linalg.norm(v) * model.dynamics.interval) ** 2
            for s in (f.deviation.quantiles(3) * 0.8).tolist():
                cov = np.eye(2) * (s**2 + 1.2**2) + heading_of(v) * length2 / 12
                total += multivariate_normal(p, cov).pdf(fix) / len(points) / 3
        mass.append(total)
    np.testing.assert_allclose(
        [belief.probability(t) for t in range(9)], np.array(mass) / sum(mass), rtol=1e-9, atol=1e-15
    )


# What must always hold


@pytest.mark.parametrize("seed", range(6))
def test_masses_are_consistent_and_no_class_dies(seed):
    model = wf.learn(bundles(seed), sd=1.0)
    tree, rng = model.filtration, np.random.default_rng(seed)
    f = wf.Calibrated(model, 40, seed=seed)
    belief = f.start(agent="a")
    for _ in range(12):
        track = int(rng.integers(9))
        evidence = [wf.Fix(model.tracks[track][0] + rng.normal(size=2), sd=2.0)] if rng.random() < 0.7 else []
        if rng.random() < 0.5:
            level = float(rng.choice(tree.birth))
            evidence.append(wf.CoarseClass(tree.class_at(track, level), level=level))
        belief = f.step(belief, evidence, dt=float(rng.choice([0.0, 0.4, 1.0, 3.7])))
        assert np.isfinite(belief.points).all()
        assert (np.linalg.eigvalsh(belief.gaussians.covs) > 0).all()
        assert set(belief.classes.tolist()) == set(range(9))
        assert np.isfinite(belief.log_weights).all()
        for b in np.unique(tree.birth):
            assert belief.level(float(b)).probability.sum() == pytest.approx(1.0, abs=1e-12)
        for c in range(9, len(tree.birth)):
            children = sum(belief.probability(int(k)) for k in tree.children(c))
            assert belief.probability(c) == pytest.approx(children, abs=1e-12)


def test_the_same_seed_gives_the_same_and_a_step_changes_nothing_it_was_given(model):
    f = wf.Calibrated(model, 40, seed=3)
    belief = f.start(fix=wf.Fix(model.tracks[4][0], sd=1.0), agent="a")
    before = [np.array(x) for x in (belief.points, belief.log_weights, *belief.gaussians)]
    item = [wf.Fix(model.tracks[4][1]), wf.CoarseClass(4)]
    one, two = f.step(belief, item, dt=1.0), wf.Calibrated(model, 40, seed=3).step(belief, item, dt=1.0)
    f.forecast(belief, 3.0)
    for x, y in zip(before, (belief.points, belief.log_weights, *belief.gaussians), strict=True):
        assert np.array_equal(x, y)
    for x, y in zip(
        (one.points, one.log_weights, *one.gaussians), (two.points, two.log_weights, *two.gaussians), strict=True
    ):
        assert np.array_equal(x, y)


def test_a_forecast_is_what_steps_without_evidence_say(model):
    f = wf.Calibrated(model, 40, switching=0.0)
    belief = f.step(f.start(time=100.0), [wf.Fix(model.tracks[5][1], sd=1.0)], dt=1.0)
    near, far = f.forecast(belief, [2.0, 5.0])
    stepped = f.step(f.step(belief, dt=2.0), dt=3.0)
    np.testing.assert_allclose(far.points, stepped.points)
    np.testing.assert_allclose(far.cov(), stepped.cov())
    assert (near.time, far.time) == (belief.time + 2.0, belief.time + 5.0)
    assert np.array_equal(f.forecast(belief, 2.0).points, near.points)
    for bad in (-1.0, [3.0, 1.0]):
        with pytest.raises(ValueError, match="rising"):
            f.forecast(belief, bad)


def test_a_belief_is_kept_on_disk_bit_for_bit(model, tmp_path):
    f = wf.Calibrated(model, 40)
    belief = f.step(f.start(), [wf.Fix(model.tracks[2][0]), wf.CoarseClass(2)], dt=1.0)
    belief.save(tmp_path / "b")
    back = wf.Belief.load(tmp_path / "b", model.filtration)
    item = [wf.Fix(model.tracks[2][1])]
    a, b = f.step(belief, item, dt=1.0), f.step(back, item, dt=1.0)
    assert np.array_equal(a.points, b.points)
    assert np.array_equal(a.log_weights, b.log_weights)
    assert a.log_evidence == b.log_evidence


def test_a_lost_agent_is_found_again_and_counted(model):
    f = wf.Calibrated(model, 40, deviation=beside(model, 0.3))
    belief = f.start(fix=wf.Fix(model.tracks[0][0], sd=0.5))
    away = int(np.argmax(np.linalg.norm([t.mean(axis=0) - model.tracks[0].mean(axis=0) for t in model.tracks], axis=1)))
    belief = f.step(belief, [wf.Fix(model.tracks[away][0], sd=0.5)], dt=0.0)
    assert belief.recoveries == 1
    assert np.linalg.norm(belief.mean() - model.tracks[away][0]) <= 1.0
    assert belief.probability(away) > 0.1


def test_certain_reports_that_contradict_each_other_are_a_counted_recovery(model):
    tree = model.filtration
    f = wf.Calibrated(model, 40, reliability=None, switching=0.0)
    level = float(np.nextafter(tree.birth[tree.root], 0))
    one, other = tree.alive(level)[:2]
    belief = f.step(f.start(), [wf.CoarseClass(int(one), level=level, confidence=1.0)], dt=0.0)
    assert belief.probability(int(one)) == pytest.approx(1.0)
    belief = f.step(belief, [wf.CoarseClass(int(other), level=level, confidence=1.0)], dt=0.0)
    assert belief.recoveries == 1
    assert belief.probability(int(other)) == pytest.approx(1.0)
    assert np.isfinite(f.step(belief, [wf.Fix(model.tracks[0][0])], dt=1.0).mean()).all()


def test_every_track_is_held_where_there_are_fewer_particles_than_tracks(model):
    f = wf.Calibrated(model, 4)
    assert f.particles == 9
    for belief in (f.start(), f.start(at="begin"), f.start(fix=wf.Fix(model.tracks[5][0], sd=0.5))):
        assert set(belief.classes.tolist()) == set(range(9))
        after = f.step(belief, [wf.Fix(model.tracks[5][0], sd=0.5), wf.CoarseClass(5)], dt=0.0)
        assert after.weights.sum() == pytest.approx(1.0)
        assert np.isfinite(after.mean()).all()


def test_an_agent_beside_its_track_is_told_from_one_of_another():
    """Held out: agents run at an offset from one of three tracks, and speak up to their true class."""
    lines = [np.stack([np.linspace(0, 10, 41), np.full(41, y)], axis=1) for y in (0.0, 1.0, 4.0)]
    model = wf.learn(wf.Tracks.from_arrays(lines), sd=0.1)
    f = wf.Calibrated(model, 30)
    for true, offset in itertools.product((0, 1, 2), (-0.2, 0.2)):
        belief = f.start(fix=wf.Fix(lines[true][0] + [0, offset], sd=0.1))
        for at in lines[true][1:15]:
            belief = f.step(belief, [wf.Fix((at[0], at[1] + offset))], dt=1.0)
        assert belief.map() == true
        assert np.linalg.norm(belief.mean() - lines[true][14] - [0, offset]) < 0.1


def test_settings_out_of_range_are_named(model):
    for settings, match in [
        ({"particles": 0}, "particles"),
        ({"sd": 0.0}, "sd"),
        ({"switching": 1.5}, "switching"),
        ({"reliability": (0.0, 1.0)}, "reliability"),
    ]:
        with pytest.raises(ValueError, match=match):
            wf.Calibrated(model, **settings)
    with pytest.raises(ValueError, match="another filter, BL1"):
        wf.Calibrated(model).step(wf.BL1(model).start(), dt=1.0)
    with pytest.raises(ValueError, match="at must be"):
        wf.Calibrated(model).start(at="end")
    with pytest.raises(ValueError, match="reporter must name a class"):
        wf.Confusion.learn(model, lambda positions, rng: np.full(len(positions), 99))
