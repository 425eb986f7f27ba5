"""The exact filtration of large sets: cost beside the peers' matrix, growth with the number of tracks, adding tracks.

``python -m benchmarks.filtration`` in the environment of ``make bench``; ``--million`` goes on to 1,000,000 tracks,
``--plot growth.png`` draws the growth. The peers (traj-dist-rs, tslearn) offer the matrix only; their CPU seconds per
pair are measured on a sample of each set, in turn with our runs, and multiplied by the number of pairs. Clustering that
matrix would come on top. Grand Central is used where ``../shared/data`` has it. Memory is the highest resident set
while fitting above that before it (Linux only).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter, process_time

import numpy as np

from benchmarks.frechet import clustered_tracks
from wakefold.model.filtration import Filtration
from wakefold.model.linkage.distance import frechet_matrix
from wakefold.tracks.tracks import Tracks

GRAND_CENTRAL = Path(__file__).resolve().parents[2] / "shared/data/grand_central/grand_central.parquet"

FIRST_CALL = """
import json, sys, time
start = time.perf_counter()
import numpy as np
import numba, scipy.cluster.hierarchy
import wakefold as wf
rng = np.random.default_rng(0)
tracks = wf.Tracks.from_arrays(list(np.cumsum(rng.normal(size=(int(sys.argv[1]), 10, 2)), axis=1)))
fit = wf.Filtration.fit
imported = time.perf_counter()
fit(tracks)
print(json.dumps([imported - start, time.perf_counter() - imported]))
"""


def two_hub_tracks(count: int, length: int = 100, seed: int = 0) -> Tracks:
    """Smooth random ways from one place to another a kilometre off, metres: end points tell nothing."""
    rng = np.random.default_rng(seed)
    at = np.linspace(0, 1, length)[:, None]
    bend = np.zeros((count, length, 2))
    for k in range(1, 6):
        bend += np.sin(k * np.pi * at) * rng.normal(0, [0, 40], (count, 1, 2))
    noise = rng.normal(0, 1, (count, length, 2)) * np.sin(np.pi * at)
    return Tracks.from_arrays(list(np.hstack([1000 * at, 0 * at]) + bend + noise))


def grand_central() -> Tracks:
    """11,787 pedestrians, metres."""
    import pyarrow.parquet as parquet

    table = parquet.read_table(GRAND_CENTRAL, columns=["track_id", "x", "y"])
    ids, x, y = (table.column(name).to_numpy() for name in ("track_id", "x", "y"))
    return Tracks.from_arrays(np.split(np.stack([x, y], axis=1), np.flatnonzero(ids[1:] != ids[:-1]) + 1))


def drawn_from(tracks: Tracks, count: int, seed: int = 0) -> Tracks:
    """Tracks drawn with replacement, shifted by N(0, 0.5 m), scaled about their mean by N(1, 0.03), with the spacing of
    their points multiplied by U(0.8, 1.25)."""
    rng = np.random.default_rng(seed)
    out = []
    for index in rng.integers(0, len(tracks), count):
        track = tracks[index]
        points = max(2, round((len(track) - 1) / rng.uniform(0.8, 1.25)) + 1)
        at = np.linspace(0, len(track) - 1, points)
        track = np.stack([np.interp(at, np.arange(len(track)), axis) for axis in track.T], axis=1)
        mean = track.mean(axis=0)
        out.append(mean + (track - mean) * rng.normal(1, 0.03) + rng.normal(0, 0.5, track.shape[1]))
    return Tracks.from_arrays(out)


SLOW = 300  # tracks of a sample for tslearn, which spends as long again in Python on each pair of short tracks


def peers_per_pair(tracks: Tracks, sample: int, seed: int = 0) -> dict[str, float]:
    """CPU seconds per pair of each peer, on tracks drawn from the set."""
    import traj_dist_rs  # pyright: ignore[reportMissingImports]
    from tslearn.metrics import cdist_frechet  # pyright: ignore[reportMissingImports]

    chosen = np.random.default_rng(seed).choice(len(tracks), sample, replace=False)
    arrays = [np.array(tracks[index]) for index in chosen]
    metric = traj_dist_rs.Metric.discret_frechet(type_d="euclidean")
    seconds = {}
    for name, some, run in (
        ("traj-dist-rs", arrays, lambda some: traj_dist_rs.pdist(some, metric=metric)),
        ("tslearn", arrays[:SLOW], lambda some: cdist_frechet(some, n_jobs=os.cpu_count())),
    ):
        start = process_time()
        run(some)
        seconds[name] = (process_time() - start) / (len(some) * (len(some) - 1) / 2)
    return seconds


def timed(run: Callable[[], object]) -> tuple[float, float]:
    """CPU and wall seconds."""
    cpu, wall = process_time(), perf_counter()
    run()
    return process_time() - cpu, perf_counter() - wall


def peak_memory(reset: bool = False) -> float:
    """Highest resident set since the last reset, MiB; nan where the system does not tell."""
    try:
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
        return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024
    except OSError:
        return float("nan")


def first_call(count: int, cache: str) -> tuple[float, float]:
    """Seconds of importing numba and all else, and of the first fit, in a new process."""
    command = [sys.executable, "-c", FIRST_CALL, str(count)]
    done = subprocess.run(command, capture_output=True, check=True, env=os.environ | {"NUMBA_CACHE_DIR": cache})
    return json.loads(done.stdout)


def beside_peers(quick: bool) -> None:
    count, sample, rounds = (300, 40, 1) if quick else (1000, 300, 3)
    clustered = clustered_tracks(count)
    runs = {
        "float32 matrix, clustered": (clustered, lambda: frechet_matrix(clustered, dtype="float32")),
        "tree, clustered": (clustered, lambda: Filtration.fit(clustered)),
        "tree, two hubs": ((hubs := two_hub_tracks(count)), lambda: Filtration.fit(hubs)),
    }
    if GRAND_CENTRAL.exists():
        crowd = grand_central()
        runs["tree, Grand Central"] = crowd, lambda: Filtration.fit(crowd)
    for _, run in runs.values():
        run()  # compile
    peers_per_pair(clustered, 3)
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in runs}
    for seed in range(rounds):
        for name, (tracks, run) in runs.items():
            drawn = sample if len(tracks) == count else 5 * sample
            found[name].append((*timed(run), min(peers_per_pair(tracks, drawn, seed).values())))
    print("| | tracks | mean points | CPU s | wall s | best peer's matrix, CPU s (from a sample) | ratio, CPU |")
    print("|---|---|---|---|---|---|---|")
    for name, (tracks, _) in runs.items():
        cpu, wall, pair = (median(column) for column in zip(*found[name], strict=True))
        peer = pair * len(tracks) * (len(tracks) - 1) / 2
        mean = len(tracks.points) / len(tracks)
        print(
            f"| {name} | {len(tracks):,} | {mean:.0f} | {cpu:.3g} | {wall:.3g} | {peer:.4g} | {peer / cpu:,.0f} |",
            flush=True,
        )


def growth(base: Tracks, counts: list[int], plot: str | None) -> None:
    print("\n| tracks drawn | points | CPU s | wall s | peak memory above the data, MiB |\n|---|---|---|---|---|")
    seconds = []
    Filtration.fit(drawn_from(base, counts[0]))  # compiles
    for count in counts:
        tracks = drawn_from(base, count)
        before = peak_memory(reset=True)
        cpu, wall = timed(lambda tracks=tracks: Filtration.fit(tracks))
        peak = peak_memory() - before
        seconds.append(cpu)
        print(f"| {count:,} | {len(tracks.points):,} | {cpu:.3g} | {wall:.3g} | {peak:,.0f} |", flush=True)
    slope, level = np.polyfit(np.log(counts), np.log(seconds), 1)
    print(f"\nCPU seconds grow as the number of tracks to the power {slope:.2f}.")
    if plot:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(4.5, 3), layout="constrained")
        ax = figure.subplots()
        ax.loglog(counts, seconds, "o", color="#1f4e79")
        ax.loglog(counts, np.exp(level) * np.array(counts) ** slope, color="#1f4e79", lw=1)
        ax.set(xlabel="tracks", ylabel="CPU seconds of a fit", title=f"exponent {slope:.2f}")
        ax.grid(alpha=0.3)
        figure.savefig(plot, dpi=110)


def adding(base: Tracks, count: int, rounds: int = 3) -> None:
    """1,000 tracks more, beside the fit; of a tree just fitted, which has the old tracks' boxes, and of one loaded."""
    tracks, drawn = drawn_from(base, count), drawn_from(base, 1000, seed=1)
    new = Tracks.from_arrays(list(drawn), ids=[f"new {k}" for k in range(len(drawn))])
    found = []
    for _ in range(rounds):
        fit = timed(lambda: Filtration.fit(tracks))
        tree = Filtration.fit(tracks)
        loaded = Filtration.unpacked(*tree.packed())
        fitted, anew = (timed(lambda tree=tree: tree.extend(tracks, new)) for tree in (tree, loaded))
        queries = timed(lambda tree=tree: [tree.query(track, tracks, k=5) for track in drawn])
        found.append([fit, fitted, anew, queries])
    median_of = np.median(np.array(found), axis=0)
    print(f"\n| {count:,} tracks | CPU s | wall s | share of the fit, CPU | wall |\n|---|---|---|---|---|")
    names = "fit", "1,000 added", "1,000 added to a tree loaded from disk", "5 nearest, 1,000 times"
    for name, (cpu, wall) in zip(names, median_of, strict=True):
        share = f"{cpu / median_of[0, 0]:.1%} | {wall / median_of[0, 1]:.1%}"
        print(f"| {name} | {cpu:.3g} | {wall:.3g} | {share} |")


def main(quick: bool = False, million: bool = False, plot: str | None = None) -> None:
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before\n")
    beside_peers(quick)
    base = grand_central() if GRAND_CENTRAL.exists() else clustered_tracks(1000)
    counts = [1000, 3162, 10_000] if quick else [1000, 3162, 10_000, 31_623, 100_000]
    growth(base, counts + [316_228, 1_000_000] * million, plot)
    adding(base, counts[-1])
    print("\n| new process | imports (numba, scipy), s | first fit, nothing cached, s | cached, s |\n|---|---|---|---|")
    for count in (100, 3000):
        with tempfile.TemporaryDirectory() as cache:
            (_, cold), (imports, cached) = first_call(count, cache), first_call(count, cache)
        print(f"| {count:,} tracks | {imports:.2f} | {cold:.2f} | {cached:.2f} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--million", action="store_true")
    parser.add_argument("--plot", metavar="FILE")
    main(**vars(parser.parse_args()))
