"""Map a function over pieces of work on the cores of this machine.

Kernels release the interpreter lock, so threads are enough and nothing is copied or pickled.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def cores() -> int:
    """Number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_map(
    f: Callable[[T], R],
    items: Sequence[T],
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[R]:
    """``[f(x) for x in items]`` on several threads, in the order of the items.

    Args:
        f: should spend its time with the interpreter lock released.
        items: pieces of work of about equal cost, started in the order given.
        threads: all cores by default.
        progress: called with the share of the items that is done, in the calling thread.

    The first error (Ctrl-C included) cancels what has not started and is raised when the pieces at work are done.
    """
    if threads is None:
        threads = cores()
    if threads < 1:
        raise ValueError(f"threads must be at least 1, got {threads}")
    if threads == 1 or len(items) < 2:
        results = []
        for done, item in enumerate(items, start=1):
            results.append(f(item))
            if progress:
                progress(done / len(items))
        return results
    with ThreadPoolExecutor(min(threads, len(items))) as pool:
        try:
            futures = [pool.submit(f, item) for item in items]
            pending = set(futures)
            while pending:
                finished, pending = wait(pending, return_when=FIRST_COMPLETED)
                for future in finished:
                    future.result()
                if progress:
                    progress(1 - len(pending) / len(items))
            return [future.result() for future in futures]
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
