"""Time of one filter step beside Stone Soup, one thread, in one interleaved run.

``python -m benchmarks.filters [directory of real data]`` in the environment of ``make bench``. Harbour rows: New York
AIS of 1-7 December 2020 (``NYHarbor_2020_12_first_week.traj`` of the PyPI package tracktable-data), resampled at 200 m;
tracks of that week are followed at the median sample interval by fixes with an error of 100 m. Small rows: 33 smooth
random tracks of 30 points on average in the unit square. Medians over steps, with the quartiles.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from time import perf_counter, thread_time
from typing import Any, NamedTuple

import numpy as np

import wakefold as wf

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "nyharbor_ais"
NAME = "NYHarbor_2020_12_first_week.traj"
FIX_SD = 100.0  # metres

FIRST_STEPS = """
import json, time
import numpy as np
start = time.perf_counter()
import wakefold as wf
imported = time.perf_counter() - start
import numba, scipy.cluster.hierarchy, pyproj, pyarrow.csv
wf.learn, wf.MHPF, wf.BL1, wf.BL2  # their modules are loaded before the clock starts: it is the kernels that count
rng = np.random.default_rng(0)
lines = [np.cumsum(rng.normal(size=(30, 2)), axis=0) for _ in range(6)]
tracks = wf.Tracks.from_arrays(lines)
start, cpu = time.perf_counter(), time.process_time()
tracks = tracks.segment(max_gap=50.0).resample(spacing=0.5)
model = wf.learn(tracks)
for make in (wf.MHPF, wf.BL1, wf.BL2):
    f = make(model)
    belief = f.start(fix=wf.Fix((0.0, 0.0), sd=1.0))
    evidence = [wf.Fix((0.0, 0.0), sd=1.0), wf.CoarseClass(model.filtration.parent[0])]
    belief = f.step(belief, evidence, dt=2.5 * model.dynamics.interval)
    belief.map(model.filtration.birth[-1]), belief.mean(), belief.mean("stack"), belief.cov(), f.forecast(belief, 3.0)
print(json.dumps([imported, time.perf_counter() - start, time.process_time() - cpu]))
"""

DEMO = """
import contextlib, io, json, sys, threading, time
from pathlib import Path
from numba.core import event
from wakefold.experiments.harbour import demo
spent, depth = [], threading.local()
class Outermost(event.Listener):
    def on_start(self, event):
        depth.now = getattr(depth, "now", 0) + 1
        if depth.now == 1:
            depth.begin = time.thread_time()
    def on_end(self, event):
        depth.now -= 1
        if depth.now == 0:
            spent.append(time.thread_time() - depth.begin)
