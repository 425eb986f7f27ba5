"""Forests of past states: trees that lead every row to its leaf, their growth, and neighbourhoods."""

from itertools import pairwise

import naive_trail as naive
import numpy as np
import pytest
from made import bundles, routes
from scipy.stats import multivariate_normal

import wakefold as wf
from wakefold.base.compile import kernel
from wakefold.model import remembering
from wakefold.model.kernels import forest, recall, weighing
from wakefold.model.kernels.states import all_features, feature_count, raw_length, states


@pytest.fixture(scope="module")
def model():
    return wf.learn(routes(0, 40)[0], sd=1.0)


def features_of(memory, tracks):
    seen = remembering.Seen.of(tracks, memory.step, memory.unit, memory.lags)
    who = remembering.numbers_of(tracks, memory.agents)[seen.track]
    x = remembering.features_of(seen, who, memory.lags, memory.base, memory.slow, memory.daily)
    return seen, x


@kernel
def way(x, trees, tree, begins, ends):
    return forest.descend(x, trees, tree, begins, ends)


@kernel
def near(rows, past, ranges, depth, ahead, need):
    return recall.neighbourhood(rows, past, ranges, depth, ahead, need)


@kernel
def density(points, at, floor):
    return recall.log_density(points, 0, len(points), at, floor)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_states_and_features_are_those_of_loops(dim):
    tracks = bundles(count=7, dim=dim)
    points = tracks.points if dim > 1 else np.column_stack([tracks.points, np.zeros(len(tracks.points))])
    d, lags, rng = points.shape[1], np.array([0.5, 1.5, 3.0, 6.0]), np.random.default_rng(1)
    track = rng.integers(0, 7, 60)
    begin, last = tracks.times[tracks.offsets[track]], tracks.times[tracks.offsets[track + 1] - 1]
    at = begin + rng.random(60) * (last - begin)
    at[:5], at[5:10] = begin[:5], last[5:10]
    raw = np.empty((60, raw_length(d, 4)))
    states(points, tracks.times, tracks.offsets, track, at, lags, raw)
    for base in range(3):
        out = [np.empty((60, feature_count(d, 4)), dtype=np.float32) for _ in range(2)]
        all_features(raw, track.astype(float), d, lags, base, 0.3, True, *out)
        for i in range(60):
            rows = slice(tracks.offsets[track[i]], tracks.offsets[track[i] + 1])
            wanted = naive.raw_state(points[rows], tracks.times[rows], at[i], lags)
            np.testing.assert_allclose(raw[i], wanted, atol=1e-9)
            for got, told in zip(out, naive.features(raw[i], track[i], d, lags, base, 0.3, True), strict=True):
                np.testing.assert_allclose(got[i], told, rtol=1e-5, atol=1e-5)


def test_the_own_frame_does_not_feel_a_quarter_turn():
    """But for position and heading, to the bit; nor a shift, nearly."""
    tracks, lags = bundles(count=5), np.array([0.5, 1.5, 3.0])
    turned = wf.Tracks.from_arrays([t @ np.array([[0.0, 1.0], [-1.0, 0.0]]) for t in tracks])
    moved = wf.Tracks.from_arrays([t + 4096.0 for t in tracks])
    found = []
    for t in (tracks, turned, moved):
        track = np.repeat(np.arange(5), 4)
        at = np.tile([0.0, 0.7, 1.9, 3.3], 5)
        raw = np.empty((20, raw_length(2, 3)))
        states(t.points, t.times, t.offsets, track, at, lags, raw)
        out = [np.empty((20, feature_count(2, 3)), dtype=np.float32) for _ in range(2)]
        all_features(raw, np.full(20, -1.0), 2, lags, 1, 0.3, False, *out)
        found.append(np.delete(out[1], [0, 1, 6, 7], axis=1))
    assert (np.abs(found[0]).max(axis=0) > 0).sum() >= found[0].shape[1] - 1
    assert (found[0][:, 2:] == found[1][:, 2:])[np.abs(found[0][:, 4:5]).ravel() > 1].all()
    np.testing.assert_allclose(found[0], found[2], atol=1e-3)


def sound(trees, x, leaf=None):
    """Every row lies in the leaf that its features lead to; ranges are nested; nodes stand in preorder."""
    begins, ends = (np.empty(forest.DEEPEST + 2, dtype=np.int64) for _ in range(2))
    for t in range(len(trees.first_node) - 1):
        a, b = trees.first_row[t], trees.first_row[t + 1]
        leaves = set()
        for j in range(a, b):
            ways = naive.leaf_ranges(trees, t, x[trees.rows[j]])
            depth = way(x[trees.rows[j]], trees, t, begins, ends)
            assert list(zip(begins[:depth].tolist(), ends[:depth].tolist(), strict=True)) == ways
            assert ways[-1][0] <= j < ways[-1][1]
            assert all(p[0] <= q[0] < q[1] <= p[1] for p, q in pairwise(ways))
            leaves.add(ways[-1])
        assert sum(high - low for low, high in leaves) == b - a
        nodes = trees.nodes[trees.first_node[t] : trees.first_node[t + 1]]
        assert len(leaves) == len(nodes) + 1
        children = [n + 1 for n, w in enumerate(nodes[:, 0]) if not w & forest.LEFT]
        children += [int(r) for w, r in nodes[:, [0, 3]] if not w & forest.RIGHT]
        assert sorted(children) == list(range(1, len(nodes)))
        if leaf is not None and len(nodes):
            for low, high in leaves:
                assert high - low < 2 * leaf or all(len(np.unique(x[trees.rows[low:high], f])) == 1 for f in range(3))


