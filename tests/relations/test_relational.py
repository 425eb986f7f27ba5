"""The relational filter against exact answers: Kalman filters, and enumeration of what the relations may have been."""

import math

import naive
import numpy as np
import pytest

import wakefold as wf
from wakefold.base import store
from wakefold.relations.model import couple_velocity, follow_velocity, near, same_velocity, slow

ENGINES = ["bootstrap", "rbk", "collapsed"]


def walkers(seed=0, steps=8, dt=0.4, sd=0.1, together=True):
    """Fixes (T, 2, 2) of two who walk side by side, or apart."""
    rng = np.random.default_rng(seed)
    t = np.arange(steps) * dt
    turn = 0.0 if together else 0.35
    first = np.column_stack([0.4 * t, 0.1 * t])
    second = np.column_stack([0.4 * t, 0.8 + 0.1 * t + turn * t])
    return np.stack([first, second], axis=1) + sd * rng.normal(size=(steps, 2, 2))


def pair_model(**settings):
    relation = wf.Relation(
        "together",
        ("person", "person"),
        couples=couple_velocity(k=0.5, noise=0.1),
        rate_on=0.3,
        rate_off=0.2,
        **settings,
    )
    return wf.RelationalModel({"person": wf.ConstantVelocity(q=0.35, speed=0.5)}, [relation])


def follow(f, fixes, dt=0.4, sd=0.1, ids=(0, 1), **sensor):
    scene = f.start()
    for k, fix in enumerate(fixes):
        scan = wf.Detections(fix, sd=sd, ids=None if ids is None else list(ids), **sensor)
        scene = f.step(scene, scan, dt=dt if k else 0.0)
    return scene


