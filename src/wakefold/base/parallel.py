"""Map a function over pieces of work: on the cores of this machine, or on a Ray cluster.

Kernels release the interpreter lock, so for them threads are enough and nothing is copied or pickled; work in Python
takes processes. Whatever runs a piece, its result is the same: an algorithm is written once, as
``executor.map(f, items, shared)``.
"""

from __future__ import annotations

import atexit
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar

import numpy as np

from wakefold.base.checks import whole

T = TypeVar("T")
R = TypeVar("R")
Progress = Callable[[float], None]
LINEAR_ALGEBRA = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def cores() -> int:
    """Number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_map(
    f: Callable[[T], R], items: Sequence[T], threads: int | None = None, progress: Progress | None = None
) -> list[R]:
    """``[f(x) for x in items]`` on several threads, in the order of the items.

    Args:
        f: should spend its time with the interpreter lock released.
        items: pieces of work of about equal cost, started in the order given.
        threads: all cores by default.
        progress: called with the share of the items that is done, in the calling thread.

    The first error cancels what has not started and is raised at once, Ctrl-C included: pieces then at work run to
    their end unheeded.
    """
    if threads is None:
        threads = cores()
    threads = whole(threads, "threads")
    if threads == 1 or len(items) < 2:
        results = []
        for done, item in enumerate(items, start=1):
            results.append(f(item))
            if progress:
                progress(done / len(items))
        return results
    results: list[Any] = [None] * len(items)
    todo, ended, next_one = iter(enumerate(items)), SimpleQueue(), threading.Lock()

    def work() -> None:
        while True:
            with next_one:
                index, item = next(todo, (-1, None))
            if index < 0:
                return
            try:
                results[index] = f(item)  # pyright: ignore[reportArgumentType]
                ended.put(None)
            except BaseException as error:
                ended.put(error)

    for _ in range(min(threads, len(items))):
        _lend_thread(work)
    try:
        for done in range(1, len(items) + 1):
            error = ended.get()
            if error is not None:
                raise error
            if progress:
                progress(done / len(items))
        return results
    finally:
        with next_one:
            todo = iter(())


# Threads wait for the next work rather than end: starting one can take as long as a whole search of a small set.
_waiting: list[SimpleQueue] = []
_threads: list[tuple[threading.Thread, SimpleQueue]] = []


def _lend_thread(work: Callable[[], None]) -> None:
    """Run something on a thread that has nothing to do, a new one if there is none."""
    try:
        inbox = _waiting.pop()
    except IndexError:
        inbox = SimpleQueue()
        thread = threading.Thread(target=_serve, args=(inbox,), daemon=True)
        _threads.append((thread, inbox))
        thread.start()
    inbox.put(work)


def _serve(inbox: SimpleQueue) -> None:
    while (work := inbox.get()) is not None:
        work()
        del work
        _waiting.append(inbox)


@atexit.register
def _end_threads() -> None:
    """A kernel must not be at work while the process is taken apart."""
    for _, inbox in _threads:
        inbox.put(None)
    for thread, _ in _threads:
        thread.join()


if hasattr(os, "register_at_fork"):  # a forked process has none of the threads
    os.register_at_fork(after_in_child=lambda: (_waiting.clear(), _threads.clear()))


class Executor(Protocol):
    """Where pieces of work run."""

    def share(self, array: np.ndarray) -> Any:
        """Lend an array to all pieces, read-only; what comes back is to be put into ``shared``."""
        ...

    def map(
        self, f: Callable[..., R], items: Sequence[Any], shared: tuple = (), progress: Progress | None = None
    ) -> list[R]:
        """``[f(x, *shared) for x in items]``; f is a function of a module, so that any machine can find it."""
        ...


class Threads:
    """Threads of this process, all cores by default."""

    def __init__(self, threads: int | None = None):
        self.threads = threads

    def share(self, array: np.ndarray) -> np.ndarray:
        view = array.view()
        view.flags.writeable = False  # as a worker elsewhere would see it, so kernels are compiled once for both
        return view

    def map(
        self, f: Callable[..., R], items: Sequence[Any], shared: tuple = (), progress: Progress | None = None
    ) -> list[R]:
        return thread_map(lambda item: f(item, *shared), items, self.threads, progress)


class Processes:
    """Processes of their own, all cores by default: for work that spends its time in Python.

    Items and results are copied between processes. Each starts afresh, so a script that uses this guards its main part
    by ``if __name__ == "__main__"``. The first error, Ctrl-C included, ends all of them at once.
    """

    def __init__(self, processes: int | None = None):
        self.processes = cores() if processes is None else processes
        if self.processes < 1:
            raise ValueError(f"processes must be at least 1, got {processes}")

    def share(self, array: np.ndarray) -> np.ndarray:
        return array

    def map(
        self, f: Callable[..., R], items: Sequence[Any], shared: tuple = (), progress: Progress | None = None
    ) -> list[R]:
        import multiprocessing as mp
        import signal

        if not items:
            return []
        others = set(mp.active_children())
        pool = ProcessPoolExecutor(
            min(self.processes, len(items)), mp.get_context("spawn"), signal.signal, (signal.SIGINT, signal.SIG_IGN)
        )
        try:
            with _one_thread_each():
                futures = [pool.submit(f, item, *shared) for item in items]
            for done, future in enumerate(as_completed(futures), start=1):
                future.result()
                if progress:
                    progress(done / len(items))
            return [future.result() for future in futures]
        except BaseException as error:
            for worker in set(mp.active_children()) - others:
                worker.terminate()
            if isinstance(error, BrokenProcessPool):
                raise ChildProcessError("a worker process was killed, perhaps for lack of memory") from None
            raise
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started meanwhile have one thread for linear algebra, unless the user has said how many.

    With a thread for each core in every process these wait for one another, at twice the CPU time; and how sums are cut
    up among them, and so their last bits, would depend on the machine.
    """
    ours = [name for name in LINEAR_ALGEBRA if name not in os.environ]
    os.environ.update(dict.fromkeys(ours, "1"))
    try:
        yield
    finally:
        for name in ours:
            os.environ.pop(name, None)


class Ray:
    """The workers of the Ray cluster that ``ray.init`` has connected this process to.

    Shared arrays are put into the object store once and mapped by all workers of a machine. A piece whose worker dies
    is run again by another, up to three times.

    Raises:
        ImportError: Ray is not installed.
        RuntimeError: not connected to a cluster.
    """

    def __init__(self):
        try:
            import ray
        except ImportError:
            raise ImportError("Ray is not installed: pip install 'wakefold[ray]'") from None
        if not ray.is_initialized():
            raise RuntimeError("not connected to a Ray cluster: call ray.init() first")
        self._ray = ray
        self._tasks: dict[Callable, Any] = {}

    def share(self, array: np.ndarray) -> Any:
        return self._ray.put(array)

    def map(
        self, f: Callable[..., R], items: Sequence[Any], shared: tuple = (), progress: Progress | None = None
    ) -> list[R]:
        if f not in self._tasks:
            self._tasks[f] = self._ray.remote(max_retries=3)(f)
        # Only some pieces are handed out ahead, and after an error none is added. Those at work are left to end:
        # ray.cancel on a task that is just ending can abort this process (a check of Ray 2.60 itself fails).
        ahead = 4 * max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        todo = iter(items)
        waiting = deque(self._tasks[f].remote(item, *shared) for item in islice(todo, ahead))
        results = []
        while waiting:
            results.append(self._ray.get(waiting.popleft()))
            waiting.extend(self._tasks[f].remote(item, *shared) for item in islice(todo, 1))
            if progress:
                progress(len(results) / len(items))
        return results
