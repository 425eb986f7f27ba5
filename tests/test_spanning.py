"""The minimum spanning tree without the matrix: the same tree as with it, and bounds that bound."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wakefold import filtration, spanning
from wakefold.dendrogram import leaf_order
from wakefold.distance import frechet_matrix
from wakefold.filtration import Filtration
from wakefold.spanning import spanning_tree
from wakefold.tracks import Tracks


def walks(rng, count, dim, longest):
    return [
        rng.normal(0, 20, dim) + np.cumsum(rng.normal(0, 1, (n, dim)), axis=0)
        for n in rng.integers(1, longest + 1, count)
    ]


def equal_lengths(rng, count, dim):
    return [rng.normal(0, 20, dim) + np.cumsum(rng.normal(0, 1, (12, dim)), axis=0) for _ in range(count)]


def clusters(rng, count, dim):
    """Few routes, little noise: most pairs of a cluster are nearer than any pair across."""
    routes = [rng.uniform(0, 1000, (2, dim)) for _ in range(4)]
    at = np.linspace(0, 1, 9)[:, None]
    return [
        (1 - at) * (route := routes[rng.integers(4)])[0] + at * route[1] + rng.normal(0, 2, (9, dim))
        for _ in range(count)
    ]


def two_hubs(rng, count, dim):
    """All begin at one place and end at another: end points tell nothing."""
    at = np.linspace(0, 1, 15)[:, None]
    bends = [np.sin(k * np.pi * at) * rng.normal(0, 40, (count, 1, dim)) for k in (1, 2)]
    return list(at * 1000 + bends[0] + bends[1])


def on_a_grid(rng, count, dim):
    return [rng.integers(0, 5, (n, dim)).astype(float) for n in rng.integers(1, 5, count)]


def duplicates(rng, count, dim):
    few = walks(rng, 4, dim, 6)
    return [few[k] for k in rng.integers(0, 4, count)]


def collinear(rng, count, dim):
    return [np.outer(np.cumsum(rng.integers(-2, 3, n)), np.ones(dim)) for n in rng.integers(1, 20, count)]


def points(rng, count, dim):
    return [rng.normal(size=(1, dim)) for _ in range(count)]


def mixed_lengths(rng, count, dim):
    return [np.cumsum(rng.normal(size=(n, dim)), axis=0) for n in rng.choice([1, 2, 5, 150], count)]


def same_place(rng, count, dim):
    return [np.full((n, dim), 7.25) for n in rng.integers(1, 4, count)]


KINDS = [equal_lengths, clusters, two_hubs, on_a_grid, duplicates, collinear, points, mixed_lengths, same_place]


def same_tree(tracks):
    by_matrix = Filtration.from_distances(frechet_matrix(tracks), tracks.ids)
    order, gaps = leaf_order(*spanning_tree(tracks))
    np.testing.assert_array_equal(gaps, by_matrix.gaps)
    np.testing.assert_array_equal(order, by_matrix.order)


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_the_tree_is_that_of_the_matrix(kind, dim):
    rng = np.random.default_rng(KINDS.index(kind) * 3 + dim)
    for offset, scale in [(0.0, 1.0), (5e6, 1.0), (5e6, 1e-3), (0.0, 1e-12), (0.0, 1e12), (1.0, 1e-15)]:
        for count in (2, 3, 8, 9, 17, 60):
            same_tree(Tracks.from_arrays([offset + scale * track for track in kind(rng, count, dim)]))


@settings(max_examples=100)
@given(st.lists(st.lists(st.tuples(*[st.integers(0, 3).map(float)] * 2), min_size=1, max_size=3), min_size=2))
def test_the_tree_is_that_of_the_matrix_under_many_ties(lists):
    same_tree(Tracks.from_arrays(lists))


def test_larger_sets_and_a_crowded_search(monkeypatch):
    """Several levels of boxes, and so little room for candidates that the search is resumed many times."""
    rng = np.random.default_rng(0)
    for kind in (clusters, two_hubs, on_a_grid, mixed_lengths):
        tracks = Tracks.from_arrays(kind(rng, 500, 2))
        same_tree(tracks)
        with monkeypatch.context() as patch:
            patch.setattr(spanning, "ROOM", 100)
            same_tree(tracks)


def test_threads_and_order_do_not_matter():
    tied = Tracks.from_arrays(
        on_a_grid(np.random.default_rng(6), 3000, 2)
    )  # so many minimal trees, yet always the same
    for one, other in zip(spanning_tree(tied, threads=1), spanning_tree(tied, threads=4), strict=True):
        np.testing.assert_array_equal(one, other)
    tracks = Tracks.from_arrays(clusters(np.random.default_rng(1), 300, 2))
    edges, heights = spanning_tree(tracks)
    shuffled = np.random.default_rng(2).permutation(300)
    np.testing.assert_array_equal(spanning_tree(tracks.select(shuffled))[1], heights)
    matrix = frechet_matrix(tracks)
    np.testing.assert_array_equal(matrix[edges[:, 0], edges[:, 1]], heights)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_features_never_promise_too_much(dim):
    """The bound of a pair, less the margin, is at most its distance, down to pairs that differ in the last bit."""
    rng = np.random.default_rng(dim)
    closest = -np.inf
    for offset, scale in [(0.0, 1.0), (5e6, 1.0), (1e9, 1e-3), (0.0, 1e-30)]:
        for kind in (equal_lengths, two_hubs, mixed_lengths, collinear):
            arrays = [offset + scale * track for track in kind(rng, 40, dim)]
            arrays += [np.nextafter(track, np.inf) for track in arrays[:10]]
            tracks = Tracks.from_arrays(arrays)
            boxes, unit = spanning._boxes_of(tracks, threads=1)
            assert tracks.diagonal <= unit
            f = boxes.features.astype(np.float64) * unit
            gap = np.abs(f[:, None] - f[None])
            ends = [np.sqrt((gap[..., k : k + dim] ** 2).sum(axis=-1)) for k in (0, dim)]
            bound = np.maximum(np.maximum(*ends), gap.max(axis=-1))
            distance = frechet_matrix(tracks)[np.ix_(boxes.order, boxes.order)]
            closest = max(closest, float((bound - distance).max() / unit))
            if kind is two_hubs:
                assert (bound > distance / 3)[distance > 0.1 * distance.max()].mean() > 0.5  # and they are worth having
    assert spanning.MARGIN / 50 < closest < spanning.MARGIN


@pytest.mark.parametrize("count", [2, 9, 100, 3000])
def test_tiles_hold_every_pair_of_tracks_once(count):
    boxes = spanning._divide(np.random.default_rng(7).normal(size=(count, 4)).astype(np.float32))
    inner = len(boxes.bounds) - 2
    seen = np.zeros((count, count), dtype=np.int8)
    for tile in spanning._tiles(boxes, pieces=16):
        tracks = []
        for box in tile.tolist():
            first = last = box
            while first < inner:
                first, last = 2 * first + 1, 2 * last + 2
            tracks.append(slice(boxes.bounds[first - inner], boxes.bounds[last - inner + 1]))
        seen[tracks[0], tracks[1]] += 1
    assert (seen[np.triu_indices(count, 1)] == 1).all()


def test_boxes_hold_their_tracks():
    rng = np.random.default_rng(3)
    boxes = spanning._divide(rng.normal(size=(1000, 6)).astype(np.float32))
    np.testing.assert_array_equal(np.sort(boxes.order), np.arange(1000))
    sizes = np.diff(boxes.bounds)
    assert sizes.max() <= spanning.LEAF
    assert sizes.min() >= 1
    leaves = len(sizes)
    assert len(boxes.low) == 2 * leaves - 1
    for leaf in range(leaves):
        inside = boxes.features[boxes.bounds[leaf] : boxes.bounds[leaf + 1]]
        np.testing.assert_array_equal(boxes.low[leaves - 1 + leaf], inside.min(axis=0))
        np.testing.assert_array_equal(boxes.high[leaves - 1 + leaf], inside.max(axis=0))
    for n in range(leaves - 1):
        np.testing.assert_array_equal(boxes.low[n], np.minimum(boxes.low[2 * n + 1], boxes.low[2 * n + 2]))
        np.testing.assert_array_equal(boxes.high[n], np.maximum(boxes.high[2 * n + 1], boxes.high[2 * n + 2]))


def test_fit_goes_the_same_way_by_size(monkeypatch):
    tracks = Tracks.from_arrays(on_a_grid(np.random.default_rng(4), 200, 2))
    small = Filtration.fit(tracks)
    monkeypatch.setattr(filtration, "_SMALL", 100)
    large = Filtration.fit(tracks)
    np.testing.assert_array_equal(large.order, small.order)
    np.testing.assert_array_equal(large.gaps, small.gaps)
    monkeypatch.setattr(filtration, "_COMPLETE", 100)
    with pytest.raises(ValueError, match="100 tracks at most, not 200"):
        Filtration.fit(tracks, linkage="complete")


def test_progress_rises_to_one():
    seen = []
    spanning_tree(Tracks.from_arrays(clusters(np.random.default_rng(5), 100, 2)), progress=seen.append)
    assert seen[-1] == 1
    assert seen == sorted(seen)


def test_overflow_is_refused():
    with pytest.raises(ValueError, match="too far apart"):
        spanning_tree(Tracks.from_arrays([[0.0], [1e200]]))


def test_real_pedestrians(shared_data):
    """Edinburgh forum in pixels: 1,262 tracks, equal heights by the hundred."""
    text = shared_data("edinburgh_forum/tracks.01Jul.txt").read_text()
    tracks = [
        np.array([vertex.split() for vertex in line.split("[[")[1].split("]]")[0].split("];[")], dtype=np.float64)
        for line in text.replace("]; [", "];[").splitlines()
        if line.strip().startswith("TRACK")
    ]
    tracks = Tracks.from_arrays([track[:, :2] for track in tracks])
    assert len(tracks) == 1262
    same_tree(tracks)
