"""MHPF, BL1 and BL2 against the definitions of docs/algorithm.md, written as loops in naive.py."""

import math

import naive
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import bundles

import wakefold as wf
from wakefold.base import random
from wakefold.base.random import agent_key
from wakefold.filters.particles import COPIES, NOISE, OPEN


@pytest.fixture(scope="module")
def model():
    return wf.learn(bundles(), scale=0.4, sd=1.5)


def naive_field(model):
    d, tracks = model.dynamics, model.tracks
    members = [(tracks[i], naive.forward_difference(tracks[i], tracks.times_of(i))) for i in range(len(tracks))]

    def velocity(z, c):
        chosen = [members[t] for t in model.filtration.members(c)]
        return naive.local_velocity(z, chosen, d.epsilon, d.floor)

    return velocity


def naive_draws(f, belief, h, stack):
    """The random numbers that a step of ``f`` will use, in the naive step's terms."""
    count, dim = f.particles, f.model.dynamics.dim
    changed = round(f.depletion * count)
    u = np.empty(2 + changed)
    random.uniforms(belief.key, belief.step + 1, OPEN, u)
    where = ((np.arange(changed) + u[1]) * (count / changed)).astype(int) if changed else []
    noise = np.empty(count * dim)
    random.normals(belief.key, belief.step + 1, NOISE, noise)
    copy_noise = np.empty(len(stack.points) * dim if stack else 0)
    random.normals(belief.key, belief.step + 1, COPIES, copy_noise)
    scale = f.model.dynamics.scale * math.sqrt(h)
    rows = copy_noise.reshape(-1, dim) * scale
    return {
        "positions": (np.arange(count) + u[0]) / count,
        "replace": [(int(i), int(x * len(f.model.tracks))) for i, x in zip(where, u[2:], strict=True)],
        "noise": noise.reshape(-1, dim) * scale,
        "rows": rows,
    }


