"""The filtration: scipy's heights, the definition's classes, intervals, canonical under any order, stored exactly."""

import re

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.cluster.hierarchy import cophenet, is_valid_linkage, linkage
from scipy.spatial.distance import squareform

from wakefold.base import store
from wakefold.base.store import StoreError
from wakefold.model.filtration import Filtration
from wakefold.model.linkage.dendrogram import entropy_by_height
from wakefold.model.linkage.distance import frechet_matrix
from wakefold.tracks.tracks import Tracks


@st.composite
def track_sets(draw, least=1):
    """Few short tracks on a coarse grid: many equal heights, duplicate tracks, single points."""
    dim = draw(st.integers(1, 3))
    coordinate = st.integers(0, draw(st.integers(1, 12))).map(float)
    vertex = st.tuples(*[coordinate] * dim)
    return Tracks.from_arrays(draw(st.lists(st.lists(vertex, min_size=1, max_size=4), min_size=least, max_size=12)))


def random_tracks(seed, count, grid=None, dim=2):
    rng = np.random.default_rng(seed)
    starts = rng.normal(0, 30, (count, dim))
    tracks = [
        start + np.cumsum(rng.normal(0, 1, (n, dim)), axis=0)
        for start, n in zip(starts, rng.integers(1, 30, count), strict=True)
    ]
    return Tracks.from_arrays([track if grid is None else np.round(track / grid) * grid for track in tracks])


def classes(tree, names=None):
    """{set of tracks: (birth, death)}, tracks renamed."""
    names = np.arange(len(tree)) if names is None else np.asarray(names)
    return {frozenset(names[tree.members(c)].tolist()): (tree.birth[c], tree.death[c]) for c in range(len(tree.birth))}


@given(track_sets())
def test_classes_are_those_of_the_definition(tracks):
    assert classes(Filtration.fit(tracks)) == naive.single_linkage(frechet_matrix(tracks).tolist())


@given(track_sets(least=2))
def test_the_arrays_keep_their_promises(tracks):
    tree = Filtration.fit(tracks)
    m, c = len(tree), len(tree.birth)
    np.testing.assert_array_equal(tree.order[tree.rank], np.arange(m))
    np.testing.assert_array_equal(tree.lo[:m], tree.rank)
    np.testing.assert_array_equal(tree.hi[:m], tree.rank + 1)
    assert (tree.birth[:m] == 0).all()
    assert (tree.lo[tree.root], tree.hi[tree.root], tree.parent[tree.root]) == (0, m, -1)
    assert tree.death[tree.root] == np.inf
    inner = list(zip(tree.birth[m:], tree.lo[m:], strict=True))
    assert inner == sorted(inner)
    for k in range(c):
        children = tree.children(k)
        assert (tree.parent[children] == k).all()
        if k >= m:  # children tile their class and are born before it, or are single tracks
            assert len(children) >= 2
            np.testing.assert_array_equal(tree.hi[children][:-1], tree.lo[children][1:])
            assert (tree.lo[children[0]], tree.hi[children[-1]]) == (tree.lo[k], tree.hi[k])
            assert ((tree.birth[children] < tree.birth[k]) | (children < m)).all()
            firsts = [tree.members(child).min() for child in children]
            assert firsts == sorted(firsts)
            assert (tree.gaps[tree.hi[children][:-1] - 1] == tree.birth[k]).all()
        assert tree.ancestors(k).tolist() == naive_ancestors(tree, k)
    assert all(not array.flags.writeable for array in (tree.order, tree.gaps, tree.lo, tree.birth, tree.parent))


def naive_ancestors(tree, c):
    out = []
    while tree.parent[c] != -1:
        c = tree.parent[c]
        out.append(c)
    return out


