"""Detections without identities; coupled motion in the long run; somebody unseen is where one cannot see."""

import itertools

import numpy as np
import pytest
from bounds import fewest

import wakefold as wf
from wakefold.relations.engines.association import k_best
from wakefold.relations.motion import row


@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 3), (3, 3), (3, 5)])
def test_the_best_assignments_are_those_of_trying_all(n, m):
    cost = np.random.default_rng(n * m).normal(size=(n, m))
    every = sorted(float(cost[np.arange(n), list(c)].sum()) for c in itertools.permutations(range(m), n))
    np.testing.assert_allclose([total for total, _ in k_best(cost, 8)], every[:8], rtol=1e-12)


def test_a_pull_keeps_a_pair_at_its_spacing_in_the_long_run():
    motion = row(0.5, 0.02, 0.1**2, 10_000.0)
    np.testing.assert_allclose(motion[:4], 0.0, atol=1e-12)
    assert np.sqrt(motion[4]) == pytest.approx(0.1 / np.sqrt(2 * 0.5 * 0.02), rel=1e-6)


@pytest.mark.parametrize(
    ("engine", "seeds", "chance"),
    [("bootstrap", 40, 0.93), ("rbk", 20, 0.97), ("collapsed", 20, 0.97)],
)
def test_two_without_names_keep_their_tracks(engine, seeds, chance):
    """In 79 of 80 seeds of filter and detections by "bootstrap", by the others in all: positions within .24 m.

    An engine that loses a track in half of the seeds fails with probability .98 ("bootstrap": .999).
    """
    model = wf.RelationalModel({"person": wf.ConstantVelocity(q=0.3, speed=0.8)})
    kept = 0
    for seed in range(seeds):
        f = wf.RelationalFilter(model, engine, particles=300, gate=6.0, seed=seed)
        scene, rng = f.start(), np.random.default_rng(seed)
        for k in range(15):
            at = np.array([[0.4 * k, 0.0], [0.4 * k, 2.0]])
            z = (at + 0.1 * rng.normal(size=at.shape))[rng.permutation(2)]
            scene = f.step(scene, wf.Detections(z, sd=0.1, detect_prob=0.98, clutter=1e-4), dt=0.4)
        tracks = scene.tracks()
        if len(tracks.ids) == 2:
            kept += bool(np.abs(tracks.position[np.argsort(tracks.position[:, 1])] - at).max() < 0.5)
    assert kept >= fewest(seeds, chance)


def test_somebody_unseen_is_where_one_cannot_see():
    model = wf.RelationalModel({"person": wf.ConstantVelocity(q=0.4)})
    f = wf.RelationalFilter(model, "rbk", particles=10)
    scene = f.start()
    for k in range(30):
        seen = [[0.5 * k, 0.0]] if k < 6 else []
        visible = lambda x: np.where((x[:, 0] > 3.0) & (x[:, 0] < 6.0), 0.0, 0.98)  # noqa: E731
        scene = f.step(scene, wf.Detections(seen, sd=0.1, ids=[1][: len(seen)], detect_prob=visible), dt=0.4)
    assert 2.0 < scene.mean[0, 0, 0] < 7.0  # at constant velocity: 14 m