@pytest.mark.parametrize("dim", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("rule", ["arxiv2016", "gsi2017"])
@pytest.mark.parametrize("family", ["log", "gaussian", "student"])
def test_a_step_is_the_naive_step_with_the_same_draws(rule, family, dim):
    model = wf.learn(bundles(seed=dim, dim=dim), scale=0.4, sd=1.5)
    tree, diagonal = model.filtration, model.dynamics.diagonal
    for levels in ("all", [float(tree.birth[tree.root]) * 0.6]):
        f = wf.MHPF(model, 40, rule=rule, likelihood=family, levels=levels, depletion=0.1, seed=3)
        belief = f.start()
        rng = np.random.default_rng(1)
        for _ in range(4):
            track = int(rng.integers(len(tree)))
            coarse_level = float(rng.choice(tree.birth[tree.birth > 0]))
            finer = float(rng.choice(tree.birth))
            named, other = tree.class_at(track, coarse_level), tree.class_at(track, finer)
            position = belief.points[np.argmax(belief.weights)] + rng.normal(size=dim)
            evidence = [
                wf.CoarseClass(named, level=coarse_level, confidence=0.7),
                wf.Fix(position, sd=2.0),
                wf.CoarseClass(other, level=finer),
            ]
            h = model.dynamics.interval * 0.9
            after = f.step(belief, evidence, dt=h)
            draws = naive_draws(f, belief, h, after.stack)
            where = {}  # (class, particle) -> row of the copies, which are grouped by class in particle order
            nodes, start = after.stack.nodes, after.stack.start
            items = sorted([(coarse_level, named, 0.7), (finer, other, 0.9)], key=lambda item: item[0])
            used = sorted({int(c) for c, n in zip(nodes, np.diff(start), strict=True) if n > 0})
            kept = naive.resample(belief.weights, draws["positions"])
            classes = [int(belief.classes[i]) for i in kept]
            for particle, c in draws["replace"]:
                classes[particle] = c
            for a, c in enumerate(nodes):
                below = [i for i, leaf in enumerate(classes) if naive.holds(tree, int(c), leaf)]
                for k, i in enumerate(below if start[a + 1] > start[a] else []):
                    where[int(c), i] = start[a] + k
            draws["copy_noise"] = lambda c, i, where=where, draws=draws: draws["rows"][where[c, i]]
            sets, mass, log_evidence = naive.mhpf_step(
                tree,
                naive_field(model),
                (belief.points, belief.classes, belief.weights),
                [("fix", position, 2.0), *(("coarse", c, level, p) for level, c, p in items)],
                used,
                rule,
                family,
                draws,
                h,
                f.dof,
                diagonal,
            )
            assert after.recoveries == belief.recoveries
            np.testing.assert_allclose(after.points, [x[0] for x in sets["base"]], rtol=0, atol=1e-10)
            assert after.classes.tolist() == [x[1] for x in sets["base"]]
            np.testing.assert_allclose(after.weights, [x[2] for x in sets["base"]], rtol=0, atol=1e-10)
            assert set(used) == set(sets) - {"base"}
            for a in np.flatnonzero(np.diff(start) > 0):
                expected = sets[int(nodes[a])]
                np.testing.assert_allclose(
                    after.stack.points[start[a] : start[a + 1]], [x[0] for x in expected], rtol=0, atol=1e-10
                )
                np.testing.assert_allclose(
                    np.exp(after.stack.log_weights[start[a] : start[a + 1]]), [x[2] for x in expected], atol=1e-10
                )
            if family == "log" or rule == "arxiv2016":
                assert after.log_evidence is None
            else:
                assert after.log_evidence - belief.log_evidence == pytest.approx(log_evidence, abs=1e-9)
            everything = [x for members in sets.values() for x in members]
            np.testing.assert_allclose(
                after.mean("stack"), np.average([x[0] for x in everything], axis=0, weights=[x[2] for x in everything])
            )
            if rule == "gsi2017":  # class masses of the algorithm are the weights of the base set
                for c in range(len(tree.birth)):
                    assert after.probability(c) == pytest.approx(mass[c], abs=1e-10)
            belief = after


@pytest.mark.parametrize("dim", [2, 4, 5])
@pytest.mark.parametrize("likelihood", ["log", "gaussian", "student"])
def test_the_base_level_under_gsi2017_and_fixes_is_bl1_draw_for_draw(likelihood, dim):
    model = wf.learn(bundles(dim=dim), scale=0.4, sd=1.5)
    mhpf = wf.MHPF(model, 60, rule="gsi2017", likelihood=likelihood, levels="all", depletion=0.05, seed=5)
    bl1 = wf.BL1(model, 60, likelihood=likelihood, depletion=0.05, seed=5)
    a, b = mhpf.start(), bl1.start()
    for i, point in enumerate(model.tracks[4]):
        evidence = [] if i == 1 else [wf.Fix(point, sd=None if i % 2 else 3.0)]
        a, b = mhpf.step(a, evidence, dt=2.3), bl1.step(b, evidence, dt=2.3)
        assert np.array_equal(a.points, b.points)
        assert np.array_equal(a.classes, b.classes)
        np.testing.assert_allclose(a.weights, b.weights, rtol=1e-12)
        assert a.recoveries == b.recoveries
        if likelihood != "log":
            assert a.log_evidence == pytest.approx(b.log_evidence, rel=1e-12)


def test_bl1_with_coarse_evidence_weighs_leaves_through_their_ancestors(model):
    tree = model.filtration
    level = float(np.median(tree.birth[tree.birth > 0]))
    named = tree.class_at(4, level)
    f = wf.BL1(model, 80, coarse=True, depletion=0.0, seed=1)
    plain = wf.BL1(model, 80, depletion=0.0, seed=1)
    others = len(tree.alive(level)) - 1
    belief = f.step(f.start(), [wf.CoarseClass(named, level=level, confidence=0.6)], dt=0.0)
    g = np.array([0.6 if naive.holds(tree, named, int(c)) else 0.4 / others for c in belief.classes])
    np.testing.assert_allclose(belief.weights, g / g.sum(), atol=1e-14)
    assert belief.log_evidence == pytest.approx(math.log(g.mean()))
    ignoring = plain.step(plain.start(), [wf.CoarseClass(named, level=level)], dt=0.0)
    assert ignoring.ignored == 1
    assert np.allclose(ignoring.weights, 1 / 80)


def test_bl2_is_one_class_and_ignores_coarse_evidence(model):
    tree = model.filtration
    f = wf.BL2(model, 30, seed=1)
    belief = f.step(f.start(), [wf.CoarseClass(4), wf.Fix(model.tracks[5][1])], dt=1.0)
    assert belief.ignored == 1
    top = float(tree.birth[tree.root])
    assert belief.map(top) == tree.root
    assert belief.probability(tree.root) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="does not tell classes apart"):
        belief.level(top / 2)
    with pytest.raises(ValueError, match="does not tell classes apart"):
        belief.probability(0)