@given(track_sets(), st.data())
def test_levels_partition_the_tracks(tracks, data):
    tree = Filtration.fit(tracks)
    heights = sorted(set(tree.birth.tolist()))
    b = data.draw(st.sampled_from(heights + [h + 0.1 for h in heights]))
    alive = tree.alive(b)
    expected = naive.components(frechet_matrix(tracks).tolist(), b)
    assert {frozenset(tree.members(c).tolist()) for c in alive} == expected
    np.testing.assert_array_equal(np.append(tree.lo[alive], len(tree)), tree.cuts(b))
    for track in range(len(tree)):
        (c,) = (c for c in alive if track in tree.members(c))
        assert tree.class_at(track, b) == tree.class_of([track], b) == c
        assert tree.class_of(tree.members(c), b) == c


@given(track_sets())
def test_tree_distance_is_the_birth_of_the_youngest_common_ancestor(tracks):
    tree = Filtration.fit(tracks)
    every = np.arange(len(tree.birth))
    found = tree.tree_distance(every[:, None], every)
    for a in every:
        for b in every:
            above_b = [b, *naive_ancestors(tree, b)]
            common = next(c for c in [a, *naive_ancestors(tree, a)] if c in above_b)
            assert found[a, b] == (0 if a == b else tree.birth[common])
            assert tree.tree_distance(a, b) == found[a, b]


@pytest.mark.parametrize("method", ["single", "complete"])
@pytest.mark.parametrize("seed", range(3))
def test_heights_are_scipys(seed, method):
    tracks = random_tracks(seed, 150)
    condensed = squareform(frechet_matrix(tracks))
    tree = Filtration.fit(tracks, linkage=method)
    expected = cophenet(linkage(condensed, method))
    first, second = np.triu_indices(len(tracks), 1)
    np.testing.assert_array_equal(tree.tree_distance(first, second), expected)
    assert is_valid_linkage(tree.linkage_matrix())
    np.testing.assert_array_equal(cophenet(tree.linkage_matrix()), expected)


@pytest.mark.parametrize("grid", [None, 1.0, 5.0])
def test_any_order_of_the_tracks_gives_the_same_classes(grid):
    tracks = random_tracks(7, 120, grid)
    tree = Filtration.fit(tracks)
    assert grid is None or len(tree.birth) < 2 * len(tree) - 1  # there are ties
    for seed in range(5):
        shuffled = np.random.default_rng(seed).permutation(len(tracks))
        assert classes(Filtration.fit(tracks.select(shuffled)), names=shuffled) == classes(tree)


def test_one_track_is_a_tree():
    tree = Filtration.fit(Tracks.from_arrays([[[1.0, 2.0]]]))
    assert tree.root == 0
    assert tree.alive(0).tolist() == tree.alive(1e9).tolist() == [0]
    assert tree.tree_distance(0, 0) == 0
    assert tree.levels().tolist() == [0]
    assert tree.levels(persistence=1.0).tolist() == []
    assert tree.linkage_matrix().shape == (0, 4)
    assert tree.newick() == "0;"
    assert tree.medoid(0, Tracks.from_arrays([[[1.0, 2.0]]])) == 0


def test_duplicates_join_at_zero():
    tree = Filtration.fit(Tracks.from_arrays([[0.0, 1.0], [5.0], [0.0, 1.0], [0.0, 0.0, 1.0]]))
    assert {tuple(sorted(tree.members(c).tolist())) for c in tree.alive(0)} == {(0, 2, 3), (1,)}
    assert tree.death[[0, 2, 3]].tolist() == [0, 0, 0]
    assert tree.tree_distance(0, 2) == 0


LINE = Tracks.from_arrays([[0.0], [1.0], [3.0], [10.0], [11.5]], ids=["a", "b", "c", "d", "e"])


