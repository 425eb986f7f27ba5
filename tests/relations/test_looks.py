"""What related pairs look like: evidence that adds up frame by frame and fades, and constants learned for it."""

import naive
import numpy as np
import pytest
from people import DT, ready
from test_relational import ENGINES

import wakefold as wf
from wakefold.experiments.stats import f1
from wakefold.relations.learning.together import fit

PRIOR = 0.3


@pytest.fixture(scope="module")
def known():
    """Scenes whose groups are known."""
    return [ready(seed) for seed in (1, 2, 3)]


def looks(fade, scale=1.0):
    edges = [0.0, 0.8, 1.0, 1.3, 8.0]
    table = np.array([0.5, 1.0, -0.4, -2.0])[:, None, None] * np.array([1.0, 0.4])[:, None] + np.array([0.0, 0.1])
    return wf.PairEvidence(edges, [0.0, 0.3, 4.0], [0.0, 0.4, 2.0], scale * table, fade=fade)


def model(evidence, activities=()):
    relation = wf.Relation("together", ("person", "person"), rate_on=0, rate_off=0, prior=PRIOR, evidence=evidence)
    return wf.RelationalModel({"person": wf.ConstantVelocity(q=0.35, speed=0.5)}, [relation], activities)


def walk(steps, seed=0):
    """Times (T,) that are not even, fixes (T, 2, 2) of two side by side, and whether the second is seen."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(np.concatenate([[0.0], rng.uniform(0.2, 0.8, steps - 1)]))
    fixes = np.stack([np.column_stack([0.5 * t, 0.0 * t]), np.column_stack([0.5 * t, 1.0 + 0.0 * t])], axis=1)
    there = np.arange(steps) % 5 != 3
    return t, fixes + rng.normal(0, 0.1, fixes.shape), there


def run(f, t, fixes, there, names=(0, 1), others=None):
    scenes = [f.start(t[0])]
    for k in range(len(t)):
        ids, at = list(names[: 1 + there[k]]), list(fixes[k, : 1 + there[k]])
        for name, place in others(k) if others else ():
            ids.append(name)
            at.append(place)
        scenes.append(f.step(scenes[-1], wf.Detections(at, sd=0.1, ids=ids), time=t[k]))
    return scenes[1:]


@pytest.mark.parametrize("fade", [0.0, 0.4])
@pytest.mark.parametrize(("engine", "within"), [("collapsed", 1e-9), ("rbk", 0.04)])
def test_looks_add_up_as_in_a_plain_loop(engine, within, fade):
    """Sampled relations have sd .0085 about the plain loop (.012 with 2,000 particles): false alarms 3e-6."""
    t, fixes, there = walk(25)
    f = wf.RelationalFilter(model(looks(fade)), engine, particles=4000)
    scenes = run(f, t, fixes, there)
    own = np.array([s.own_mean if engine == "collapsed" else s.mean for s in scenes[1:]])
    relative = own[:, 1] - own[:, 0]
    if engine == "collapsed":  # what it keeps of the pair, both modes alike
        relative = np.array([s.pairs[0].states[-1, :4].reshape(2, 2) for s in scenes[1:]])
    told = naive.faded_looks(relative, np.hypot(*own[:, :, 1].T).T, there[1:], np.diff(t), looks(fade))
    assert abs(told) > 0.3  # of this walk: there is something to tell
    p = 1 / (1 + (1 - PRIOR) / PRIOR * np.exp(-told))
    assert scenes[-1].probability("together", 0, 1) == pytest.approx(p, abs=within)


@pytest.mark.parametrize("engine", ENGINES)
def test_seconds_in_which_one_is_hidden_do_not_count(engine):
    t, fixes, there = walk(25)
    scene = run(wf.RelationalFilter(model(looks(0.4)), engine, particles=5), t, fixes, there)[-1]
    assert scene.pairs[0].looked == pytest.approx(np.diff(t)[there[1:]].sum())


def test_how_often_one_looks_does_not_matter():
    """Two who stand still, seen every 0.4 and every 0.1 s."""
    beliefs = []
    for dt in (0.4, 0.1):
        t = dt * np.arange(round(8.0 / dt) + 1)
        fixes = np.tile([[0.0, 0.0], [0.0, 0.9]], (len(t), 1, 1))
        f = wf.RelationalFilter(model(looks(0.4, scale=0.3)), "collapsed")
        beliefs.append(run(f, t, fixes, np.ones(len(t), bool))[-1].probability("together", 0, 1))
    assert beliefs[0] == pytest.approx(1 / (1 + (1 - PRIOR) / PRIOR * np.exp(-0.3 * 8.0**0.6)), abs=1e-9)
    assert beliefs[1] == pytest.approx(beliefs[0], abs=1e-9)


def test_what_was_seen_of_a_pair_stays_with_it_whoever_comes_and_goes():
    t, fixes, there = walk(25)
    f = wf.RelationalFilter(model(looks(0.4)), "collapsed", forget=1.0)

    def others(k):
        """Passers-by, each there for four frames."""
        return [(10 + i, [0.5 * t[k], 2.0 + i % 3]) for i in range(8) if 3 * i <= k < 3 * i + 4]

    def backwards(k):
        return others(k)[::-1]

    alone = run(f, t, fixes, there)
    for names in ((0, 1), (40, 41)):  # those who were there first come first, and last, in order of names
        scenes = run(f, t, fixes, there, names, others)
        again = run(f, t, fixes, there, names, backwards)
        for one, many, turned in zip(alone, scenes, again, strict=True):
            p = many.probability("together", *names)
            assert p == pytest.approx(one.probability("together", 0, 1), abs=1e-12)
            assert p == turned.probability("together", *names)
        assert len(scenes[-1].pairs[0].looked) > 1
        assert scenes[-1].pairs[0].looked.max() == alone[-1].pairs[0].looked[0]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_scene_saved_knows_how_long_it_looked(engine, tmp_path):
    t, fixes, there = walk(16)
    f = wf.RelationalFilter(model(looks(0.4)), engine, particles=20)
    whole = run(f, t, fixes, there)
    whole[7].save(tmp_path / "scene")
    scene = wf.Scene.load(tmp_path / "scene", f.model)
    for k in range(8, 16):
        seen = wf.Detections(fixes[k, : 1 + there[k]], sd=0.1, ids=[0, 1][: 1 + there[k]])
        scene = f.step(scene, seen, time=t[k])
        assert scene.pairs[0].looked.tobytes() == whole[k].pairs[0].looked.tobytes()
        assert scene.pairs[0].p.tobytes() == whole[k].pairs[0].p.tobytes()


@pytest.mark.parametrize("fade", [-0.1, 1.0, float("nan")])
def test_a_fade_out_of_range_is_refused(fade):
    with pytest.raises(ValueError, match="fade"):
        looks(fade)


def at_the_end(walkers, pairs, relation):
    """Probability of each pair at its last frame, by the filter."""
    f = wf.RelationalFilter(wf.RelationalModel({"person": wf.ConstantVelocity(q=0.15)}, [relation]), gate=30.0)
    scene, p = f.start(), np.zeros(len(pairs.first))
    for frame in range(int(walkers.begin.min()), int(walkers.end.max())):
        here = np.flatnonzero((walkers.begin <= frame) & (walkers.end > frame))
        at = walkers.seen[walkers.offsets[here] + frame - walkers.begin[here]]
        scene = f.step(scene, wf.Detections(at, sd=0.1, ids=here), dt=DT)
        for k in np.flatnonzero(pairs.end == frame + 1):
            p[k] = scene.probability(relation.name, int(pairs.first[k]), int(pairs.second[k]))
    return p


@pytest.mark.parametrize("fade", [0.0, 0.15])
def test_the_filter_recognises_twos_with_constants_learned(known, fade):
    """Means of four scenes, which over scenes, those learned from too, are .984 (sd .015) and .0028 (.0007).

    So the bounds are 5 and 10 sd away. A filter that counts no looks finds nobody and is .18 (.015) off.
    """
    constants = fit([c for _, c, _ in known], [y for *_, y in known], fade=fade, online=True)
    told = []
    for seed in (11, 12, 13, 14):
        walkers, people, truth = ready(seed, people=40, spacing=1.2)
        own = constants.settle(people)
        p = at_the_end(walkers, people.pairs, constants.relation(people, own))
        whole = constants.over_time(walkers, people, own)[people.pairs.offsets[1:] - 1]
        told.append((f1(truth, p > 0.5), np.abs(p - whole).mean()))
    found, off = np.mean(told, axis=0)
    assert found > 0.9
    assert off < 0.01  # the filter does not count the first frame, and reads a table


def test_constants_that_do_not_add_up_make_no_relation(known):
    _, people, truth = known[0]
    constants = fit([people], [truth])
    with pytest.raises(ValueError, match="online"):
        constants.relation(people, constants.settle(people))
