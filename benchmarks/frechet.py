"""The matrix of discrete Fréchet distances beside traj-dist-rs and tslearn, in one interleaved run.

``python -m benchmarks.frechet`` in the environment of ``make bench``. Tracks: clustered random walks, 100 points each,
2-D, seed 0. Everyone uses all cores; CPU seconds are those of the process, medians over the rounds. The table ends
with what compiling the kernels costs a new process, with an empty cache and with a full one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from statistics import median
from time import perf_counter, process_time

import numpy as np

from wakefold.model.linkage.distance import frechet_matrix
from wakefold.tracks.tracks import Tracks

FIRST_CALL = """
import json, sys, time
import numba, scipy.cluster.hierarchy
start = time.perf_counter()
from wakefold.model.linkage.distance import frechet_matrix
frechet_matrix([[[0.0, 0.0]], [[1.0, 1.0]]], dtype=sys.argv[1])
print(json.dumps(time.perf_counter() - start))
"""


def clustered_tracks(count: int, length: int = 100, seed: int = 0) -> Tracks:
    """Tracks around 20 smooth routes through a square kilometre, metres."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(0, 1000, (20, 4, 2))
    at = np.linspace(0, 3, length)
    routes = np.stack([[np.interp(at, range(4), corner[:, k]) for k in (0, 1)] for corner in corners]).swapaxes(1, 2)
    shift, wobble = rng.normal(0, 8, (count, 1, 2)), rng.normal(0, 1, (count, length, 2))
    return Tracks.from_arrays(list(routes[rng.integers(0, 20, count)] + shift + np.cumsum(wobble, axis=1)))


def contestants(tracks: Tracks) -> dict[str, Callable[[], np.ndarray]]:
    """Name -> function that returns the (M, M) matrix."""
    import traj_dist_rs  # pyright: ignore[reportMissingImports]
    from scipy.spatial.distance import squareform
    from tslearn.metrics import cdist_frechet  # pyright: ignore[reportMissingImports]

    arrays, block = list(tracks), np.stack(list(tracks))
    metric = traj_dist_rs.Metric.discret_frechet(type_d="euclidean")
    return {
        "wakefold float64": lambda: frechet_matrix(tracks),
        "wakefold float32": lambda: frechet_matrix(tracks, dtype="float32"),
        "traj-dist-rs": lambda: squareform(traj_dist_rs.pdist(arrays, metric=metric)),
        "tslearn": lambda: cdist_frechet(block, n_jobs=os.cpu_count()),
    }


def first_call(dtype: str, cache: str) -> float:
    """Seconds of the first matrix in a new process, numba and scipy already imported."""
    command = [sys.executable, "-c", FIRST_CALL, dtype]
    done = subprocess.run(command, capture_output=True, check=True, env=os.environ | {"NUMBA_CACHE_DIR": cache})
    return json.loads(done.stdout)


def main(quick: bool = False) -> None:
    count, rounds = (120, 1) if quick else (1000, 3)
    tracks = clustered_tracks(count)
    runs = contestants(tracks)
    for run in contestants(clustered_tracks(3)).values():
        run()  # compile, start threads
    exact = runs["wakefold float64"]()
    wall: dict[str, list[float]] = {name: [] for name in runs}
    cpu: dict[str, list[float]] = {name: [] for name in runs}
    error: dict[str, float] = {}
    for _ in range(rounds):
        for name, run in runs.items():
            wall_start, cpu_start = perf_counter(), process_time()
            matrix = run()
            wall[name].append(perf_counter() - wall_start)
            cpu[name].append(process_time() - cpu_start)
            error[name] = float(np.abs(matrix - exact).max())
    best_peer = min(median(cpu[name]) for name in ("traj-dist-rs", "tslearn"))
    pairs = count * (count - 1) / 2
    print(f"Matrix of {count:,} tracks of 100 points, 2-D; medians of {rounds}; {os.cpu_count()} cores\n")
    print(
        "| | CPU s | wall s | CPU µs per pair | best peer / this, CPU | largest error, m |\n|---|---|---|---|---|---|"
    )
    for name in runs:
        seconds = median(cpu[name])
        figures = f"{seconds:.3g} | {median(wall[name]):.3g} | {seconds / pairs * 1e6:.3g} | {best_peer / seconds:.3g}"
        print(f"| {name} | {figures} | {error[name]:.2g} |")
    print("\n| first call in a new process | nothing cached, s | cached, s |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as cache:
        for dtype in ("float64", "float32"):
            print(f"| {dtype} | {first_call(dtype, cache):.2f} | {first_call(dtype, cache):.2f} |")


if __name__ == "__main__":
    main(quick="--quick" in sys.argv[1:])
