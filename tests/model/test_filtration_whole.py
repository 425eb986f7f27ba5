"""The filtration end to end: the plain programme, scipy, and real data."""

from itertools import combinations

import naive
import numpy as np
import pytest
from scipy.cluster.hierarchy import cophenet, linkage
from test_spanning import KINDS

from wakefold.model import filtration
from wakefold.model.filtration import Filtration
from wakefold.model.linkage.dendrogram import leaf_order
from wakefold.model.linkage.distance import frechet_matrix
from wakefold.model.linkage.spanning import spanning_tree
from wakefold.tracks.tracks import Tracks


def heights_of(tree):
    first, second = np.triu_indices(len(tree), 1)
    return tree.tree_distance(first, second)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_heights_are_those_of_the_plain_programme_and_scipy(kind, monkeypatch):
    """60 sets of each of nine kinds, 540 in all, by the matrix and without it, at several places and scales."""
    monkeypatch.setattr(filtration, "_SMALL_POINTS", 0)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        offset, scale = [(0.0, 1.0), (5e6, 1.0), (5e6, 1e-3), (0.0, 1e-12), (-1e6, 30.0)][seed % 5]
        tracks = Tracks.from_arrays([offset + scale * track for track in kind(rng, 2 + seed % 6, 1 + seed % 3)])
        condensed = [naive.frechet(a, b) for a, b in combinations(tracks, 2)]
        expected = cophenet(linkage(condensed, "single"))
        np.testing.assert_array_equal(heights_of(Filtration.fit(tracks)), expected)
        by_matrix = Filtration.from_distances(frechet_matrix(tracks), tracks.ids)
        np.testing.assert_array_equal(heights_of(by_matrix), expected)


def same_without_the_matrix(tracks):
    """The tree by the matrix and without it; the classes of the tracks in another order; the tree grown by halves."""
    distances = frechet_matrix(tracks)
    expected = Filtration.from_distances(distances, tracks.ids)
    order, gaps = leaf_order(*spanning_tree(tracks))
    np.testing.assert_array_equal(order, expected.order)
    np.testing.assert_array_equal(gaps, expected.gaps)
    half = tracks.select(np.arange(len(tracks) // 2))
    rest = tracks.select(np.arange(len(tracks) // 2, len(tracks)))
    grown = Filtration.fit(half).extend(half, rest)
    np.testing.assert_array_equal(grown.order, expected.order)
    np.testing.assert_array_equal(grown.gaps, expected.gaps)
    shuffled = np.random.default_rng(0).permutation(len(tracks))
    again = Filtration(*leaf_order(*spanning_tree(tracks.select(shuffled))), tracks.ids[shuffled])
    place = np.argsort(shuffled)
    pairs = np.random.default_rng(1).integers(0, len(tracks), (2, 100_000))
    np.testing.assert_array_equal(again.tree_distance(*place[pairs]), expected.tree_distance(*pairs))
    np.testing.assert_array_equal(np.sort(again.birth), np.sort(expected.birth))


def test_students(shared_data):
    """students03 in full: 428 pedestrians in two dimensions, metres."""
    table = np.loadtxt(shared_data("pedestrian_groups/UCY/students03/obsmat.txt"))
    frame, pedestrian, x, y = table[:, [0, 1, 2, 4]].T
    by = np.lexsort((frame, pedestrian))
    cuts = np.flatnonzero(np.diff(pedestrian[by])) + 1
    tracks = Tracks.from_arrays(np.split(np.stack([x, y], axis=1)[by], cuts))
    assert len(tracks) == 428
    same_without_the_matrix(tracks)


def test_grand_central(shared_data):
    """All 11,787 pedestrians of Grand Central against the full matrix: half a minute, where the data are at hand."""
    pytest.importorskip("pyarrow")
    import pyarrow.parquet as parquet

    table = parquet.read_table(shared_data("grand_central/grand_central.parquet"), columns=["track_id", "x", "y"])
    ids, x, y = (table.column(name).to_numpy() for name in ("track_id", "x", "y"))
    tracks = Tracks.from_arrays(np.split(np.stack([x, y], axis=1), np.flatnonzero(ids[1:] != ids[:-1]) + 1))
    assert len(tracks) == 11_787
    same_without_the_matrix(tracks)


def test_a_bad_track_is_named():
    fine = np.zeros((3, 2))
    for bad, message in [
        ([[0.0, np.nan]], "track '1' has a position that is not finite"),
        ([[0.0, 0.0], [np.inf, 0.0]], "track '1' has a position that is not finite"),
        (np.empty((0, 2)), "track '1' has no points"),
    ]:
        with pytest.raises(ValueError, match=message):
            Filtration.fit(Tracks.from_arrays([fine, bad, fine]))
