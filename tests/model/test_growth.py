"""New tracks in a fitted filtration: the tree that fitting all of them gives, bit for bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import on_a_grid, same_place, two_hubs, walks

from wakefold.model.filtration import Filtration
from wakefold.tracks.tracks import Tracks


def named(arrays, prefix=""):
    return Tracks.from_arrays(arrays, ids=[f"{prefix}{k}" for k in range(len(arrays))])


def same_as_fitting_all(old, new, tree=None):
    old, new = named(old), named(new, "new ")
    grown = (tree or Filtration.fit(old)).extend(old, new)
    fitted = Filtration.fit(Tracks.concat([old, new]))
    for name in ("order", "gaps", "ids", "parent"):
        np.testing.assert_array_equal(getattr(grown, name), getattr(fitted, name))
    return grown


@settings(max_examples=150)
@given(st.data())
def test_many_ties_and_duplicates(data):
    dim = data.draw(st.integers(1, 3))
    track = st.lists(st.tuples(*[st.integers(0, 3).map(float)] * dim), min_size=1, max_size=3)
    same_as_fitting_all(*(data.draw(st.lists(track, min_size=1, max_size=size)) for size in (20, 12)))


def duplicates(rng, count, dim):
    few = walks(np.random.default_rng(0), 4, dim)
    return [few[k] for k in rng.integers(0, 4, count)]


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("kind", [walks, two_hubs, on_a_grid, duplicates, same_place])
def test_the_tree_is_that_of_all_tracks(kind, dim):
    rng = np.random.default_rng(dim)
    for offset, scale in [(0.0, 1.0), (5e6, 1.0), (5e6, 1e-3), (0.0, 1e-12)]:
        for old, new in [(1, 1), (1, 40), (300, 1), (200, 30), (20, 200)]:
            arrays = [offset + scale * track for track in kind(rng, old + new, dim)]
            same_as_fitting_all(arrays[:old], arrays[old:])


def test_new_tracks_elsewhere():
    """Far from all others, in a cluster of their own, and as a bridge between two clusters."""
    rng = np.random.default_rng(1)
    old = walks(rng, 200, 2)
    cluster = [5000 + rng.normal(0, 1, (5, 2)) for _ in range(50)]
    same_as_fitting_all(old, [[[1e9, -1e9]]])
    same_as_fitting_all(old, [track + 1e4 for track in walks(rng, 100, 2)])
    same_as_fitting_all(old + cluster, [np.full((5, 2), at) for at in np.linspace(0, 5000, 30)])


def test_again_and_again(monkeypatch):
    """Batch after batch, with several levels of boxes; the way of a large fit at the end."""
    from wakefold.model import filtration

    rng = np.random.default_rng(2)
    arrays = walks(rng, 1500, 2)
    tracks = named(arrays[:1000])
    tree = Filtration.fit(tracks)
    for batch in range(5):
        new = named(arrays[1000 + 100 * batch : 1100 + 100 * batch], f"{batch} ")
        tree = tree.extend(tracks, new, threads=1 + batch % 2)
        tracks = Tracks.concat([tracks, new])
    monkeypatch.setattr(filtration, "_SMALL", 100)
    fitted = Filtration.fit(tracks)
    np.testing.assert_array_equal(tree.order, fitted.order)
    np.testing.assert_array_equal(tree.gaps, fitted.gaps)


def test_few_distances_are_measured(monkeypatch):
    from wakefold.model.linkage import growth

    found = []

    def counted(*args):
        pairs, heights = edges(*args)
        found.append(len(heights))
        return pairs, heights

    edges = growth._edges
    monkeypatch.setattr(growth, "_edges", counted)
    arrays = walks(np.random.default_rng(3), 3100, 2)
    tree = Filtration.fit(named(arrays[:3000]))
    same_as_fitting_all(arrays[:3000], arrays[3000:], tree)
    assert sum(found) < 100 * 3100 / 30


def test_refusals():
    rng = np.random.default_rng(4)
    old, new = named(walks(rng, 20, 2)), named(walks(rng, 5, 2), "new ")
    tree = Filtration.fit(old)
    assert tree.extend(old, new.select([])) is tree
    with pytest.raises(ValueError, match="not the tracks of the filtration"):
        tree.extend(new, old)
    with pytest.raises(ValueError, match="used already"):
        tree.extend(old, old)
    with pytest.raises(ValueError, match="another plane"):
        tree.extend(old, named(walks(rng, 5, 3), "new "))
    with pytest.raises(ValueError, match="single linkage"):
        Filtration.fit(old, linkage="complete").extend(old, new)
    with pytest.raises(ValueError, match="too far apart"):
        tree.extend(old, named([[[1e200, 0.0]]], "new "))
