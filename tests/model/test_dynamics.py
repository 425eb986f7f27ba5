"""The velocity fields of the classes, their defaults and refusals."""

import math

import naive
import numpy as np
import pytest

import wakefold as wf


def bundle(seed=0, count=12, dim=2):
    rng = np.random.default_rng(seed)
    tracks, times = [], []
    for i in range(count):
        n = 1 if i == 5 else int(rng.integers(2, 14))
        tracks.append(rng.normal(size=dim) * 2 + np.cumsum(rng.normal(0.7, 0.4, size=(n, dim)), axis=0))
        times.append(np.cumsum(rng.uniform(0.5, 2.0, size=n)))
    return wf.Tracks.from_arrays(tracks, times)


@pytest.mark.parametrize("dim", [1, 2, 3, 5])
def test_velocity_is_the_inverse_distance_mean_in_the_ball_of_the_class(dim):
    tracks = bundle(dim, dim=dim)
    model = wf.learn(tracks, epsilon=1.5)
    d, tree = model.dynamics, model.filtration
    members = [(tracks[i], naive.forward_difference(tracks[i], tracks.times_of(i))) for i in range(len(tracks))]
    rng = np.random.default_rng(3)
    rows = rng.integers(len(tracks.points), size=30)
    near = tracks.points[rows] + rng.normal(size=(30, dim)) * rng.choice([0.0, 0.1, 1.0, 30.0], size=(30, 1))
    for c in range(len(tree.birth)):
        expected = [naive.local_velocity(z, [members[t] for t in tree.members(c)], d.epsilon, d.floor) for z in near]
        np.testing.assert_allclose(d.velocity(near, c), expected, rtol=1e-10, atol=1e-12)


def test_velocities_are_forward_differences_in_leaf_order():
    tracks = bundle(7)
    model = wf.learn(tracks)
    d, tree = model.dynamics, model.filtration
    for rank, track in enumerate(tree.order):
        rows = slice(d.starts[rank], d.starts[rank + 1])
        assert np.array_equal(d.points[rows], tracks[int(track)])
        expected = naive.forward_difference(tracks[int(track)], tracks.times_of(int(track)))
        np.testing.assert_allclose(d.velocities[rows], expected, rtol=1e-14)


def test_default_epsilon_is_the_larger_of_spacing_and_leaf_death():
    tracks = bundle(2)
    model = wf.learn(tracks)
    steps = np.concatenate([np.linalg.norm(np.diff(t, axis=0), axis=1) for t in tracks])
    deaths = model.filtration.death[: len(tracks)]
    assert model.dynamics.epsilon == pytest.approx(max(2 * np.median(steps), np.median(deaths)) * (1 + 1e-9), rel=1e-14)
    assert model.dynamics.interval == pytest.approx(
        np.median(np.concatenate([np.diff(tracks.times_of(i)) for i in range(12)]))
    )
    assert model.sd == pytest.approx(np.median(steps) / 2)


def test_learned_noise_measures_how_far_tracks_depart_from_their_closest_class():
    tracks = bundle(4, count=14)
    model = wf.learn(tracks, epsilon=2.0)
    tree, d = model.filtration, model.dynamics
    members = [(tracks[i], naive.forward_difference(tracks[i], tracks.times_of(i))) for i in range(len(tracks))]
    residuals = []
    for i, (points, velocities) in enumerate(members):
        others = [members[t] for t in tree.members(int(tree.parent[i])) if t != i]
        for z, v in zip(points, velocities, strict=True):
            if min(naive.distance(z, p) for points, _ in others for p in points) < d.epsilon:
                residuals += list(np.abs(v - naive.local_velocity(z, others, d.epsilon, d.floor)))
    assert d.scale == pytest.approx(1.4826 * np.median(residuals) * math.sqrt(d.interval), rel=1e-9)
    assert wf.learn(tracks.select([0])).dynamics.scale == 0.0


def test_substeps_split_long_steps_evenly():
    d = wf.learn(wf.Tracks.from_arrays([np.arange(20.0)], [np.arange(20.0) * 10])).dynamics
    assert [d.substeps(x) for x in (0.0, 1.0, 10.0, 10.0000001, 20.0, 95.0)] == [0, 1, 1, 2, 2, 10]


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"epsilon": 0.0}, "epsilon"),
        ({"epsilon": math.nan}, "epsilon"),
        ({"noise": "pink"}, "noise"),
        ({"scale": -1.0}, "scale"),
        ({"scale": math.inf}, "scale"),
        ({"sd": 0.0}, "sd"),
    ],
)
def test_settings_out_of_range_are_named(settings, match):
    with pytest.raises(ValueError, match=match):
        wf.learn(bundle(), **settings)


def test_all_points_in_one_place():
    model = wf.learn(wf.Tracks.from_arrays([np.ones((3, 2)), np.ones((1, 2)), np.ones((2, 2))]))
    assert model.dynamics.diagonal == 0.0
    assert not model.dynamics.velocity([[1.0, 1.0], [5.0, 5.0]], 0).any()
    f = wf.MHPF(model, 20, likelihood="log")
    belief = f.step(f.start(), [wf.Fix((1.0, 1.0)), wf.CoarseClass(model.filtration.root)], dt=1.0)
    assert np.isfinite(belief.mean()).all()


def test_rounding_does_not_decide_whether_the_default_ball_holds_the_point_that_made_it():
    for seed in range(300):
        a, b = np.random.default_rng(seed).normal(size=(2, 1, 2)) * 10
        model = wf.learn(wf.Tracks.from_arrays([a, b]))
        assert np.square(a - b).sum() < model.dynamics.reach[0]  # Fréchet distance of two points: the default


def test_what_is_no_tracks_is_told_how_to_become_so():
    arrays = [np.zeros((3, 2)), np.ones((2, 2))]
    for learn in (wf.learn, wf.Filtration.fit):
        with pytest.raises(TypeError, match=r"Tracks\.from_arrays"):
            learn(arrays)


@pytest.mark.parametrize("dim", [4, 7])
def test_configuration_spaces_of_many_dimensions(dim, tmp_path):
    """Distances, tree and filters; velocities against their definition are tested above."""
    from wakefold.model.linkage import dendrogram
    from wakefold.model.linkage.spanning import spanning_tree

    tracks = bundle(dim, dim=dim)
    distances = wf.frechet_matrix(tracks)
    assert np.array_equal(distances, [[naive.frechet(a, b) for b in tracks] for a in tracks])
    model = wf.learn(tracks)
    gaps = dendrogram.leaf_order(*spanning_tree(tracks))[1]
    assert np.array_equal(np.sort(gaps), np.sort(model.filtration.gaps))
    model.save(tmp_path / "model")
    again = wf.load(tmp_path / "model")
    for make in (wf.BL1, wf.MHPF, wf.Calibrated):
        one, two = (make(m, 60, seed=1) for m in (model, again))
        a, b = (f.step(f.start(), [wf.Fix(tracks[4][0], sd=0.5)], dt=1.0) for f in (one, two))
        assert a.mean("stack").shape == (dim,)
        assert np.array_equal(a.points, b.points)
        assert np.isfinite(a.cov()).all()
    with pytest.raises(ValueError, match="d = 1 to 16"):
        wf.Tracks.from_arrays([np.zeros((2, 17))])