@given(seed=st.integers(0, 10_000), rule=st.sampled_from(["arxiv2016", "gsi2017"]), steps=st.integers(1, 5))
def test_masses_are_consistent_at_every_step_and_level(seed, rule, steps):
    model = wf.learn(bundles(seed % 7), scale=0.5, sd=1.0)
    tree = model.filtration
    rng = np.random.default_rng(seed)
    f = wf.MHPF(model, 50, rule=rule, levels=3, depletion=0.1, seed=seed)
    belief = f.start()
    for _ in range(steps):
        track = int(rng.integers(len(tree)))
        level = float(rng.choice(tree.birth[tree.birth > 0]))
        evidence = [wf.Fix(model.tracks[track][0] + rng.normal(size=2), sd=2.0)] if rng.random() < 0.7 else []
        if rng.random() < 0.5:
            evidence.append(wf.CoarseClass(tree.class_at(track, level), level=level))
        belief = f.step(belief, evidence, dt=float(rng.choice([0.0, 0.4, 1.0, 3.7])))
        assert np.isfinite(belief.points).all()
        assert belief.weights.sum() == pytest.approx(1.0, abs=1e-12)
        assert 1.0 <= belief.ess <= 50 + 1e-9
        leaf = {t: belief.weights[belief.classes == t].sum() for t in range(len(tree))}  # a walk of the tree
        for c in range(len(tree.birth)):
            assert belief.probability(c) == pytest.approx(sum(leaf[t] for t in tree.members(c).tolist()), abs=1e-12)
            if len(children := tree.children(c)):
                assert abs(belief.probability(c) - sum(belief.probability(int(k)) for k in children)) <= 1e-12
        for b in [0.0, *rng.choice(tree.birth, 3)]:
            table = belief.level(float(b))
            assert table.probability.sum() == pytest.approx(1.0, abs=1e-12)
            assert sorted(table.classes) == sorted(tree.alive(float(b)))
            assert belief.map(float(b)) == table.classes[0]


def test_missing_observations_and_irregular_steps(model):
    f = wf.MHPF(model, 50, levels="all", seed=2)
    a = f.start(fix=wf.Fix(model.tracks[4][0], sd=2.0), time="2020-12-08T00:00:00Z")
    b = f.step(a, [], time="2020-12-08T00:00:05Z")
    c = f.step(a, dt=5.0)
    assert np.array_equal(b.points, c.points)
    assert b.time == c.time == a.time + 5
    assert b.log_evidence == 0.0
    assert np.allclose(b.weights, 1 / 50)
    again = f.step(b, [wf.Fix(model.tracks[4][1], sd=5.0)], dt=0.0)  # a second sensor at the same time
    assert again.time == b.time
    for bad in (-1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="dt must be"):
            f.step(b, [], dt=bad)
    with pytest.raises(ValueError, match="time runs backwards"):
        f.step(b, [], time=b.time - 1)
    with pytest.raises(ValueError, match="either dt or time"):
        f.step(b, [])
    with pytest.raises(ValueError, match="start anew"):
        f.step(b, [], dt=1e12)


