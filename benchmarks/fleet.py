"""A fleet in `wakefold track`: lines per CPU-second, latency, memory and starts of each filter, beside Stone Soup.

``python -m benchmarks.fleet`` in the environment of ``make bench``. The model is the New York week (the demo's voyages,
resampled at 200 m). The feed: up to 10,000 agents, each on a voyage of that week at a time of its own, seen once a
minute with an error of 20 m; every line is answered with the classes of three levels and forecasts at two horizons. A
filter that is too slow for all agents gets fewer, so that its run takes about ``SECONDS``. Everything from the bytes of
a line to the bytes of its answer counts, in one thread of a process of its own. Stone Soup's trackers (constant
velocity; a Kalman filter, or 200 particles) get the same feed by the same reader and projection, and predict at the
same horizons; they tell no classes.
"""

from __future__ import annotations

import argparse
import gc
import io
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime, timedelta
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter, process_time, sleep
from typing import Any, NamedTuple

import numpy as np

from wakefold.cli.followers import FILTERS, FilterName, crowd, follower
from wakefold.evidence.fix import on_plane
from wakefold.experiments.harbour import demo
from wakefold.model.model import Model, learn, load
from wakefold.service import answers, feed
from wakefold.service.remarks import Remarks
from wakefold.tracks.projection import Projection
from wakefold.tracks.tracks import Tracks

AGENTS, ROUNDS = 10_000, 5  # ships, and fixes of each
EVERY, ERROR = 60.0, 20.0  # seconds between two fixes of a ship, metres
BEGIN = 1_607_385_600.0  # 8 December 2020, seconds since 1970
HORIZONS = [300.0, 1800.0]  # seconds
SECONDS = 20.0  # of CPU that a filter may take
ENOUGH = 200  # agents: the memory of fewer is lost in that of the process
SETTINGS = {"particles": 200, "seed": 0, "depletion": 0.001}
SOUPS = {"Stone Soup, Kalman": 0, "Stone Soup, 200 particles": 200}  # particles
HEADER = b"agent,time,lon,lat\n"
PAGE = os.sysconf("SC_PAGE_SIZE")


class Row(NamedTuple):
    """What was measured of a filter: CPU seconds of all first lines and of all others; bytes that an agent takes."""

    agents: int
    starts: float
    steps: float
    memory: float


def fleet(week: Tracks, agents: int, rounds: int = ROUNDS, seed: int = 0) -> list[bytes]:
    """Lines of CSV without their header: ``rounds`` blocks, in each of which every agent has a line."""
    assert week.projection is not None
    rng = np.random.default_rng(seed)
    duration = week.duration
    long = np.flatnonzero(duration > EVERY * rounds)
    chosen = long[np.arange(agents) % len(long)]
    begin = rng.uniform(0.0, duration[chosen] - EVERY * rounds)  # into the voyage
    late = rng.uniform(0.0, EVERY, agents)
    blocks = []
    for k in range(rounds):
        at = np.empty((agents, 2))
        for a, voyage in enumerate(chosen):
            times = week.times_of(voyage)
            moment = times[0] + begin[a] + EVERY * k
            at[a] = [np.interp(moment, times, axis) for axis in week[voyage].T]
        lonlat = week.projection.to_geodetic(at + rng.normal(0.0, ERROR, at.shape))
        lines = []
        for a in np.argsort(late).tolist():
            now = datetime.fromtimestamp(BEGIN + EVERY * k + float(late[a]), UTC)
            stamp = now.isoformat(timespec="milliseconds")
            lines.append(f"SHIP {a:05},{stamp},{lonlat[a, 0]:.6f},{lonlat[a, 1]:.6f}\n")
        blocks.append("".join(lines).encode())
    return blocks