def test_class_of_names_the_level_that_joins():
    tree = Filtration.fit(LINE)
    assert tree.members(tree.class_of(["a", "b"], level=1.0)).tolist() == [0, 1]
    assert tree.members(tree.class_of([0, 2], level=2)).tolist() == [0, 1, 2]
    assert tree.class_of(np.array([0, 4]), level=100.0) == tree.root
    with pytest.raises(ValueError, match=r"2 classes at level 2; level 7\.0 joins them"):
        tree.class_of(["a", "e"], level=2.0)
    with pytest.raises(ValueError, match="no track has the id 'z'"):
        tree.class_of(["z"], level=2.0)
    with pytest.raises(ValueError, match="there is no track 5"):
        tree.class_of([5], level=2.0)
    with pytest.raises(ValueError, match="no tracks named"):
        tree.class_of([], level=2.0)
    for level in (-1.0, np.nan, np.inf):
        for ask in (lambda b: tree.class_of([0], b), lambda b: tree.ancestor(0, b), tree.alive, tree.cuts):
            with pytest.raises(ValueError, match="a level must be finite"):
                ask(level)


def test_ancestors_at_a_level():
    tree = Filtration.fit(LINE)
    c = tree.class_of(["a", "b"], 1.0)
    assert tree.ancestor(c, 1.9) == c
    assert tree.members(tree.ancestor(c, 2.0)).tolist() == [0, 1, 2]
    assert tree.tree_distance(c, tree.ancestor(c, 2.0)) == 2.0
    with pytest.raises(ValueError, match=r"born at 1, after level 0\.5"):
        tree.ancestor(c, 0.5)
    with pytest.raises(ValueError, match="there is no class 9"):
        tree.ancestor(9, 0.5)


def test_medoid():
    tree = Filtration.fit(LINE)
    assert tree.medoid(tree.root, LINE) == 2
    assert tree.medoid(4, LINE) == 4
    tracks = random_tracks(1, 80)
    tree = Filtration.fit(tracks)
    sums = frechet_matrix(tracks).sum(axis=1)
    assert tree.medoid(tree.root, tracks) == sums.argmin()
    assert tree.medoid(tree.root, tracks, limit=10) in range(80)
    with pytest.raises(ValueError, match="not the tracks of the filtration"):
        tree.medoid(tree.root, LINE)


def entropy(tree, b):
    share = np.diff(tree.cuts(b)) / len(tree)
    return -(share * np.log(share)).sum()


def test_levels_by_number_lose_information_evenly():
    tree = Filtration.fit(random_tracks(2, 200))
    levels = tree.levels(number=6)
    assert len(levels) == 6
    births = np.unique(tree.birth)
    for k, level in enumerate(levels):
        target = np.log(len(tree)) * (6 - k) / 7
        best = min(abs(entropy(tree, b) - target) for b in births[1:-1])
        assert abs(entropy(tree, level) - target) == pytest.approx(best)
    heights, entropies = entropy_by_height(tree.hi - tree.lo, tree.birth, tree.parent)
    np.testing.assert_array_equal(heights, births)
    np.testing.assert_allclose(entropies, [entropy(tree, b) for b in births], atol=1e-9)
    assert Filtration.fit(LINE).levels(number=50).tolist() == [1.0, 1.5, 2.0]
    with pytest.raises(ValueError, match="number"):
        tree.levels(0)


def test_levels_by_persistence_show_every_lasting_class():
    tree = Filtration.fit(random_tracks(3, 200))
    for persistence in (0.2, 1.0, 5.0):
        levels = tree.levels(persistence=persistence)
        lasting = [c for c in range(len(tree), tree.root) if tree.death[c] - tree.birth[c] >= persistence]
        shown = {c for b in levels for c in tree.alive(b)}
        assert shown.issuperset(lasting)
        assert np.isin(levels, tree.birth).all()
        # As many classes that are never alive together as there are levels: fewer levels cannot do.
        apart, end = 0, -np.inf
        for c in sorted(lasting, key=lambda c: tree.death[c]):
            if tree.birth[c] >= end:
                apart, end = apart + 1, tree.death[c]
        assert len(levels) == apart
    assert tree.levels(persistence=1e9).tolist() == []
    with pytest.raises(ValueError, match="not both"):
        tree.levels(3, persistence=1.0)
    with pytest.raises(ValueError, match="persistence"):
        tree.levels(persistence=-1.0)


