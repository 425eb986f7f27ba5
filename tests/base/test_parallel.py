"""Pieces of work on threads and on Ray: in order, and the first error ends the rest."""

import os
import secrets
import signal
import sys
import threading
import time
import warnings
from types import SimpleNamespace

import numpy as np
import pytest

import wakefold as wf
from wakefold.base.parallel import LINEAR_ALGEBRA, Processes, Ray, Threads, cores, thread_map
from wakefold.model.linkage.spanning import spanning_tree
from wakefold.tracks.tracks import Tracks


@pytest.mark.parametrize("threads", [None, 1, 3])
def test_results_keep_the_order_of_the_items(threads):
    def slow_first(x):
        time.sleep(0.01 if x == 0 else 0)
        return x * x

    seen = []
    assert thread_map(slow_first, range(20), threads, seen.append) == [x * x for x in range(20)]
    assert seen[-1] == 1
    assert seen == sorted(seen)
    assert thread_map(slow_first, [], threads) == []


def test_threads_are_used():
    both = threading.Barrier(2, timeout=10)
    assert thread_map(lambda _: both.wait() >= 0, range(2), threads=2) == [True, True]


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
def test_an_error_cancels_what_has_not_started(threads, error):
    done = []

    def work(x):
        if x == 1:
            raise error
        time.sleep(0.005)
        done.append(x)

    with pytest.raises(error):
        thread_map(work, range(200), threads)
    assert len(done) < 100


def test_nonsense_is_refused():
    assert cores() >= 1
    with pytest.raises(ValueError, match="threads must be a whole number of at least 1"):
        thread_map(abs, [1], threads=0)


@pytest.mark.parametrize("threads", [1, 3])
def test_an_executor_of_threads_lends_arrays_it_protects(threads):
    executor = Threads(threads)
    lent = executor.share(np.array([5]))
    assert executor.map(lambda x, offset: x * x + offset[0], range(4), (lent,)) == [5, 6, 9, 14]
    with pytest.raises(ValueError, match="read-only"):
        lent[0] = 0


def test_an_error_does_not_wait_for_the_piece_at_work():
    release = threading.Event()

    def work(x):
        if x == 1:
            raise ZeroDivisionError
        release.wait(timeout=60)

    try:
        with pytest.raises(ZeroDivisionError):
            thread_map(work, range(2), threads=2)
        assert not release.is_set()
    finally:
        release.set()


def test_ray_says_what_it_lacks(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r"pip install 'wakefold\[ray\]'"):
        Ray()
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(is_initialized=lambda: False))
    with pytest.raises(RuntimeError, match=r"ray.init\(\)"):
        Ray()


def test_processes_have_one_thread_for_linear_algebra_unless_told_otherwise(monkeypatch):
    for name in LINEAR_ALGEBRA:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(LINEAR_ALGEBRA[0], "3")
    before = dict(os.environ)
    assert Processes(1).map(os.getenv, LINEAR_ALGEBRA) == ["3", *["1"] * (len(LINEAR_ALGEBRA) - 1)]
    assert dict(os.environ) == before


@pytest.fixture(scope="module")
def cluster():
    """A Ray cluster of two workers on this machine, reached by nobody else."""
    ray = pytest.importorskip("ray")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
        # Tests turn some warnings into errors; those of Ray are not ours.
        with warnings.catch_warnings(action="ignore"):
            ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False, object_store_memory=200 << 20)
        yield Ray()
        ray.shutdown()


def test_ray_maps_in_order(cluster):
    def square(x, offset):  # here, since the workers cannot import the tests
        return x * x + offset[0]

    seen = []
    lent = cluster.share(np.array([5]))
    assert cluster.map(square, range(4), (lent,), seen.append) == [5, 6, 9, 14]
    assert seen == [0.25, 0.5, 0.75, 1]
    assert cluster.map(square, [], (lent,)) == []
    with pytest.raises(TypeError):
        cluster.map(square, ["five"], (lent,))


def test_an_error_on_ray_starts_nothing_more_and_leaves_the_cluster_whole(cluster, tmp_path):
    """The pieces at work are not cancelled: cancelling one that just ends can abort the process that asked for it."""

    def work(item):
        run, x = item
        (tmp_path / f"{run} {x}").touch()
        return 1 / x

    for run in range(20):
        with pytest.raises(ZeroDivisionError):
            cluster.map(work, [(run, x) for x in range(200)])
        assert len(list(tmp_path.glob(f"{run} *"))) < 100
    assert cluster.map(work, [(run, 2)]) == [0.5]


def test_the_tree_survives_the_death_of_a_worker(cluster, tmp_path):
    """Of the many pieces of a fit, one of the search and one of the distances kill the process that runs them."""
    killed = []

    class Deadly(Ray):
        def map(self, f, items, shared=(), progress=None):
            mark = str(tmp_path / f.__name__)
            if os.path.exists(mark):
                return super().map(f, items, shared, progress)
            killed.append(f.__name__)
            last = len(items) - 1

            def deadly(item, *rest):
                number, piece = item
                if number == last and not os.path.exists(mark):
                    open(mark, "x").close()
                    os.kill(os.getpid(), signal.SIGKILL)
                return f(piece, *rest)

            return super().map(deadly, list(enumerate(items)), shared, progress)

    rng = np.random.default_rng(0)
    walks = [np.cumsum(rng.normal(size=(n, 2)), axis=0) for n in rng.integers(1, 60, 3000)]
    tracks = Tracks.from_arrays(walks)
    edges, heights = spanning_tree(tracks)
    by_ray = spanning_tree(tracks, executor=Deadly())
    np.testing.assert_array_equal(by_ray[0], edges)
    np.testing.assert_array_equal(by_ray[1], heights)
    assert killed == ["_search", "_measure"]
    assert len(os.listdir(tmp_path)) == 2


def test_who_compares_the_tracks_changes_no_bit_of_the_model(cluster):
    rng = np.random.default_rng(0)
    tracks = wf.Tracks.from_arrays([np.cumsum(rng.normal(10, 5, (20, 2)), axis=0) for _ in range(30)])
    alone = wf.learn(tracks)
    for executor in (Threads(2), cluster):
        model = wf.learn(tracks, executor=executor)
        for name in ("order", "gaps", "parent"):
            assert np.array_equal(getattr(model.filtration, name), getattr(alone.filtration, name))
        assert np.array_equal(model.dynamics.velocities, alone.dynamics.velocities)
        for name in ("epsilon", "scale"):
            assert getattr(model.dynamics, name) == getattr(alone.dynamics, name)
        with pytest.raises(ValueError, match="threads of this machine"):
            wf.learn(tracks, linkage="complete", executor=executor)
