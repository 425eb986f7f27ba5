"""Digests of what the commands answer, to tell whether a change of code, or another processor, changes a result.

``python -m benchmarks.digests [--json FILE] [--against FILE]`` prints a line ``name sha256`` for each result: of
``info``, ``learn``, ``show``, ``track`` and ``relations`` on the demo's data and on three sets of ``../shared/data``
where these are at hand, of ``reproduce --quick``, and of filters as Python calls them (``digests_parts``). Inputs are
cut, always alike. ``--settings`` runs all of it under each setting of ``SETTINGS`` and names what differs.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import io
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np

import wakefold as wf

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
LEVELS = 3
AHEAD = (5, 20)  # sample intervals, of the forecasts
TOLD = 5  # every so many fixes a class is reported too
FILTERS = (
    ("mhpf", "arxiv2016"),
    ("mhpf", "gsi2017"),
    ("bl1", None),
    ("bl1+coarse", None),
    ("bl2", None),
)
BLAS = ("Haswell", "Zen", "Sandybridge", "Nehalem", "SkylakeX")  # kernels of OpenBLAS
WIDE = "X86_V4 AVX512_ICL AVX512_SPR AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL"  # as numpy names AVX-512
# The linear algebra's kernels by OPENBLAS_CORETYPE, and the instruction sets of numpy: without AVX-512, without AVX2.
SETTINGS: dict[str, dict[str, str]] = {f"OpenBLAS {name}": {"OPENBLAS_CORETYPE": name} for name in BLAS} | {
    "numpy without AVX-512": {"NPY_DISABLE_CPU_FEATURES": WIDE},
    "numpy without AVX2": {"NPY_DISABLE_CPU_FEATURES": f"X86_V3 AVX2 FMA3 {WIDE}"},
}


def legal_settings() -> dict[str, dict[str, str]]:
    """The settings that this processor can run."""
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__  # pyright: ignore

    legal = {}
    for name, variables in SETTINGS.items():
        if "SkylakeX" in name and not __cpu_features__.get("AVX512F"):
            continue
        if (off := variables.get("NPY_DISABLE_CPU_FEATURES")) is not None:
            kept = [f for f in off.split() if f in __cpu_dispatch__ and __cpu_features__.get(f)]
            if not kept:
                continue
            variables = {"NPY_DISABLE_CPU_FEATURES": " ".join(kept)}
        legal[name] = variables
    return legal


def digest(*values: object) -> str:
    """Of arrays (bytes and shape), bytes and texts."""
    out = hashlib.sha256()
    for value in values:
        if isinstance(value, np.ndarray):
            out.update(repr((value.dtype.str, value.shape)).encode())
            value = np.ascontiguousarray(value).tobytes()
        out.update(value if isinstance(value, bytes) else str(value).encode())
    return out.hexdigest()


class Data(NamedTuple):
    """A set of tracks: files to learn from and to follow, and how they are learned."""

    name: str
    past: Path
    now: Path
    learn: tuple[str, ...]


def command(folder: Path, *arguments: str) -> str:
    """Standard output of ``wakefold`` in a folder."""
    run = [sys.executable, "-m", "wakefold", *arguments]
    done = subprocess.run(run, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"wakefold {' '.join(arguments)}: {done.stderr}")
    return done.stdout


def lines(source: Path, target: Path, keep: Callable[[int, str], bool]) -> Path:
    """The lines of a text that are kept, as a file of their own."""
    with source.open(encoding="utf-8") as file:
        target.write_text("".join(line for n, line in enumerate(file) if keep(n, line)), encoding="utf-8")
    return target


def rows(source: Path, target: Path, column: str, low: object, high: object) -> Path:
    """The rows of a Parquet file whose column lies in [low, high)."""
    from pyarrow import parquet

    parquet.write_table(parquet.read_table(source, filters=[(column, ">=", low), (column, "<", high)]), target)
    return target


def data(folder: Path) -> Iterator[Data]:
    """The sets that are at hand, cut."""
    from datetime import datetime

    harbour = Path(str(resources.files("tracktable_data") / "python_example_data"))
    past = lines(harbour / "NYHarbor_2020_12_first_week.traj", folder / "week.traj", lambda n, _: n % 4 == 0)
    now = lines(harbour / "NYHarbor_2020_12_08.traj", folder / "day.traj", lambda n, _: n % 4 == 0)
    settings = ("--stop", "150m,10min", "--min-length", "2km", "--spacing", "200m", "--epsilon", "300m")
    yield Data("harbour", past, now, settings)
    if (whole := SHARED / "grand_central" / "grand_central.parquet").exists():
        cut = [rows(whole, folder / f"station{i}.parquet", "track_id", 300 * i, 300 * i + 300) for i in range(2)]
        yield Data("station", cut[0], cut[1], ())
    if (whole := SHARED / "kattegat_dma" / "kattegat_2025-11-01_02.parquet").exists():
        days = [datetime(2025, 11, day) for day in (1, 2, 3)]
        cut = [rows(whole, folder / f"kattegat{i}.parquet", "Timestamp", days[i], days[i + 1]) for i in range(2)]
        yield Data("kattegat", cut[0], cut[1], ("--spacing", "500m"))
    if (whole := SHARED / "edinburgh_forum" / "tracks.01Jul.txt").exists():

        def kept(first: int, last: int) -> Callable[[int, str], bool]:
            return lambda n, _: n == 0 or first <= n < last

        cut = [lines(whole, folder / f"forum{i}.txt", kept(800 * i, 800 * i + 800)) for i in range(2)]
        yield Data("forum", cut[0], cut[1], ("--linkage", "complete"))


def observations(model: wf.Model, now: Path, agents: int = 6, fixes: int = 80) -> str:
    """A feed of the longest tracks, in order of time; now and then a class is reported too."""
    tracks = wf.read_tracks(now)[0]
    if model.tracks.projection is not None:
        tracks = tracks.project(model.tracks.projection)
    tree = model.filtration
    level = float(tree.levels(LEVELS)[1])
    found = []
    for number in np.argsort(-tracks.lengths, kind="stable")[:agents].tolist():
        told = tree.query(tracks[number], model.tracks, k=1)[0][0]
        for k, (time, at) in enumerate(zip(tracks.times_of(number), tracks[number], strict=True)):
            if k < fixes:
                report = (f"track:{model.tracks.ids[told]}", level, 0.8) if k % TOLD == TOLD - 1 else ("", "", "")
                found.append((float(time), f"agent {number}", *at.tolist(), *report))
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(["time", "agent", "x", "y", "class", "level", "confidence"])
    table.writerows(sorted(found))
    return out.getvalue()


def of_data(folder: Path, skip: set[str]) -> Iterator[tuple[str, str]]:
    """Digests of all commands on all sets."""
    for d in data(folder):
        name, model = d.name, f"{d.name}.model"
        yield f"{name} info", digest(command(folder, "info", d.past.name, "--json"))
        told = command(folder, "learn", d.past.name, "-o", model, *d.learn)
        yield f"{name} learn, said", digest(told)
        known = wf.load(folder / model)
        t, v = known.filtration, known.dynamics
        yield f"{name} learn, tree", digest(t.order, t.parent, t.birth, t.death, t.lo, t.hi)
        field = (v.points, v.velocities, v.epsilon, v.diagonal, v.interval, v.noise, v.scale, known.sd)
        yield f"{name} learn, dynamics", digest(*field)
        height = f"{float(t.levels(LEVELS)[1])!r}m"
        options: list[tuple[str, tuple[str, ...]]] = [("--newick", ()), ("--linkage", ())]
        if known.tracks.projection is not None:
            options.append(("--geojson", ("--level", height)))
        for option, level in options:
            yield f"{name} show {option}", digest(command(folder, "show", model, option, "-", *level))
        feed = observations(known, d.now)
        (folder / "feed.csv").write_text(feed, encoding="utf-8")
        yield f"{name} feed", digest(feed)
        ahead = ",".join(f"{steps * v.interval:g}s" for steps in AHEAD)
        for kind, rule in FILTERS if "track" not in skip else ():
            settings = ["--filter", kind, *(("--rule", rule) if rule else ()), "--forecast", ahead]
            settings += [] if kind == "bl2" else ["--levels", str(LEVELS)]
            answers = command(folder, "track", model, "feed.csv", "--format", "jsonl", "--depletion", "0.02", *settings)
            yield f"{name} track {kind} {rule or ''}".strip(), digest(answers)
        if "relations" not in skip:
            yield f"{name} relations", digest(command(folder, "relations", d.now.name, "--json"))


def of_experiments(folder: Path) -> Iterator[tuple[str, str]]:
    """Digests of the numbers of ``reproduce --quick``; results that two figures share count for the first."""
    seen: set[Path] = set()
    for line in command(folder, "reproduce", "--list").splitlines():
        figure = line.split()[0]
        said = command(folder, "reproduce", figure, "--quick", "--out", "out")
        new = set((folder / "out" / "results").glob("*.json")) - seen
        seen |= new
        results = sorted(json.dumps(json.loads(file.read_text())["result"]) for file in new)
        yield f"reproduce {figure}", digest(*results, *(text for text in said.splitlines() if text.startswith(figure)))


def all_digests(skip: set[str], only: set[str]) -> dict[str, str]:
    """Everything but what is skipped, printed as it comes."""
    from benchmarks import digests_parts

    out: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as place:
        parts: dict[str, Callable[[], Iterator[tuple[str, str]]]] = {
            "parts": lambda: ((name, digest(*values)) for name, values in digests_parts.parts()),
            "data": lambda: of_data(Path(place), skip),
            "reproduce": lambda: of_experiments(Path(place)),
        }
        for part, run in parts.items():
            if part not in skip and (not only or part in only):
                for name, value in run():
                    out[name] = value
                    print(name.ljust(40), value, flush=True)
    return out


def differing(ours: dict[str, str], theirs: dict[str, str]) -> list[str]:
    """Names of digests in both that differ."""
    return [name for name in ours if theirs.get(name, ours[name]) != ours[name]]


def under_settings(arguments: list[str]) -> int:
    """Run under every setting that the processor knows and say what differs from the first; how many differ."""
    first: dict[str, str] = {}
    count = 0
    with tempfile.TemporaryDirectory() as place:
        for setting, variables in legal_settings().items():
            file = Path(place) / "digests.json"
            run = [sys.executable, "-m", "benchmarks.digests", *arguments, "--json", str(file)]
            subprocess.run(run, env={**os.environ, **variables}, stdout=subprocess.DEVNULL, check=True)
            found = json.loads(file.read_text())
            first = first or found
            differs = differing(found, first)
            count += len(differs)
            print(f"{setting}: {len(found)} digests, {len(differs)} differ", *differs, sep="\n  ", flush=True)
    return count


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--json", type=Path, help="write the digests to this file")
    options.add_argument("--against", type=Path, help="compare with this file; exit 1 if any differs")
    options.add_argument("--skip", action="append", default=[], help="parts, data, track, relations or reproduce")
    options.add_argument("--only", action="append", default=[], help="parts, data or reproduce")
    options.add_argument("--settings", action="store_true", help="run under every setting that the processor knows")
    asked = options.parse_args()
    if asked.settings:
        chosen = [f"--skip={name}" for name in asked.skip] + [f"--only={name}" for name in asked.only]
        raise SystemExit(1 if under_settings(chosen) else 0)
    found = all_digests(set(asked.skip), set(asked.only))
    if asked.json is not None:
        asked.json.write_text(json.dumps(found, indent=1) + "\n")
    if asked.against is not None:
        before = json.loads(asked.against.read_text())
        differs = differing(found, before)
        missing = sorted(before.keys() - found.keys())
        print(f"{len(found)} digests, {len(differs)} differ", *differs, sep="\n  ")
        print(f"{len(missing)} of the file are not here", *missing, sep="\n  ")
        raise SystemExit(1 if differs else 0)


if __name__ == "__main__":
    main()