@pytest.mark.parametrize("engine", ["rbk", "collapsed"])
def test_one_object_without_relations_is_the_kalman_filter(engine):
    fixes = walkers(steps=12)[:, :1]
    model = wf.RelationalModel({"person": wf.ConstantVelocity(q=0.35, speed=1.3)})
    f = wf.RelationalFilter(model, engine, particles=3)
    means, covs, log = naive.kalman_fixes(fixes[:, 0], 0.4, 0.1, 0.35, 1.3)
    scene = f.start()
    for k, fix in enumerate(fixes):
        scene = f.step(scene, wf.Detections(fix, sd=0.1, ids=[7], detect_prob=1.0), dt=0.4 if k else 0.0)
        np.testing.assert_allclose(scene.mean[0], means[k], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(scene.cov[0], covs[k][[0, 0, 1], [0, 1, 1]], rtol=1e-9, atol=1e-12)
    assert scene.log_evidence == pytest.approx(log, abs=1e-6)


def test_sampled_objects_come_near_the_kalman_filter():
    """Over seeds a mean is sd / 93 off, a variance 1.2 %, the log evidence .035, or less: the bounds are 4.2 sd."""
    fixes = walkers(steps=8)[:, :1]
    model = wf.RelationalModel({"person": wf.ConstantVelocity(q=0.35, speed=0.5)})
    f = wf.RelationalFilter(model, "bootstrap", particles=50_000)
    means, covs, log = naive.kalman_fixes(fixes[:, 0], 0.4, 0.1, 0.35, 0.5)
    scene = follow(f, fixes, ids=[7], detect_prob=1.0)
    sds = np.sqrt(np.diag(covs[-1]))[:, None]
    assert (np.abs(scene.mean[0] - means[-1]) < sds / 10).all()
    np.testing.assert_allclose(scene.cov[0], covs[-1][[0, 0, 1], [0, 1, 1]], rtol=0.15)
    assert scene.log_evidence == pytest.approx(log, abs=0.15)


@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize(
    ("engine", "particles", "seeds", "sd", "within"),
    [
        ("bootstrap", 20_000, 8, 0.3, 0.05),
        ("rbk", 8_000, 1, 0.1, 0.02),
        ("collapsed", 1, 1, 0.1, 0.02),
    ],
)
def test_the_relation_of_a_pair_is_that_of_enumeration(engine, particles, seeds, sd, within, together):
    """Switches that do not depend on the objects; 256 histories; mean over seeds.

    A run errs by an sd of .029 to .036 ("bootstrap", which needs coarser detections) and .004 or .005 ("rbk"; its log
    evidence .023): the bounds are 3.9 sd of the mean or more, false alarms below 1e-4. A filter
    that learned nothing from what is seen would say .53: .16 off and more, found with probability above .999.
    """
    dt, fixes = 0.4, walkers(steps=8, sd=sd, together=together)
    total = 0.5
    on, off = (rate / total * -math.expm1(-total * dt) for rate in (0.3, 0.2))
    exact, log = naive.relation_by_enumeration(fixes, dt, sd, 0.35, 0.5, 0.5, 0.1, 0.3, on, off)
    model = pair_model(prior=0.3)
    filters = [wf.RelationalFilter(model, engine, particles=particles, gate=100.0, seed=k) for k in range(seeds)]
    scenes = [follow(f, fixes, sd=sd, detect_prob=1.0) for f in filters]
    assert np.mean([s.probability("together", 0, 1) for s in scenes]) == pytest.approx(exact, abs=within)
    if engine == "rbk":
        assert scenes[0].log_evidence == pytest.approx(log, abs=0.1)


@pytest.mark.parametrize(("together", "within"), [(True, 0.005), (False, 0.009)])
def test_collapsed_is_as_near_to_enumeration_as_many_particles(together, within):
    """Mean error over twenty pairs; with one Gaussian in each mode (IMM) those who part are .09 too sure.

    Of one pair the error is .0018 (sd .0016) together and .0038 (.0045) apart, that of one Gaussian larger by .0096
    (.0094) and .086 (.031): the bounds are 4.5 sd of the mean away and more.
    """
    on, off = (rate / 0.5 * -math.expm1(-0.5 * 0.4) for rate in (0.3, 0.2))
    pairs = [walkers(seed, steps=8, together=together) for seed in range(20)]
    exact = [naive.relation_by_enumeration(z, 0.4, 0.1, 0.35, 0.5, 0.5, 0.1, 0.3, on, off)[0] for z in pairs]
    errors = {}
    for histories in (1, 4, 16):
        f = wf.RelationalFilter(pair_model(prior=0.3), gate=100.0, histories=histories)
        scenes = [follow(f, z, detect_prob=1.0) for z in pairs]
        assert all((s.pairs[0].counts <= histories).all() for s in scenes)
        errors[histories] = np.array([s.probability("together", 0, 1) for s in scenes]) - exact
    for histories in (4, 16):
        assert np.abs(errors[histories]).mean() < within
    assert np.abs(errors[1]).mean() > np.abs(errors[4]).mean()


@pytest.mark.parametrize("together", [True, False])
def test_the_predicate_is_asked_of_each_history(together):
    """Coarse detections, and a relation that comes while the predicate holds: as with sampled relations.

    Sampled by 2,000 particles it is off by -.008 and -.001 with an sd of .014 at most: the bound on the mean of 12
    seeds is 5.4 sd away.
    """
    model = pair_model(prior=0.3, on_when=near(2.0) & same_velocity(0.5))
    fixes = walkers(seed=3, steps=10, sd=0.3, together=together)
    filters = [wf.RelationalFilter(model, "rbk", particles=2_000, seed=seed) for seed in range(12)]
    sampled = [follow(f, fixes, sd=0.3, detect_prob=1.0).probability("together", 0, 1) for f in filters]
    scene = follow(wf.RelationalFilter(model), fixes, sd=0.3, detect_prob=1.0)
    assert scene.probability("together", 0, 1) == pytest.approx(np.mean(sampled), abs=0.03)


def test_the_gaussians_of_a_pair_tell_its_probability():
    """Their probabilities sum to one and those related to p; pairs far apart have a single one."""
    f = wf.RelationalFilter(pair_model(on_when=near(2.0)), gate=20.0)
    fixes = np.concatenate([walkers(steps=12), walkers(seed=1, steps=12) + np.array([0.0, 9.0])], axis=1)
    pairs = follow(f, fixes, ids=[0, 1, 2, 3]).pairs[0]
    ends = np.cumsum(pairs.counts.sum(axis=1))
    assert ends[-1] == len(pairs.states)
    for k, (p, (off, on)) in enumerate(zip(pairs.p, pairs.counts, strict=True)):
        rows = pairs.states[ends[k] - off - on : ends[k]]
        assert rows[:, 7].sum() == pytest.approx(1.0)
        assert rows[off:, 7].sum() == pytest.approx(p, abs=1e-8)
        assert (rows[:, 4] * rows[:, 6] > rows[:, 5] ** 2).all()
    far = (pairs.first < 2) & (pairs.second >= 2)
    assert far.sum() == 4
    assert (pairs.counts[far].sum(axis=1) == 1).all()
    assert (pairs.counts[~far] > 0).all()


def test_without_switches_the_probability_is_that_of_two_kalman_filters():
    """Nothing is merged and no mode is let go, however improbable."""
    still = wf.Relation(
        "still", ("person", "person"), rate_on=0.0, rate_off=0.0, prior=1e-6, couples=pair_model().relations[0].couples
    )
    model = wf.RelationalModel(pair_model().objects, [still])
    fixes = walkers(steps=7, together=False)
    exact, _ = naive.relation_by_enumeration(fixes, 0.4, 0.1, 0.35, 0.5, 0.5, 0.1, 1e-6, 0.0, 0.0)
    scene = follow(wf.RelationalFilter(model, gate=100.0), fixes, detect_prob=1.0)
    assert exact < 1e-5  # the least probability of a mode that could come back
    assert scene.probability("still", 0, 1) == pytest.approx(exact, rel=1e-3)  # its motion is that of small steps


@pytest.mark.parametrize("engine", ENGINES)
def test_the_order_of_detections_does_not_matter(engine):
    fixes = np.concatenate([walkers(steps=6), walkers(seed=1, steps=6, together=False) + np.array([0, 2.0])], axis=1)
    f = wf.RelationalFilter(pair_model(on_when=near(2.0)), engine, particles=50)
    one = follow(f, fixes, ids=[3, 1, 4, 2])
    two = follow(f, fixes[:, [2, 0, 3, 1]], ids=[4, 3, 2, 1])
    assert one.mean.tobytes() == two.mean.tobytes()
    assert one.pairs[0].p.tobytes() == two.pairs[0].p.tobytes()
    np.testing.assert_array_equal(one.ids, [1, 2, 3, 4])


@pytest.mark.parametrize("engine", ENGINES)
def test_new_names_change_names_only(engine):
    f = wf.RelationalFilter(pair_model(on_when=near(2.0)), engine, particles=50)
    one = follow(f, walkers(), ids=[5, 6])
    two = follow(f, walkers(), ids=["anna", "berta"])
    assert one.mean.tobytes() == two.mean.tobytes()
    assert one.groups(at_least=0.0) == [[5, 6]]
    assert two.groups(at_least=0.0) == [["anna", "berta"]]
    assert (two.groups() == []) == (one.groups() == [])
    assert two.relations().first.tolist() == ["anna"]
    assert one.probability("together", 6, 5) == two.probability("together", "anna", "berta") > 0.0


@pytest.mark.parametrize("engine", ENGINES)
def test_a_scene_saved_goes_on_bit_for_bit(engine, tmp_path):
    model = wf.RelationalModel(
        pair_model().objects, pair_model(on_when=near(2.0)).relations, [wf.Activity("walk", ["together"], min_time=2.0)]
    )
    f = wf.RelationalFilter(model, engine, particles=20, seed=4)
    fixes = walkers(steps=12)
    scene = follow(f, fixes[:6])
    scene.save(tmp_path / "scene")
    again = wf.Scene.load(tmp_path / "scene", model)
    for fix in fixes[6:]:
        scan = wf.Detections(fix, sd=0.1, ids=[0, 1])
        scene, again = f.step(scene, scan, dt=0.4), f.step(again, scan, dt=0.4)
    for name in ("mean", "cov", "existence", "ids"):
        assert getattr(scene, name).tobytes() == getattr(again, name).tobytes()
    assert scene.pairs[0].p.tobytes() == again.pairs[0].p.tobytes()
    assert scene.activities().probability.tobytes() == again.activities().probability.tobytes()
    with pytest.raises(ValueError, match="another relational model"):
        wf.Scene.load(tmp_path / "scene", pair_model())


@pytest.mark.parametrize("engine", ENGINES)
def test_a_scene_stored_with_the_arrays_of_both_families_goes_on(engine, tmp_path):
    """As they were written before each kind of engine had pairs of its own, and scenes knew their engine."""
    f, fixes = wf.RelationalFilter(pair_model(on_when=near(2.0)), engine, particles=20, seed=4), walkers(steps=12)
    scene = follow(f, fixes[:6])
    scene.save(tmp_path / "scene")
    arrays, meta = store.load(tmp_path / "scene", "scene")
    count = len(arrays["pairs_0_p"])
    others = {"pairs_0_counts": np.zeros((count, 2), np.int64), "pairs_0_states": np.zeros((0, 8))}
    if engine == "collapsed":
        others = {"pairs_0_bits": np.zeros((0, count), bool)}
    assert not others.keys() & arrays.keys()
    meta.pop("engine", None)
    store.save(tmp_path / "before", dict(arrays) | others, meta, "scene")
    again = wf.Scene.load(tmp_path / "before", f.model)
    for fix in fixes[6:]:
        scan = wf.Detections(fix, sd=0.1, ids=[0, 1])
        scene, again = f.step(scene, scan, dt=0.4), f.step(again, scan, dt=0.4)
    assert scene.mean.tobytes() == again.mean.tobytes()
    assert scene.pairs[0].p.tobytes() == again.pairs[0].p.tobytes()
    again.save(tmp_path / "after")
    assert store.load(tmp_path / "after", "scene")[1].get("engine", "collapsed") == engine


@pytest.mark.parametrize("engine", ENGINES)
def test_a_scene_of_another_engine_is_refused(engine, tmp_path):
    f, scan = wf.RelationalFilter(pair_model(), engine, particles=20), wf.Detections([[0.0, 0.0]], sd=0.1, ids=[0])
    for other in ENGINES:
        made = wf.RelationalFilter(pair_model(), other, particles=20)
        scene = made.step(made.start(), scan, dt=0.0)
        scene.save(tmp_path / other)
        for theirs in (made.start(), scene, wf.Scene.load(tmp_path / other, f.model)):
            if other == engine:
                f.step(theirs, scan, dt=1.0)
                continue
            with pytest.raises(ValueError, match=f"another engine, '{other}': start a new one with this '{engine}'"):
                f.step(theirs, scan, dt=1.0)


@pytest.mark.parametrize("engine", ENGINES)
def test_nothing_odd_makes_a_nan(engine):
    """Empty scans, nobody looking, coincident objects, one far away from where it was, all at one time."""
    f = wf.RelationalFilter(pair_model(on_when=near(2.0) & same_velocity(0.5) & ~slow(0.01)), engine, particles=30)
    scene = f.step(f.start(), wf.Detections([], sd=1.0, ids=[]), dt=1.0)
    assert len(scene) == 0
    assert scene.groups() == []
    scene = f.step(scene, [], dt=1.0)
    scene = f.step(scene, wf.Detections([[0.0, 0.0]] * 3, sd=0.1, ids=[1, 2, 3]), dt=1.0)
    for dt in (0.0, 0.4, 0.4):
        scene = f.step(scene, wf.Detections([[0.0, 0.0]] * 3, sd=0.1, ids=[1, 2, 3]), dt=dt)
    scene = f.step(scene, wf.Detections([[0.0, 0.0], [1e6, 0.0]], sd=1e-3, ids=[1, 2], detect_prob=1.0), dt=0.4)
    np.testing.assert_allclose(scene.mean[1, 0], [1e6, 0.0], atol=2000.0)
    scene = f.step(scene, wf.Detections([], sd=1.0, ids=[], detect_prob=0.0), dt=30.0)
    for values in (scene.mean, scene.cov, scene.existence, scene.pairs[0].p):
        assert np.isfinite(values).all()
    scene = f.step(scene, [], dt=100.0)
    assert len(scene) == 0


def test_what_does_not_fit_is_refused():
    f = wf.RelationalFilter(pair_model(), "collapsed")
    scene = f.step(f.start(), wf.Detections([[0.0, 0.0]], ids=[1]), dt=0.0)
    for bad, message in [
        (lambda: wf.Detections([[0.0, math.nan]]), "row 0"),
        (lambda: wf.Detections([[0.0, 0.0]], sd=0.0), "sd"),
        (lambda: wf.Detections([[0.0, 0.0]] * 2, ids=[1, 1]), "twice"),
        (lambda: wf.Detections([[0.0, 0.0]], detect_prob=1.5), "detect_prob"),
        (lambda: f.step(scene, wf.Detections([[0.0, 0.0]], ids=["a"]), dt=1.0), "whole numbers before"),
        (lambda: f.step(scene, wf.Detections([[0.0, 0.0]], ids=[2], kinds="ship"), dt=1.0), "ship"),
        (lambda: wf.Detections([[0.0, 0.0, 0.0]], ids=[1]), "planar"),
        (lambda: f.step(scene, [], dt=-1.0), "backwards"),
        (lambda: f.step(scene, []), "dt or time"),
        (lambda: scene.relations("married"), "married"),
        (lambda: wf.RelationalFilter(pair_model(), "fast"), "engine"),
        (lambda: wf.RelationalFilter(pair_model(), gate=0.0), "gate"),
        (lambda: wf.RelationalFilter(pair_model(), histories=17), "histories"),
        (lambda: wf.Relation("r", ("a", "b"), rate_on=-1.0), "rate_on"),
        (lambda: wf.Relation("r", ("a", "a"), couples=follow_velocity(1, 1), symmetric=True), "symmetric"),
        (lambda: wf.RelationalModel({"a": wf.ConstantVelocity(1)}, [wf.Relation("r", ("a", "b"))]), "'b'"),
        (lambda: wf.RelationalModel({"a": wf.ConstantVelocity(1)}, [], [wf.Activity("x", ["r"])]), "chain"),
        (lambda: near(2.0) and near(1.0), "&"),
    ]:
        with pytest.raises((ValueError, TypeError), match=message):
            bad()
