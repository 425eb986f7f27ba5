"""The minimum spanning tree without the matrix: the same tree as with it, and bounds that bound."""

import signal
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import on_a_grid, same_place, two_hubs, walks

from wakefold.base import store
from wakefold.base.parallel import Threads
from wakefold.model import filtration
from wakefold.model.filtration import Filtration
from wakefold.model.linkage import spanning
from wakefold.model.linkage.bounds import MARGIN, boxes_of, features_of, frame_of
from wakefold.model.linkage.dendrogram import leaf_order
from wakefold.model.linkage.distance import frechet_matrix
from wakefold.model.linkage.spanning import spanning_tree
from wakefold.tracks.tracks import Tracks


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


def duplicates(rng, count, dim):
    few = walks(rng, 4, dim, 6)
    return [few[k] for k in rng.integers(0, 4, count)]


def collinear(rng, count, dim):
    return [np.outer(np.cumsum(rng.integers(-2, 3, n)), np.ones(dim)) for n in rng.integers(1, 20, count)]


def points(rng, count, dim):
    return [rng.normal(size=(1, dim)) for _ in range(count)]


def mixed_lengths(rng, count, dim):
    return [np.cumsum(rng.normal(size=(n, dim)), axis=0) for n in rng.choice([1, 2, 5, 150], count)]


KINDS = [equal_lengths, clusters, two_hubs, on_a_grid, duplicates, collinear, points, mixed_lengths, same_place]


def same_tree(tracks):
    by_matrix = Filtration.from_distances(frechet_matrix(tracks), tracks.ids)
    for long in (0, np.inf):  # tracks whose distances are computed in float32 first: all, none
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(spanning, "LONG", long)
            patch.setattr(spanning, "MANY", 0)
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
    for kind in (clusters, two_hubs, on_a_grid, mixed_lengths, same_place):
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
            frame = frame_of(tracks.points)
            boxes, unit = boxes_of(features_of(tracks, frame, 1)), frame.unit
            assert tracks.diagonal <= unit
            f = boxes.features.astype(np.float64) * unit
            gap = np.abs(f[:, None] - f[None])
            ends = [np.sqrt((gap[..., k : k + dim] ** 2).sum(axis=-1)) for k in (0, dim)]
            bound = np.maximum(np.maximum(*ends), gap.max(axis=-1))
            distance = frechet_matrix(tracks)[np.ix_(boxes.order, boxes.order)]
            closest = max(closest, float((bound - distance).max() / unit))
            if kind is two_hubs:
                assert (bound > distance / 3)[distance > 0.1 * distance.max()].mean() > 0.5  # and they are worth having
    assert MARGIN / 50 < closest < MARGIN


@pytest.mark.parametrize("count", [2, 9, 100, 3000])
def test_tiles_hold_every_pair_of_tracks_once(count):
    boxes = boxes_of(np.random.default_rng(7).normal(size=(count, 4)).astype(np.float32))
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


def test_fit_by_executor_and_checkpoint(tmp_path):
    tracks = Tracks.from_arrays(on_a_grid(np.random.default_rng(11), 200, 2))
    expected = Filtration.fit(tracks)
    with pytest.raises(KeyboardInterrupt):
        Filtration.fit(tracks, checkpoint=tmp_path / "kept", progress=interrupted_at(30))
    assert (tmp_path / "kept").is_dir()
    for options in ({"executor": Threads(2)}, {"checkpoint": tmp_path / "kept"}):
        found = Filtration.fit(tracks, **options)
        np.testing.assert_array_equal(found.order, expected.order)
        np.testing.assert_array_equal(found.gaps, expected.gaps)
        with pytest.raises(ValueError, match="complete linkage runs on the threads of this machine"):
            Filtration.fit(tracks, "complete", **options)


def test_progress_rises_to_one():
    seen = []
    spanning_tree(Tracks.from_arrays(clusters(np.random.default_rng(5), 100, 2)), progress=seen.append)
    assert seen[-1] == 1
    assert seen == sorted(seen)


@pytest.mark.parametrize("rounds", [1, 2])
def test_the_estimate_of_the_time_left_is_honest(rounds, monkeypatch):
    """By a clock of our own, with the seconds and tracks of a fit of 100,000 pedestrians."""
    seconds = [0.27, 0.34, 0.71, 0.8, 0.76, 0.47, 0.35, 0.3, 0.22, 0.19, 0.35]
    apart = [1, 0.94, 0.83, 0.44, 0.09, 0.016, 0.006, 0.002, 8e-4, 3e-4, 1e-4]
    now = 0.0
    monkeypatch.setattr(spanning, "monotonic", lambda: now)
    shown, when = [], []
    estimate = spanning.Estimate(lambda share: (shown.append(share), when.append(now)))
    now = 0.68
    for radius, cost in enumerate(seconds):
        estimate.radius()
        for step in range(100):
            if step * rounds % 100 == 0:
                estimate.round(np.inf if radius < 7 else len(seconds) - 1 - radius, apart[radius])
            now += cost / 100
            estimate.show((step + 1) * rounds / 100 - estimate.rounds + 1)
    assert shown == sorted(shown)
    assert shown[-1] == 1
    passed, share = np.array(when), np.array(shown)
    assert np.abs(share - passed / now).max() < 0.2
    early = passed < 0.9 * now
    factor = (
        ((passed / share - passed)[early]) / (now - passed)[early]
    )  # the time left by the share shown, and in truth
    assert factor.min() > 0.5
    assert factor.max() < 2.2


