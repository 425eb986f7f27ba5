"""The exact filtration of large sets: cost beside the peers' matrix, and growth with the number of tracks.

``python -m benchmarks.filtration`` in the environment of ``make bench``. The peers (traj-dist-rs, tslearn) offer the
matrix only; their CPU seconds per pair are measured on a sample of each set, in turn with our fits, and multiplied by
the number of pairs. Clustering that matrix would come on top. Grand Central is used where ``../shared/data`` has it.
Memory is the highest resident set while fitting above that before it (Linux only).
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from statistics import median
from time import perf_counter, process_time

import numpy as np

from benchmarks.frechet import clustered_tracks
from wakefold.filtration import Filtration
from wakefold.tracks import Tracks

GRAND_CENTRAL = Path(__file__).resolve().parents[2] / "shared/data/grand_central/grand_central.parquet"


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


def peers_per_pair(tracks: Tracks, sample: int, seed: int = 0) -> dict[str, float]:
    """CPU seconds per pair of each peer, on tracks drawn from the set."""
    import traj_dist_rs  # pyright: ignore[reportMissingImports]
    from tslearn.metrics import cdist_frechet  # pyright: ignore[reportMissingImports]

    chosen = np.random.default_rng(seed).choice(len(tracks), sample, replace=False)
    arrays = [np.array(tracks[index]) for index in chosen]
    metric = traj_dist_rs.Metric.discret_frechet(type_d="euclidean")
    seconds = {}
    for name, run in {
        "traj-dist-rs": lambda: traj_dist_rs.pdist(arrays, metric=metric),
        "tslearn": lambda: cdist_frechet(arrays, n_jobs=os.cpu_count()),
    }.items():
        start = process_time()
        run()
        seconds[name] = (process_time() - start) / (sample * (sample - 1) / 2)
    return seconds


def timed_fit(tracks: Tracks) -> tuple[float, float]:
    """CPU and wall seconds of one fit."""
    cpu, wall = process_time(), perf_counter()
    Filtration.fit(tracks)
    return process_time() - cpu, perf_counter() - wall


def peak_memory(reset: bool = False) -> float:
    """Highest resident set since the last reset, MiB; nan where the system does not tell."""
    try:
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
        return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024
    except OSError:
        return float("nan")


def main(quick: bool = False) -> None:
    count, sample, rounds = (300, 40, 1) if quick else (1000, 300, 3)
    sets = {"clustered": clustered_tracks(count), "two hubs": two_hub_tracks(count)}
    if GRAND_CENTRAL.exists():
        sets["Grand Central"] = grand_central()
    Filtration.fit(clustered_tracks(700))  # compile
    peers_per_pair(sets["clustered"], 3)
    print(f"{os.cpu_count()} cores; medians of {rounds}\n")
    print("| tracks | mean points | CPU s | wall s | best peer's matrix, CPU s (from a sample) | ratio |")
    print("|---|---|---|---|---|---|")
    for name, tracks in sets.items():
        fits, peers = [], []
        for seed in range(rounds):
            fits.append(timed_fit(tracks))
            peers.append(min(peers_per_pair(tracks, sample, seed).values()))
        cpu, wall = (median(column) for column in zip(*fits, strict=True))
        peer = median(peers) * len(tracks) * (len(tracks) - 1) / 2
        mean = len(tracks.points) / len(tracks)
        print(f"| {len(tracks):,} {name} | {mean:.0f} | {cpu:.3g} | {wall:.3g} | {peer:.4g} | {peer / cpu:,.0f} |")

    base = sets.get("Grand Central", sets["clustered"])
    counts = [3162, 10_000] if quick else [3162, 10_000, 31_623, 100_000]
    print("\n| tracks drawn | CPU s | wall s | peak memory above the data, MiB |\n|---|---|---|---|")
    seconds = []
    for count in counts:
        tracks = drawn_from(base, count)
        before = peak_memory(reset=True)
        cpu, wall = timed_fit(tracks)
        peak = peak_memory() - before
        seconds.append(cpu)
        print(f"| {count:,} | {cpu:.3g} | {wall:.3g} | {peak:,.0f} |")
    slope = np.polyfit(np.log(counts), np.log(seconds), 1)[0]
    print(f"\nCPU seconds grow as the number of tracks to the power {slope:.2f}.")


if __name__ == "__main__":
    main(quick="--quick" in sys.argv[1:])
