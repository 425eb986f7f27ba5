"""Which stored tracks are near: the same answer as measuring them all, whatever the query."""

import naive
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import walks

from wakefold.model.filtration import Filtration
from wakefold.model.linkage import bounds as features
from wakefold.model.linkage.distance import frechet_matrix
from wakefold.model.linkage.search import TrackIndex
from wakefold.tracks.tracks import Tracks


@st.composite
def tracks_and_query(draw):
    """Short tracks on a coarse grid (ties, duplicates, single points), and a query that may lie far outside."""
    dim = draw(st.integers(1, 3))

    def track(coordinate):
        return st.lists(st.tuples(*[coordinate.map(float)] * dim), min_size=1, max_size=4)

    stored = draw(st.lists(track(st.integers(0, 4)), min_size=1, max_size=30))
    return stored, draw(track(st.integers(-9, 9)))


def by_measuring_all(track, tracks, within=np.inf, k=None):
    distances = frechet_matrix([track], tracks)[0]
    by = np.lexsort((np.arange(len(distances)), distances))
    by = by[distances[by] <= within][:k]
    return by, distances[by]


def same(found, expected):
    for got, wanted in zip(found, expected, strict=True):
        np.testing.assert_array_equal(got, wanted)


@given(tracks_and_query(), st.data())
def test_near_tracks_are_those_of_the_definition(sets, data):
    stored, query = sets
    index = TrackIndex(Tracks.from_arrays(stored))
    expected = sorted((naive.frechet(np.array(query), np.array(track)), i) for i, track in enumerate(stored))
    within = data.draw(st.sampled_from([0.0, *(d for d, _ in expected), *(np.nextafter(d, 0) for d, _ in expected)]))
    k = data.draw(st.integers(1, len(stored) + 2))
    inside = [(d, i) for d, i in expected if d <= within]
    for found, wanted in [
        (index.query(query, within=within), inside),
        (index.query(query, k=k), expected[:k]),
        (index.query(query, within=within, k=k), inside[:k]),
    ]:
        assert list(zip(found[1].tolist(), found[0].tolist(), strict=True)) == wanted


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize(("offset", "scale"), [(0.0, 1.0), (5e6, 1e-3), (0.0, 1e-12), (1e9, 1e6)])
def test_many_levels_of_boxes(dim, offset, scale):
    rng = np.random.default_rng(dim)
    arrays = [offset + scale * track for track in walks(rng, 800, dim)]
    tracks = Tracks.from_arrays(arrays)
    index = TrackIndex(tracks)
    away = [offset + scale * far * rng.normal(size=(5, dim)) for far in (10, 1e4, 1e9, 1e15)]
    for query in arrays[:10] + [np.nextafter(track, np.inf) for track in arrays[:5]] + away:
        for k in (1, 7, 799, 800):
            same(index.query(query, k=k), by_measuring_all(query, tracks, k=k))
        for within in (0.0, 2 * scale, 10 * scale, 1e5 * scale):
            same(index.query(query, within=within), by_measuring_all(query, tracks, within))
            same(index.query(query, within=within, k=3), by_measuring_all(query, tracks, within, 3))


def test_few_tracks_are_measured(monkeypatch):
    from wakefold.model.linkage import search

    measured = []

    def counted(track, tracks, others):
        measured.append(len(others))
        return distances_from(track, tracks, others)

    distances_from = search.distances_from
    monkeypatch.setattr(search, "distances_from", counted)
    arrays = walks(np.random.default_rng(3), 3000)
    index = TrackIndex(Tracks.from_arrays(arrays))
    for track in arrays[:50]:
        index.query(track, k=3)
    assert sum(measured) < 50 * 3000 / 30


def test_one_place_and_one_track():
    same_place = TrackIndex(Tracks.from_arrays([[[7.25, 1.0]] * n for n in (1, 3, 2)]))
    same(same_place.query([[7.25, 1.0]], k=2), ([0, 1], [0.0, 0.0]))
    same(same_place.query([[7.25, 5.0]], within=4), ([0, 1, 2], [4.0, 4.0, 4.0]))
    same(same_place.query([[7.25, 5.0]], within=3.9), ([], []))
    one = TrackIndex(Tracks.from_arrays([[0.0, 1.0]]))
    same(one.query([3.0], k=5), ([0], [3.0]))
    same(one.query([1e140], k=1), ([0], [1e140]))
    same(one.query([1e140], within=1.0), ([], []))