def resident() -> int:
    """Bytes of memory that this process holds (Linux)."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE


def crowd_of(name: FilterName, model: Model, levels: list[float]) -> Callable[[bytes], None]:
    """Takes a block of lines and answers them, into nowhere."""
    following = follower(name, model, {**SETTINGS, "levels": levels})
    live = crowd(following, levels, HORIZONS, AGENTS, 1e9, Remarks(_nothing))

    def work(block: bytes) -> None:
        for seen in feed.read(feed.blocks_of(io.BytesIO(HEADER + block))):
            for part in live(seen):
                for one in part:
                    assert not isinstance(one, feed.Refused), one.why
                    answers.csv_line(one.answer)

    return work


def _nothing(line: str) -> None:
    """Where remarks go."""


def measured(make: Callable[[], Callable[[bytes], None]], week: Tracks, most: int, seconds: float) -> Row:
    """Cost of a filter, on as many agents as it can take in so many seconds."""
    few = 20
    make_ready, probe = make(), fleet(week, few)
    for block in probe:
        make_ready(block)  # compiles
    work, begin = make(), process_time()
    for block in probe:
        work(block)
    agents = int(np.clip(seconds * few / max(process_time() - begin, 1e-6), few, most))
    del make_ready, work
    blocks = fleet(week, agents)
    work, before = make(), resident()
    begin = process_time()
    work(blocks[0])
    middle = process_time()
    for block in blocks[1:]:
        work(block)
    end = process_time()
    return Row(agents, middle - begin, end - middle, (resident() - before) / agents)


def latency(folder: Path, name: FilterName, week: Tracks, levels: list[float], lines: int) -> tuple[float, float]:
    """Milliseconds from a lone line into a pipe to its answer: median, and 99 % of them."""
    command = [sys.executable, "-m", "wakefold", "track", str(folder), "-", "--filter", name.value]
    command += ["--forecast", ",".join(f"{horizon}s" for horizon in HORIZONS)]
    command += ["--levels", ",".join(f"{level}m" for level in levels)] if levels else []
    given = HEADER + b"".join(fleet(week, max(lines // ROUNDS, 1)))
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        took = []
        header, *rest = given.splitlines(keepends=True)
        process.stdin.write(header)
        process.stdin.flush()
        process.stdout.readline()
        for line in rest:
            sleep(0.002)
            begin = perf_counter()
            process.stdin.write(line)
            process.stdin.flush()
            process.stdout.readline()
            took.append(perf_counter() - begin)
        process.stdin.close()
    took = took[len(took) // 10 :]  # the first ones compile
    return float(1e3 * np.median(took)), float(1e3 * np.quantile(took, 0.99))


def plain(projection: Projection) -> Callable[[bytes], None]:
    """Reading, projecting, projecting back and writing alone: with a filter that costs nothing."""
    place = answers.Place(("lon", "lat"), (-74.0123456, 40.6123456), 123.456)
    best = [answers.Best(level, 1717, 0.75, 40) for level in (300.0, 1000.0, 2500.0)]
    ahead = [(horizon, place) for horizon in HORIZONS]

    def work(block: bytes) -> None:
        for agent, stamp, _, at in seen_on(projection, block):
            answers.csv_line(answers.Answer(agent, stamp, "step", place, 88.8, 0, best, ahead))
            done.append(at)
        projection.to_geodetic(np.repeat(done, 1 + len(HORIZONS), axis=0))
        done.clear()

    done: list[Any] = []
    return work


def seen_on(projection: Projection, block: bytes) -> Iterator[tuple[str, str | float, float, Any]]:
    """Agent, time as written, time and place of each line."""
    for seen in feed.read(feed.blocks_of(io.BytesIO(HEADER + block))):
        good = [one for one in seen if isinstance(one, feed.Observation)]
        for one, fix in zip(good, on_plane([one.fix for one in good], projection, 2), strict=True):
            assert fix is not None
            yield one.agent, one.stamp, one.time, fix.position


def stone_soup(projection: Projection, particles: int) -> Callable[[bytes], None]:
    """A tracker of Stone Soup for each ship: Kalman, or so many particles."""
    from stonesoup.models.measurement.linear import LinearGaussian  # pyright: ignore[reportMissingImports]
    from stonesoup.models.transition.linear import (  # pyright: ignore[reportMissingImports]
        CombinedLinearGaussianTransitionModel,
        ConstantVelocity,
    )
    from stonesoup.predictor.kalman import KalmanPredictor  # pyright: ignore[reportMissingImports]
    from stonesoup.predictor.particle import ParticlePredictor  # pyright: ignore[reportMissingImports]
    from stonesoup.resampler.particle import SystematicResampler  # pyright: ignore[reportMissingImports]
    from stonesoup.types.array import StateVectors  # pyright: ignore[reportMissingImports]
    from stonesoup.types.detection import Detection  # pyright: ignore[reportMissingImports]
    from stonesoup.types.hypothesis import SingleHypothesis  # pyright: ignore[reportMissingImports]
    from stonesoup.types.numeric import Probability  # pyright: ignore[reportMissingImports]
    from stonesoup.types.state import GaussianState, ParticleState  # pyright: ignore[reportMissingImports]
    from stonesoup.updater.kalman import KalmanUpdater  # pyright: ignore[reportMissingImports]
    from stonesoup.updater.particle import ParticleUpdater  # pyright: ignore[reportMissingImports]

    rng = np.random.default_rng(0)
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.1), ConstantVelocity(0.1)])
    sight = LinearGaussian(ndim_state=4, mapping=(0, 2), noise_covar=np.eye(2) * ERROR**2)
    sd = np.array([ERROR, 5.0, ERROR, 5.0])[:, None]
    if particles:
        predictor, updater = ParticlePredictor(motion), ParticleUpdater(sight, resampler=SystematicResampler())
        weight = np.array([Probability(1 / particles)] * particles)
    else:
        predictor, updater, weight = KalmanPredictor(motion), KalmanUpdater(sight), None
    live: dict[str, Any] = {}

    def work(block: bytes) -> None:
        places = []
        lines: list[tuple[str, str | float]] = []
        for agent, stamp, time, at in seen_on(projection, block):
            clock, state = datetime.fromtimestamp(time, UTC), live.get(agent)
            if state is None:
                first = np.array([[at[0]], [0.0], [at[1]], [0.0]])
                if weight is None:
                    state = GaussianState(first, np.diag(sd[:, 0] ** 2), timestamp=clock)
                else:
                    cloud = StateVectors(first + sd * rng.normal(size=(4, particles)))
                    state = ParticleState(state_vector=cloud, weight=weight, timestamp=clock)
            else:
                seen = Detection(at[:, None], timestamp=clock, measurement_model=sight)
                state = updater.update(SingleHypothesis(predictor.predict(state, timestamp=clock), seen))
            live[agent] = state
            ahead = [predictor.predict(state, timestamp=clock + timedelta(seconds=h)) for h in HORIZONS]
            lines.append((agent, stamp))
            for one in (state, *ahead):
                mean, cov = one.mean, one.covar
                places.append((float(mean[0, 0]), float(mean[2, 0]), float(np.sqrt((cov[0, 0] + cov[2, 2]) / 2))))
        back = projection.to_geodetic(np.array(places)[:, :2]).tolist()
        spots = [answers.Place(("lon", "lat"), tuple(at), p[2]) for at, p in zip(back, places, strict=True)]
        each = 1 + len(HORIZONS)
        for k, (agent, stamp) in enumerate(lines):
            now, *later = spots[k * each : (k + 1) * each]
            ahead = list(zip(HORIZONS, later, strict=True))
            answers.csv_line(answers.Answer(agent, stamp, "step", now, 0.0, 0, [], ahead))

    return work


def line(name: str, row: Row, delay: tuple[float, float] | None = None) -> str:
    """Of the table."""
    per = row.agents * (ROUNDS - 1)
    start, step = 1e6 * row.starts / row.agents, 1e6 * row.steps / per
    rate = row.agents * ROUNDS / (row.starts + row.steps)
    waits = "|  |  |" if delay is None else f"| {delay[0]:.1f} | {delay[1]:.1f} |"
    room = f"{row.memory / 1000:.1f}" if row.agents >= ENOUGH else ""
    return f"| {name} | {row.agents:,} | {rate:,.0f} | {start:,.0f} | {step:,.0f} | {room} {waits}"


def contest(name: str, folder: Path, most: int, seconds: float) -> Row:
    """What is measured of a contestant, in a process of its own: memory that was freed would be used again."""
    week = demo.week()
    assert week.projection is not None
    projection = week.projection
    if name in SOUPS:
        return measured(lambda: stone_soup(projection, SOUPS[name]), week, most, seconds)
    if name not in FILTERS:
        return measured(lambda: plain(projection), week, most, seconds)
    model = load(folder)
    return measured(lambda: crowd_of(FilterName(name), model, levels_of(model, name)), week, most, seconds)


def levels_of(model: Model, name: str) -> list[float]:
    """The three levels that are told, none with a filter that tells no classes."""
    return model.filtration.levels(3).tolist() if "levels" in FILTERS[FilterName(name)].reads else []


def main(quick: bool = False) -> None:
    """Print the table; ``quick`` takes fewer agents."""
    most, seconds, lone = (500, 1.0, 100) if quick else (AGENTS, SECONDS, 500)
    week = demo.week()
    model = learn(week.resample(spacing=demo.SPACING))
    names = ["reading and writing alone", *FILTERS, *(SOUPS if find_spec("stonesoup") else ())]
    print("| filter | agents | lines a CPU-second | µs a start | µs a step | kB an agent | lone line, ms, p50 | p99 |")
    print("|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "week.model"
        model.save(folder)
        for name in names:
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as other:
                row = other.submit(contest, str(name), folder, most, seconds).result()
            delay = None
            if name in FILTERS:
                slow = row.steps / row.agents / (ROUNDS - 1) > 0.02
                own = levels_of(model, name)
                delay = latency(folder, FilterName(name), week, own, 50 if slow else lone)
            print(line(name, row, delay), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