event.register("numba:compile", Outermost())
demo.run(Path(sys.argv[1]), lambda *share: None, lambda line: None)
print(json.dumps(sum(spent)))
"""


class Course(NamedTuple):
    """What one filter is shown: a first fix and those that follow, ``dt`` seconds apart."""

    fixes: np.ndarray  # (n, d) metres
    sd: float
    dt: float


def harbour(directory: Path) -> wf.Model:
    tracks, _ = wf.read_tracks(directory / NAME)
    return wf.learn(tracks.resample(spacing=200.0))


def small(seed: int = 0) -> wf.Model:
    """33 smooth random tracks in the unit square, 10 to 50 points each, one second between points."""
    rng = np.random.default_rng(seed)
    tracks = []
    for length in rng.integers(10, 51, 33):
        corners, at = rng.uniform(0, 1, (3, 2)), np.linspace(0, 1, length)[:, None]
        tracks.append((1 - at) ** 2 * corners[0] + 2 * at * (1 - at) * corners[1] + at**2 * corners[2])  # Bézier
    return wf.learn(wf.Tracks.from_arrays(tracks))


def course(model: wf.Model, track: int, sd: float, most: int, rng: np.random.Generator) -> Course:
    """A track of the model seen at the median sample interval, with an error."""
    dt, times = model.dynamics.interval, model.tracks.times_of(track)
    at = np.arange(times[0], times[-1], dt)[:most]
    points = np.column_stack([np.interp(at, times, column) for column in model.tracks[track].T])
    return Course(points + rng.normal(0, sd, points.shape), sd, dt)


class Times:
    """Wall and CPU seconds of the steps of one contestant."""

    def __init__(self) -> None:
        self.wall: list[float] = []
        self.cpu: list[float] = []

    def add(self, step: Callable[[], Any]) -> Any:
        wall, cpu = perf_counter(), thread_time()
        out = step()
        self.cpu.append(thread_time() - cpu)
        self.wall.append(perf_counter() - wall)
        return out

    def row(self, per: float = 1e-6) -> str:
        wall, cpu = np.array(self.wall) / per, np.percentile(self.cpu, [25, 50, 75]) / per
        return f"{np.median(wall):.4g} | {cpu[1]:.4g} | {cpu[0]:.4g} to {cpu[2]:.4g}"


class Run:
    """One filter along courses, a step at a time; and what its particles were like."""

    def __init__(self, f: wf.MHPF | wf.BL1 | wf.BL2, sets: bool = False) -> None:
        self.filter, self.times, self.recoveries, self.sets = f, Times(), 0, sets
        self.belief: Any = None
        self.shape: list[tuple[int, int]] = []  # different particles, different tracks

    def begin(self, way: Course) -> None:
        self.belief = self.filter.start(fix=wf.Fix(way.fixes[0], sd=way.sd))

    def step(self, way: Course, k: int) -> None:
        evidence, lost = [wf.Fix(way.fixes[k], sd=way.sd)], self.belief.recoveries

        def both() -> Any:
            after = self.filter.step(self.belief, evidence, dt=way.dt)
            if self.sets:  # also where the particles of all coarse sets are
                after.mean("stack")
            return after

        self.belief = self.times.add(both)
        self.recoveries += self.belief.recoveries - lost
        if k % 5 == 0:
            points, classes, _ = self.filter._open(self.belief)  # what the next step starts from
            different = len(np.unique(np.column_stack([points, classes]), axis=0))
            self.shape.append((different, len(np.unique(classes))))


class StoneSoup:
    """Stone Soup's particle predict and update of the same N: constant velocity, a position measurement."""

    def __init__(self, particles: int) -> None:
        from stonesoup.models.measurement.linear import LinearGaussian  # pyright: ignore[reportMissingImports]
        from stonesoup.models.transition.linear import (  # pyright: ignore[reportMissingImports]
            CombinedLinearGaussianTransitionModel,
            ConstantVelocity,
        )
        from stonesoup.predictor.particle import ParticlePredictor  # pyright: ignore[reportMissingImports]
        from stonesoup.resampler.particle import SystematicResampler  # pyright: ignore[reportMissingImports]
        from stonesoup.updater.particle import ParticleUpdater  # pyright: ignore[reportMissingImports]

        np.random.seed(0)  # noqa: NPY002 (Stone Soup draws from the global generator)
        self.particles, self.times, self.clock = particles, Times(), datetime(2020, 12, 1)
        motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.1), ConstantVelocity(0.1)])
        self.sight = LinearGaussian(ndim_state=4, mapping=(0, 2), noise_covar=np.eye(2) * FIX_SD**2)
        self.predictor = ParticlePredictor(motion)
        self.updater = ParticleUpdater(self.sight, resampler=SystematicResampler())
        self.state: Any = None

    def begin(self, way: Course) -> None:
        from stonesoup.types.array import StateVectors  # pyright: ignore[reportMissingImports]
        from stonesoup.types.numeric import Probability  # pyright: ignore[reportMissingImports]
        from stonesoup.types.state import ParticleState  # pyright: ignore[reportMissingImports]

        (x, y), n = way.fixes[0], self.particles
        spread = np.random.default_rng(0).normal(size=(4, n)) * np.array([[way.sd], [5.0], [way.sd], [5.0]])
        states = StateVectors(np.array([[x], [0.0], [y], [0.0]]) + spread)
        weight = np.array([Probability(1 / n)] * n)
        self.state = ParticleState(state_vector=states, weight=weight, timestamp=self.clock)

    def step(self, way: Course, k: int) -> None:
        from stonesoup.types.detection import Detection  # pyright: ignore[reportMissingImports]
        from stonesoup.types.hypothesis import SingleHypothesis  # pyright: ignore[reportMissingImports]

        self.clock += timedelta(seconds=way.dt)
        seen = Detection(way.fixes[k][:, None], timestamp=self.clock, measurement_model=self.sight)

        def both() -> Any:
            prediction = self.predictor.predict(self.state, timestamp=self.clock)
            return self.updater.update(SingleHypothesis(prediction, seen))

        self.state = self.times.add(both)


def follow(runs: Sequence[Run | StoneSoup], courses: list[Course], warm: int = 2) -> None:
    """All contestants along all courses, taking turns at every course; the first steps of all only warm up."""
    for n, way in enumerate([courses[0], *courses]):
        for run in runs:
            run.begin(way)
            for k in range(1, len(way.fixes) if n else 1 + warm):
                run.step(way, k)
            if not n:
                run.times = Times()


def balls(model: wf.Model, courses: list[Course], tracks: list[int]) -> tuple[float, float]:
    """Mean number of points in the ball around the fixes: of the track itself, of all tracks."""
    from scipy.spatial import KDTree

    radius = model.dynamics.epsilon
    everything = KDTree(model.tracks.points)
    own, everyone = [], []
    for way, track in zip(courses, tracks, strict=True):
        own += [len(x) for x in KDTree(model.tracks[track]).query_ball_point(way.fixes, radius)]
        everyone += [len(x) for x in everything.query_ball_point(way.fixes, radius)]
    return float(np.mean(own)), float(np.mean(everyone))