def test_a_filtration_finds_tracks_of_its_own():
    tracks = Tracks.from_arrays(walks(np.random.default_rng(4), 60))
    tree = Filtration.fit(tracks)
    for _ in range(2):
        same(tree.query(tracks[5], tracks, k=4), by_measuring_all(tracks[5], tracks, k=4))
    with pytest.raises(ValueError, match="not the tracks of the filtration"):
        tree.query(tracks[5], tracks.select([1, 0]), k=4)


def test_refusals():
    index = TrackIndex(Tracks.from_arrays(walks(np.random.default_rng(5), 9)))
    track = np.zeros((2, 2))
    with pytest.raises(ValueError, match="how near"):
        index.query(track)
    for within in (-1.0, np.nan):
        with pytest.raises(ValueError, match="within"):
            index.query(track, within=within)
    with pytest.raises(ValueError, match="k must be at least 1"):
        index.query(track, k=0)
    with pytest.raises(ValueError, match="3 coordinates among tracks of 2"):
        index.query(np.zeros((2, 3)), k=1)
    with pytest.raises(ValueError, match="track 'query' has no points"):
        index.query(np.zeros((0, 2)), k=1)
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="track 'query' has a position that is not finite"):
            index.query([[0.0, bad]], k=1)
    with pytest.raises(ValueError, match="too far apart"):
        index.query([[0.0, 1e200]], k=1)
    with pytest.raises(ValueError, match="no tracks"):
        TrackIndex(Tracks.from_arrays([[0.0]]).select([]))


# Features and boxes


def test_boxes_hold_their_tracks():
    rng = np.random.default_rng(3)
    for count in (1, 8, 9, 1000):
        values = rng.integers(0, 9, (count, 6)).astype(np.float32)
        boxes = features.boxes_of(values)
        np.testing.assert_array_equal(np.sort(boxes.order), np.arange(count))
        np.testing.assert_array_equal(boxes.features, values[boxes.order])
        sizes = np.diff(boxes.bounds)
        assert 1 <= sizes.min() <= sizes.max() <= features.LEAF
        leaves = len(sizes)
        assert len(boxes.low) == 2 * leaves - 1
        for leaf in range(leaves):
            inside = boxes.features[boxes.bounds[leaf] : boxes.bounds[leaf + 1]]
            np.testing.assert_array_equal(boxes.low[leaves - 1 + leaf], inside.min(axis=0))
            np.testing.assert_array_equal(boxes.high[leaves - 1 + leaf], inside.max(axis=0))
        for n in range(leaves - 1):
            np.testing.assert_array_equal(boxes.low[n], np.minimum(boxes.low[2 * n + 1], boxes.low[2 * n + 2]))
            np.testing.assert_array_equal(boxes.high[n], np.maximum(boxes.high[2 * n + 1], boxes.high[2 * n + 2]))


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_features_are_those_of_the_definition(dim):
    tracks = Tracks.from_arrays(walks(np.random.default_rng(dim), 30, dim))
    frame = features.frame_of(tracks.points)
    found = features.features_of(tracks, frame).astype(np.float64) * frame.unit
    for row, track in zip(found, tracks, strict=True):
        at = track - frame.middle
        along = at @ frame.directions.T
        nearest = np.sqrt(((track[:, None] - frame.landmarks) ** 2).sum(axis=2)).min(axis=0)
        expected = [at[0], at[-1], along.max(axis=0), (-along).max(axis=0), nearest]
        np.testing.assert_allclose(row, np.concatenate(expected), rtol=0, atol=2.0**-22 * frame.unit)
    assert (np.abs(np.linalg.norm(frame.directions, axis=1) - 1) < 1e-15).all()
    assert tracks.diagonal <= frame.unit