def test_noise_is_brownian_over_substeps_or_uniform_once_a_step():
    still = wf.Tracks.from_arrays([np.zeros((5, 2))], [np.arange(5.0)])
    brown = wf.learn(still, scale=2.0, sd=1.0)
    f = wf.BL1(brown, 20_000, depletion=0.0)
    moved = f.step(f.start(), [], dt=9.0).points
    assert moved.std() == pytest.approx(2.0 * 3.0, rel=0.02)
    box = wf.learn(still, noise="uniform", scale=0.5, sd=1.0)
    f = wf.BL1(box, 20_000, depletion=0.0)
    moved = f.step(f.start(), [], dt=9.0).points
    assert np.abs(moved).max() <= 0.5
    assert moved.std() == pytest.approx(1 / math.sqrt(12), rel=0.02)
    assert not f.step(f.start(), [], dt=0.0).points.any()


def test_an_agent_is_the_same_alone_in_company_and_in_threads(model):
    from concurrent.futures import ThreadPoolExecutor

    f = wf.MHPF(model, 50, levels="all", seed=9)

    def follow(track):
        belief = f.start(agent=f"agent {track}")
        for point in model.tracks[track]:
            belief = f.step(belief, [wf.Fix(point, sd=1.0)], dt=1.0)
        return belief

    alone = [follow(t) for t in range(6)]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(follow, list(range(6)) * 4))
    for i, belief in enumerate(together):
        same = alone[i % 6]
        assert np.array_equal(belief.points, same.points)
        assert np.array_equal(belief.log_weights, same.log_weights)
        assert np.array_equal(belief.stack.points, same.stack.points)
    assert not np.array_equal(agent_key(0, "a"), agent_key(0, "b"))
    assert not np.array_equal(f.start(agent="a").points, f.start(agent="b").points)


def test_a_step_changes_nothing_it_was_given(model):
    f = wf.MHPF(model, 30, seed=0)
    belief = f.step(f.start(), [wf.Fix(model.tracks[0][0])], dt=1.0)
    before = [belief.points.copy(), belief.classes.copy(), belief.log_weights.copy()]
    first = f.step(belief, [wf.Fix(model.tracks[0][1])], dt=1.0)
    f.forecast(belief, 10.0)
    second = f.step(belief, [wf.Fix(model.tracks[0][1])], dt=1.0)
    after = [belief.points, belief.classes, belief.log_weights]
    assert all(np.array_equal(x, y) for x, y in zip(before, after, strict=True))
    assert np.array_equal(first.points, second.points)


def test_forecast_keeps_weights_and_classes_and_has_one_path_through_several_horizons(model):
    f = wf.MHPF(model, 200, seed=0)
    belief = f.step(f.start(time=100.0), [wf.Fix(model.tracks[5][1], sd=1.0)], dt=1.0)
    near, far = f.forecast(belief, [0.0, 3.0])
    assert np.array_equal(near.points, belief.points)
    assert np.array_equal(far.classes, belief.classes)
    assert np.array_equal(far.log_weights, belief.log_weights)
    assert far.time == belief.time + 3.0
    assert far.step == belief.step
    with pytest.raises(ValueError, match="rising"):
        f.forecast(belief, [3.0, 1.0])
    with pytest.raises(ValueError, match="rising"):
        f.forecast(belief, -1.0)


def test_start_draws_the_prior(model):
    f = wf.BL1(model, 50_000, seed=4)
    begin = f.start(at="begin")
    share = np.bincount(begin.classes, minlength=len(model.tracks)) / 50_000
    assert np.abs(share - 1 / len(model.tracks)).max() < 5 * math.sqrt(1 / 9 * 8 / 9 / 50_000)
    for t in range(len(model.tracks)):
        assert np.array_equal(np.unique(begin.points[begin.classes == t], axis=0), model.tracks[t][:1])
    anywhere = f.start()
    track = int(np.argmax(model.tracks.lengths))
    along = anywhere.points[anywhere.classes == track]
    times = model.tracks.times_of(track)
    fine = np.linspace(times[0], times[-1], 20_001)
    mean = [np.interp(fine, times, column).mean() for column in model.tracks[track].T]
    assert np.abs(along.mean(axis=0) - mean).max() < 5 * along.std() / math.sqrt(len(along))
    near = f.start(fix=wf.Fix(model.tracks[track][2], sd=0.8))
    distance2 = np.square(model.tracks.points - model.tracks[track][2]).sum(axis=1)
    p = np.exp(-0.5 * distance2 / 0.8**2)
    expected = p / p.sum() @ model.tracks.points
    assert np.abs(near.mean() - expected).max() < 5 * near.points.std() / math.sqrt(50_000)