def interrupted_at(call):
    """A progress that is interrupted when it is called for so many-th time."""
    calls = 0

    def progress(share):
        nonlocal calls
        calls += 1
        if calls == call:
            raise KeyboardInterrupt

    return progress


@pytest.mark.parametrize("kind", [clusters, on_a_grid])
def test_an_interrupted_run_goes_on_from_its_checkpoint(kind, tmp_path, monkeypatch):
    monkeypatch.setattr(spanning, "ROOM", 500)  # so that a radius has several checkpoints
    tracks = Tracks.from_arrays(kind(np.random.default_rng(8), 800, 2))
    measured = []
    measure = spanning._measure
    monkeypatch.setattr(spanning, "_measure", lambda pairs, *rest: (measured.append(pairs), measure(pairs, *rest))[1])
    calls = []
    whole = leaf_order(*spanning_tree(tracks, progress=calls.append))
    cost = sum(pairs.shape[1] for pairs in measured)
    for call in (1, len(calls) // 3, len(calls) // 2, len(calls) - 1):
        kept = tmp_path / str(call)
        with pytest.raises(KeyboardInterrupt):
            spanning_tree(tracks, threads=1, progress=interrupted_at(call), checkpoint=kept)
        measured.clear()
        for found, expected in zip(leaf_order(*spanning_tree(tracks, checkpoint=kept)), whole, strict=True):
            np.testing.assert_array_equal(found, expected)
    assert sum(pairs.shape[1] for pairs in measured) < cost / 4  # the last had little left to do
    measured.clear()
    np.testing.assert_array_equal(leaf_order(*spanning_tree(tracks, checkpoint=kept))[1], whole[1])
    assert not measured


def test_a_run_interrupted_again_and_again_ends(tmp_path):
    tracks = Tracks.from_arrays(walks(np.random.default_rng(9), 700, 2, 30))
    for attempt in range(1000):
        try:
            _, heights = spanning_tree(tracks, 1, interrupted_at(40), checkpoint=tmp_path / "kept")
            break
        except KeyboardInterrupt:
            assert attempt < 500
    assert attempt > 3
    np.testing.assert_array_equal(heights, spanning_tree(tracks)[1])


def test_checkpoints_of_others_are_refused(tmp_path):
    tracks = Tracks.from_arrays(walks(np.random.default_rng(10), 60, 2, 9))
    kept = tmp_path / "kept"
    spanning_tree(tracks, checkpoint=kept)
    for other in (tracks.select(np.arange(59)), tracks.select(np.arange(60)[::-1])):
        with pytest.raises(ValueError, match="checkpoint of other tracks"):
            spanning_tree(other, checkpoint=kept)
    arrays, meta = store.load(kept, spanning.KIND)
    first, heights = arrays["first"], arrays["heights"]
    for wrong in (
        {"first": first + 60},
        {"first": first[1:]},
        {"first": first.astype(float)},
        {"heights": heights - 1e9},
        {"heights": np.full_like(heights, np.nan)},
        {"heights": heights.astype(np.float32)},
    ):
        store.save(tmp_path / "forged", {**arrays, **wrong}, meta, spanning.KIND)
        with pytest.raises(store.StoreError, match="not a forest of these tracks"):
            spanning_tree(tracks, checkpoint=tmp_path / "forged")
    store.save(tmp_path / "forged", dict(arrays), {**meta, "settled": "all"}, spanning.KIND)
    with pytest.raises(store.StoreError, match="not a forest of these tracks"):
        spanning_tree(tracks, checkpoint=tmp_path / "forged")
    (file,) = kept.glob("heights*.npy")
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(store.StoreError, match="damaged"):
        spanning_tree(tracks, checkpoint=kept)
    (tmp_path / "empty").mkdir()
    with pytest.raises(store.StoreError, match="not a stored spanning forest"):
        spanning_tree(tracks, checkpoint=tmp_path / "empty")


LONG_FIT = """
import numpy as np
from wakefold.base.parallel import Threads
from wakefold.model.linkage.spanning import spanning_tree
from wakefold.tracks.tracks import Tracks

def once(share):
    global told
    if not told:
        print("fitting", flush=True)
    told = True

told = False
rng = np.random.default_rng(0)
tracks = Tracks.from_arrays(list(rng.normal(0, 1, (3000, 1000, 2)) + np.linspace(0, 99, 1000)[:, None]))
try:
    spanning_tree(tracks, progress=once)
    print("done")
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no signal like that of Ctrl-C can be sent to one process")
def test_ctrl_c_ends_a_fit_of_half_an_hour():
    process = subprocess.Popen([sys.executable, "-c", LONG_FIT], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "fitting\n"
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=30)[0] == "interrupted\n"
        assert process.returncode == 0
    finally:
        process.kill()


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
