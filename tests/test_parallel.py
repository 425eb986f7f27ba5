"""Pieces of work on threads: in order, and the first error ends the rest."""

import threading
import time

import pytest

from wakefold.parallel import cores, thread_map


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
    with pytest.raises(ValueError, match="threads must be at least 1"):
        thread_map(abs, [1], threads=0)