# Recovery


@pytest.mark.parametrize("kind", [wf.MHPF, wf.BL1, wf.BL2])
@pytest.mark.parametrize("likelihood", ["gaussian", "student"])  # "log" starts all over the plane
def test_a_lost_agent_is_found_again_and_counted(model, kind, likelihood):
    f = kind(model, 40, likelihood=likelihood, seed=0)
    belief = f.start(fix=wf.Fix(model.tracks[0][0], sd=0.5))
    away = int(np.argmax(np.linalg.norm([t.mean(axis=0) - model.tracks[0].mean(axis=0) for t in model.tracks], axis=1)))
    belief = f.step(belief, [wf.Fix(model.tracks[away][0], sd=0.5)], dt=0.0)
    assert belief.recoveries == 1
    assert np.isfinite(belief.points).all()
    assert np.linalg.norm(belief.mean() - model.tracks[away][0]) <= 1.0


@pytest.mark.parametrize("kind", [wf.MHPF, wf.BL1, wf.BL2])
@pytest.mark.parametrize("likelihood", ["gaussian", "student", "log"])
@pytest.mark.parametrize("far", [1e7, 1e200, 1e308])
def test_a_fix_out_of_this_world_is_a_counted_recovery_never_nan(model, kind, likelihood, far):
    f = kind(model, 40, likelihood=likelihood, seed=0)
    belief = f.start()
    for sign in (1, -1):
        belief = f.step(belief, [wf.Fix((sign * far, far), sd=1.0)], dt=1.0)
        assert np.isfinite(belief.points).all()
        assert np.isfinite(belief.log_weights).all()
        assert not math.isnan(belief.log_evidence or 0.0)
    assert belief.recoveries == 2
    assert belief.weights.sum() == pytest.approx(1.0)
    started = f.start(fix=wf.Fix((far, far), sd=1.0))
    assert np.isfinite(started.points).all()


@pytest.mark.parametrize("sd", [1e-3, 1e-160, 1e-300])
def test_a_fix_surer_than_the_arithmetic_starts_at_the_nearest_points(model, sd):
    f = wf.BL1(model, 40, seed=0)
    target = model.tracks[4][0]
    assert np.allclose(f.start(fix=wf.Fix(target + 1e-4, sd=sd)).points, target)
    belief = f.step(f.start(), [wf.Fix(target + 1e-4, sd=sd)], dt=1.0)
    assert belief.recoveries == 1
    found = np.unique(belief.points, axis=0)
    assert len(found) == 1
    assert np.allclose(found[0], target)


@pytest.mark.parametrize("kind", [wf.MHPF, lambda *a, **k: wf.BL1(*a, coarse=True, **k)])
def test_certain_evidence_of_a_class_without_particles_is_a_counted_recovery(model, kind):
    tree = model.filtration
    f = kind(model, 40, depletion=0.0, seed=0)
    belief = f.start(fix=wf.Fix(model.tracks[0][0], sd=1e-3))
    other = next(t for t in range(len(tree)) if tree.tree_distance(t, 0) == tree.birth[tree.root])
    level = float(np.nextafter(tree.birth[tree.root], 0))
    named = tree.class_at(other, level)
    belief = f.step(belief, [wf.CoarseClass(named, level=level, confidence=1.0)], dt=0.0)
    assert belief.recoveries == 1
    assert belief.probability(named) == pytest.approx(1.0)
    assert belief.log_evidence == -math.inf
    belief = f.step(belief, [wf.Fix(model.tracks[other][0], sd=1.0)], dt=1.0)
    assert not np.isnan(belief.mean()).any()