def table(title: str, model: wf.Model, runs: dict[str, Any], courses: list[Course], tracks: list[int]) -> None:
    leaf, root = balls(model, courses, tracks)
    steps = sum(len(way.fixes) - 1 for way in courses)
    print(
        f"\n{title}: {len(model.tracks)} tracks, {len(model.tracks.points):,} points, epsilon "
        f"{model.dynamics.epsilon:.4g}, {leaf:.0f} points of the own track and {root:,.0f} of all in the ball around a "
        f"fix, {steps} steps of {model.dynamics.interval:.3g} s\n"
    )
    print("| step, N = 100 | wall, µs | CPU, µs | CPU, quartiles | different particles | tracks | recoveries |")
    print("|---|---|---|---|---|---|---|")
    for name, run in runs.items():
        shape = "| |" if isinstance(run, StoneSoup) else "{:.0f} | {:.0f} |".format(*np.median(run.shape, axis=0))
        print(f"| {name} | {run.times.row()} | {shape} {getattr(run, 'recoveries', '')} |")


def sizes(model: wf.Model, way: Course, counts: list[int], rounds: int) -> None:
    """Cost per particle as their number grows."""
    runs = {n: Run(wf.BL1(model, n)) for n in counts}
    follow(list(runs.values()), [way] * rounds)
    print("\n| BL1, N | wall, ns per particle | CPU, ns per particle | CPU, quartiles | different particles |")
    print("|---|---|---|---|---|")
    for n, run in runs.items():
        print(f"| {n:,} | {run.times.row(n * 1e-9)} | {np.median(run.shape, axis=0)[0]:,.0f} |")
    flat = [median(run.times.cpu) / n for n, run in runs.items()]
    print(f"\nLargest over smallest, CPU: {max(flat) / min(flat):.2f}")


def first_steps(cache: str) -> list[float]:
    """Seconds of ``import wakefold``, wall and CPU seconds of the first use of all kernels, in a new process."""
    done = subprocess.run(
        [sys.executable, "-c", FIRST_STEPS],
        capture_output=True,
        check=True,
        env=os.environ | {"NUMBA_CACHE_DIR": cache},
    )
    return json.loads(done.stdout)


def demo_kernels() -> float:
    """CPU seconds that the demo compiles for, of the threads that do, where nothing was compiled before."""
    with tempfile.TemporaryDirectory() as room:
        done = subprocess.run(
            [sys.executable, "-c", DEMO, str(Path(room) / "demo")],
            capture_output=True,
            check=True,
            env=os.environ | {"NUMBA_CACHE_DIR": str(Path(room) / "cache")},
        )
    return json.loads(done.stdout)


def main(quick: bool = False, directory: Path = DATA) -> None:
    rng = np.random.default_rng(0)
    filters: dict[str, Callable[[wf.Model], Any]] = {
        "BL1": wf.BL1,
        "BL2": wf.BL2,
        "MHPF, 8 levels": wf.MHPF,
        "MHPF, all levels": lambda model: wf.MHPF(model, levels="all"),
    }
    for title in ("Harbour", "Unit square"):
        if title == "Harbour" and not (directory / NAME).exists():
            print(f"no real data: {NAME} is not here, the harbour rows are left out")
            continue
        model, sd = (harbour(directory), FIX_SD) if title == "Harbour" else (small(), 0.02)
        long = [k for k in range(len(model.tracks)) if model.tracks.lengths[k] >= (60 if title == "Harbour" else 10)]
        tracks = [int(k) for k in rng.choice(long, 2 if quick else 25, replace=False)]
        courses = [course(model, k, sd, 30 if quick else 60, rng) for k in tracks]
        runs: dict[str, Any] = {name: Run(make(model)) for name, make in filters.items()}
        for name in ("MHPF, 8 levels", "MHPF, all levels"):
            runs[f"{name}, with the estimate of the stack"] = Run(filters[name](model), sets=True)
        if title == "Harbour" and find_spec("stonesoup"):
            runs["Stone Soup, particle predict + update"] = StoneSoup(100)
        follow(list(runs.values()), courses)
        table(title, model, runs, courses, tracks)
        if "Stone Soup, particle predict + update" in runs:
            theirs = median(runs["Stone Soup, particle predict + update"].times.cpu)
            print(f"\nStone Soup / BL1, CPU: {theirs / median(runs['BL1'].times.cpu):.1f}")
        if title == "Harbour":
            way = max(courses, key=lambda way: len(way.fixes))
            counts = [1000, 3000] if quick else [1000, 3000, 10_000, 30_000, 100_000]
            sizes(model, way._replace(fixes=way.fixes[:20]), counts, rounds=2)
    with tempfile.TemporaryDirectory() as cache:
        print("\n| new process | import wakefold, s | first use of all kernels, wall s | CPU s |\n|---|---|---|---|")
        for state in ("nothing compiled yet", "compiled before"):
            imported, wall, cpu = first_steps(cache)
            print(f"| {state} | {imported:.3f} | {wall:.2f} | {cpu:.2f} |")
    if find_spec("tracktable_data"):
        print(f"\nKernels of the demo, nothing compiled yet: {demo_kernels():.2f} CPU s")


if __name__ == "__main__":
    rest = [argument for argument in sys.argv[1:] if argument != "--quick"]
    main(quick="--quick" in sys.argv[1:], directory=Path(rest[0]) if rest else DATA)