def test_newick():
    tracks = Tracks.from_arrays([[0.0], [1.0], [3.0], [10.0]], ids=["it's", "a b", "plain-1", "x_y"])
    assert Filtration.fit(tracks).newick() == "((('it''s':1.0,'a b':1.0):1.0,plain-1:2.0):5.0,'x_y':7.0);"
    tree = Filtration.fit(random_tracks(4, 60))
    tokens = re.findall(r"[(),;]|[^(),;]+", tree.newick())
    heights: list[float] = []

    def height_of_next() -> float:
        """Read one subtree: its children, each under its branch, must end level with one another."""
        if tokens[0] != "(":
            return 0.0
        tops = []
        while tokens.pop(0) != ")":
            below = height_of_next()
            tops.append(below + float(tokens.pop(0).partition(":")[2]))
        np.testing.assert_allclose(tops, tops[0])
        heights.append(tops[0])
        return tops[0]

    height_of_next()
    assert tokens == [";"]
    np.testing.assert_allclose(np.sort(heights), tree.birth[len(tree) :])


@pytest.mark.parametrize("method", ["single", "complete"])
def test_stored_bit_for_bit(tmp_path, method):
    tree = Filtration.fit(random_tracks(5, 70, grid=2.0), linkage=method)
    tree.save(tmp_path / "tree")
    back = Filtration.load(tmp_path / "tree")
    assert back.linkage == method
    for name in ("order", "gaps", "ids", "rank", "lo", "hi", "birth", "death", "parent"):
        assert getattr(back, name).tobytes() == getattr(tree, name).tobytes()
        assert getattr(back, name).dtype == getattr(tree, name).dtype


def test_a_damaged_tree_is_refused(tmp_path):
    tree = Filtration.fit(random_tracks(6, 20))
    tree.save(tmp_path / "tree")
    path = tmp_path / "tree" / "gaps.npy"
    content = path.read_bytes()
    path.write_bytes(content[:-1])
    with pytest.raises(StoreError, match=r"gaps\.npy has"):
        Filtration.load(tmp_path / "tree")
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(StoreError, match="has been edited"):
        Filtration.load(tmp_path / "tree")
    path.write_bytes(content)
    for arrays, meta, message in [
        ({"order": tree.order, "gaps": tree.gaps, "ids": tree.ids}, {"linkage": "ward"}, "linkage must be"),
        ({"order": tree.order * 0, "gaps": tree.gaps, "ids": tree.ids}, {"linkage": "single"}, "permutation"),
        ({"order": tree.order, "ids": tree.ids}, {"linkage": "single"}, "gaps"),
    ]:
        store.save(tmp_path / "tree", arrays, meta, "filtration")
        with pytest.raises(StoreError, match=message):
            Filtration.load(tmp_path / "tree")


def test_what_cannot_be_a_tree_is_refused():
    names = ["a", "b", "c"]
    for order, gaps in [([0, 1, 1], [1.0, 2.0]), ([0, 1, 2], [1.0]), ([0, 1, 2], [1.0, np.nan]), ([0, 1, 2], [-1, 1])]:
        with pytest.raises(ValueError):  # noqa: PT011
            Filtration(np.array(order), np.array(gaps), np.array(names))
    with pytest.raises(ValueError, match="linkage"):
        Filtration.fit(LINE, linkage="ward")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="too far apart"):
        Filtration.fit(Tracks.from_arrays([[0.0], [1e200]]))


def test_it_shows_itself():
    tree = Filtration.fit(LINE)
    assert repr(tree) == "Filtration(5 tracks, 4 merged classes, single linkage, joined at 7)"
    assert "<td>1.5</td><td>3</td>" in tree._repr_html_()


@settings(max_examples=20)
@given(track_sets(least=2))
def test_complete_linkage_joins_at_the_widest_pair(tracks):
    tree = Filtration.fit(tracks, linkage="complete")
    distances = frechet_matrix(tracks)
    for c in range(len(tree), len(tree.birth)):
        members = tree.members(c)
        assert distances[np.ix_(members, members)].max() == tree.birth[c]