def test_every_row_lies_in_the_leaf_that_its_features_lead_to(model):
    memory = model.memory
    _, x = features_of(memory, model.tracks)
    for trees, own in zip((memory.ways, memory.own), x, strict=True):
        part = trees._replace(first_node=trees.first_node[:4], first_row=trees.first_row[:4])
        sound(part, own)


@pytest.mark.parametrize("kind", ["random", "ties", "same", "one"])
def test_trees_of_any_numbers(kind):
    rng = np.random.default_rng(4)
    n = 1 if kind == "one" else 300
    x = rng.normal(size=(n, 3)).astype(np.float32)
    x = np.round(x) if kind == "ties" else np.zeros_like(x) if kind == "same" else x
    y = (x[:, :2] ** 2 + rng.normal(size=(n, 2))).astype(np.float32)
    rows, nodes = rng.permutation(n).astype(np.int32), np.zeros((n, 4), dtype=np.int32)
    none = np.zeros((0, 4), dtype=np.int32)
    count = forest.grow(x, y, rows, 3, 3, 9, none, nodes, nodes.view(np.float32))
    assert sorted(rows.tolist()) == list(range(n))
    assert (count > 0) == (kind in ("random", "ties"))
    nodes = nodes[:count].copy()
    trees = recall.Trees(nodes, nodes.view(np.float32), rows, np.array([0, count]), np.array([0, n]))
    sound(trees, x, leaf=3)


def test_trees_that_grow_on_keep_their_cuts(model):
    """Old rows keep their leaves, which are only cut further; new rows lie where their features lead."""
    memory = model.memory
    more = wf.Tracks.from_arrays(list(routes(7, 15)[0]), ids=[f"n{k}" for k in range(15)])
    large = model.extend(more)
    grown = large.memory
    assert len(grown.points) > len(memory.points)
    assert (grown.points[: len(memory.points)] == memory.points).all()
    assert (grown.step, grown.unit, grown.base, grown.slow) == (memory.step, memory.unit, memory.base, memory.slow)
    _, x = features_of(grown, large.tracks)
    begins, ends = (np.empty(forest.DEEPEST + 2, dtype=np.int64) for _ in range(2))
    for which, name in enumerate(("ways", "own")):
        old, new = getattr(memory, name), getattr(grown, name)
        sound(new._replace(first_node=new.first_node[:3], first_row=new.first_row[:3]), x[which])
        for t in range(0, len(old.first_node) - 1, 9):
            mine = set(old.rows[old.first_row[t] : old.first_row[t + 1]].tolist())
            rows = new.rows[new.first_row[t] : new.first_row[t + 1]].tolist()
            assert mine <= set(rows)
            for row in sorted(mine)[::50]:
                depth = way(x[which][row], old, t, begins, ends)
                before = set(old.rows[begins[depth - 1] : ends[depth - 1]].tolist())
                assert depth <= way(x[which][row], new, t, begins, ends)
                inside = set(new.rows[begins[depth - 1] : ends[depth - 1]].tolist())
                assert inside & mine == before


def test_neighbourhoods_are_those_of_loops(model):
    memory, past = model.memory, model.memory.past
    _, x = features_of(memory, model.tracks)
    rng, begins = np.random.default_rng(2), np.empty((2, forest.DEEPEST + 2), dtype=np.int64)
    for row in rng.integers(0, len(x[0]), 40).tolist():
        t = int(rng.integers(len(past.ways.first_node) - 1))
        depth = way(x[0][row], past.ways, t, begins[0], begins[1])
        ranges = naive.leaf_ranges(past.ways, t, x[0][row])
        for ahead in (0, 5, 60, 10_000):
            for need in (1, 4, 64):
                a, b, count = near(past.ways.rows, past, begins, depth, float(ahead), need)
                rows, alive = naive.neighbourhood(past.ways, past, ranges, ahead, need)
                assert past.ways.rows[a:b].tolist() == rows
                assert count == len(alive)


def test_the_best_shares_are_those_of_all_on_a_grid():
    rng = np.random.default_rng(5)
    steps = [(i / 20, j / 20, (20 - i - j) / 20) for i in range(21) for j in range(21 - i)]
    grid = np.array(steps)
    for _ in range(50):
        spread = rng.random(3) * 5
        points = rng.normal(size=(3, 30, 2)) * spread[:, None, None] + rng.normal(size=(3, 1, 2)) * 2
        near = np.linalg.norm(points, axis=2).mean(axis=1)
        cross = np.linalg.norm(points[:, None, :, None] - points[None, :, None], axis=4).mean(axis=(2, 3))
        out = np.full(3, 1 / 3)
        weighing.best_shares(near, cross, out)
        assert out.sum() == pytest.approx(1.0)
        assert (out >= 0).all()

        def score(w, near=near, cross=cross):
            return w @ near - 0.5 * np.einsum("...i,ij,...j", w, cross, w)

        assert score(out) <= score(grid).min() + 1e-3 * near.mean()


def test_the_density_is_that_of_scipy():
    rng = np.random.default_rng(6)
    for d in (1, 2, 3):
        for n in (2, 9, 40):
            points, at, floor = rng.normal(size=(n, d)) * 3, rng.normal(size=d) * 4, 0.5
            away = np.sort(np.linalg.norm(points - points.mean(axis=0), axis=1))
            width = np.hypot(0.8 * away[n // 2] * n ** (-1 / (d + 4)), floor)
            each = [multivariate_normal(p, width**2 * np.eye(d)).pdf(at) for p in points]
            assert density(points, at, floor) == pytest.approx(np.log(np.mean(each)), rel=1e-9)
