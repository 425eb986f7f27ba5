"""The rules of docs/reading.md that compare rows with one another, on flat arrays sorted by agent and time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wakefold.base.types import Floats
from wakefold.tracks.projection import Projection

Mask = NDArray[np.bool_]
Codes = NDArray[np.int32]

FAR = 1000.0
"""Metres between two places of a ship at one time that are not both its own."""
LEAST = 3
"""Rows of a strand that is another body, and no jumps."""

THREADS = 2
CHUNK = 1 << 18
CENTRING_SAMPLE = 100_000
EARTH_RADIUS = 6_371_008.8
"""Mean radius, metres."""


def grouping(codes: NDArray[np.int32]) -> NDArray[np.integer]:
    """The stable order ``(n,)`` that brings equal codes together, codes ascending: a counting sort.

    scipy's conversion of a sparse matrix to compressed rows is one, three times as fast as numpy's stable sort.
    """
    from scipy.sparse import coo_array

    n = len(codes)
    index = np.arange(n, dtype=np.int32 if n < 2**31 else np.int64)
    matrix = coo_array((np.ones(n, dtype=np.int8), (codes, index)), shape=(int(codes.max()) + 1, n))
    return matrix.tocsr().indices


def starts(codes: NDArray[np.int32]) -> Mask:
    """``(n,)`` whether a row is the first of its agent; ``codes`` are grouped."""
    first = np.ones(len(codes), dtype=bool)
    first[1:] = codes[1:] != codes[:-1]
    return first


def sort_times(codes: NDArray[np.int32], time: Floats, order: NDArray[np.integer]) -> int:
    """Sort ``time`` and ``order`` in place inside each agent, stably; returns how many rows followed a later one.

    Only the rows of agents that are out of order are sorted: most files are nearly in order.
    """
    late = np.zeros(len(time), dtype=bool)
    late[1:] = (time[1:] < time[:-1]) & (codes[1:] == codes[:-1])
    if late.any():
        mixed = np.zeros(int(codes[-1]) + 1, dtype=bool)
        mixed[codes[late]] = True
        rows = np.flatnonzero(mixed[codes])
        rank = np.lexsort((time[rows], codes[rows]))
        order[rows] = order[rows[rank]]
        time[rows] = time[rows[rank]]
    return int(late.sum())


def repeated(codes: NDArray[np.int32], time: Floats, position: Sequence[Floats]) -> tuple[Mask, Mask]:
    """Rows at a time at which their agent already has a row: (at the same position as that first one, elsewhere)."""
    again = np.zeros(len(time), dtype=bool)
    again[1:] = (time[1:] == time[:-1]) & (codes[1:] == codes[:-1])
    duplicate = np.zeros(len(time), dtype=bool)
    rows = np.flatnonzero(again)
    if len(rows):
        # a run of repeated rows directly follows the first row of that agent and time
        run_starts = np.concatenate([[True], np.diff(rows) > 1])
        origin = (rows[run_starts] - 1)[np.cumsum(run_starts) - 1]
        duplicate[rows] = np.logical_and.reduce([p[rows] == p[origin] for p in position])
    return duplicate, again & ~duplicate


def far_apart(again: Mask, position: Sequence[Floats]) -> Mask:
    """Of rows marked as repeating the time of the row before, those ``FAR`` and more from the first of that time: they
    are of another body, and no second report of the same."""
    rows = np.flatnonzero(again)
    first = np.maximum.accumulate(np.where(again, 0, np.arange(len(again))))[rows]
    lon, lat = position
    out = np.zeros(len(again), dtype=bool)
    out[rows] = great_circle(lon[first], lat[first], lon[rows], lat[rows]) >= FAR
    return out


def fast_legs(codes: NDArray[np.int32], time: Floats, position: Sequence[Floats], geodetic: bool, limit: float) -> Mask:
    """``(n,)`` whether more than ``limit`` (metres per second) takes a row's agent there from its row before."""
    into = np.zeros(len(time), dtype=bool)

    def check(lo: int, hi: int) -> None:
        here = [p[lo + 1 : hi] for p in position]
        before = [p[lo : hi - 1] for p in position]
        reach = limit * np.diff(time[lo:hi])
        if not geodetic:
            into[lo + 1 : hi] = np.hypot.reduce(np.subtract(here, before)) > reach
            return
        # Never less than the distance: what is within reach by this needs no trigonometry, and most is.
        most = (np.abs(here[0] - before[0]) + np.abs(here[1] - before[1])) * (1.001 * EARTH_RADIUS * np.pi / 180)
        left = np.flatnonzero(most > reach)
        into[lo + 1 + left] = great_circle(*(p[left] for p in (*before, *here))) > reach[left]

    in_chunks(check, len(time), overlap=1)
    return into & ~starts(codes)


def bodies(codes: NDArray[np.int32], time: Floats, position: Sequence[Floats], geodetic: bool, limit: float) -> Codes:
    """``(n,)`` which body of its agent a row belongs to: 0 for the largest, 1, 2, ... for others, -1 for none (a jump).

    Rows of an agent are taken apart into strands within which no leg takes more than ``limit``, see
    ``kernels.strands``. The largest, the first of equals, is the agent; others of ``LEAST`` rows are other bodies of
    that name, or the same one after a leap; shorter ones are jumps.
    """
    body = np.zeros(len(time), dtype=np.int32)
    into = fast_legs(codes, time, position, geodetic, limit)
    if not into.any():
        return body
    from wakefold.io import kernels

    wrong = np.zeros(int(codes[-1]) + 1, dtype=bool)
    wrong[codes[into]] = True
    rows = np.flatnonzero(wrong[codes])
    some, strand = codes[rows], np.zeros(len(rows), dtype=np.int64)
    offsets = np.append(np.flatnonzero(starts(some)), len(rows))
    points = _in_space([p[rows] for p in position], geodetic)
    kernels.strands(time[rows], points, offsets, EARTH_RADIUS if geodetic else 0.0, limit, strand)
    # A key for each strand of each agent: where its agent's rows begin, and its number. Both below the number of rows.
    key = np.repeat(offsets[:-1], np.diff(offsets)) + strand
    sizes = np.bincount(key, minlength=len(rows))
    strands = np.flatnonzero(sizes)
    of = np.searchsorted(offsets, strands, side="right") - 1
    ranked = strands[np.lexsort((strands, -sizes[strands], of))]
    place = np.arange(len(ranked)) - np.searchsorted(of, np.arange(len(offsets) - 1))[of]  # ``of`` is rising
    named = np.where((place == 0) | (sizes[ranked] >= LEAST), place, -1)
    table = np.full(len(rows), -1, dtype=np.int32)
    table[ranked] = named
    body[rows] = table[key]
    return body


def _in_space(position: Sequence[Floats], geodetic: bool) -> Floats:
    """``(n, 3)`` places: on the sphere, or in a plane or space, the rest 0."""
    out = np.zeros((len(position[0]), 3))
    if geodetic:
        lon, lat = np.radians(position[0]), np.radians(position[1])
        out[:, 0], out[:, 1] = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon)
        out[:, 2] = np.sin(lat)
        return out * EARTH_RADIUS
    for axis, values in enumerate(position):
        out[:, axis] = values
    return out


def great_circle(lon0: Floats, lat0: Floats, lon1: Floats, lat1: Floats) -> Floats:
    """Metres between positions in degrees on a sphere (haversine; 0.5 % off the ellipsoid)."""
    lon0, lat0, lon1, lat1 = (np.radians(a) for a in (lon0, lat0, lon1, lat1))
    square = np.sin((lat1 - lat0) / 2) ** 2 + np.cos(lat0) * np.cos(lat1) * np.sin((lon1 - lon0) / 2) ** 2
    return 2 * EARTH_RADIUS * np.arcsin(np.sqrt(np.minimum(square, 1)))


def project(lon: Floats, lat: Floats) -> tuple[Floats, Projection]:
    """Positions in degrees as points ``(n, 2)`` of the local plane centred on them (on a sample of them, if many)."""
    sample = slice(None, None, -(-len(lon) // CENTRING_SAMPLE))
    projection = Projection.of(lon[sample], lat[sample])
    points = np.empty((len(lon), 2))

    def place(lo: int, hi: int) -> None:
        points[lo:hi] = projection.to_plane(lon[lo:hi], lat[lo:hi])

    in_chunks(place, len(lon))
    return points, projection


def taken(values: NDArray[Any], order: NDArray[np.integer]) -> NDArray[Any]:
    """``values[order]``, two pieces at a time."""
    out = np.empty(len(order), values.dtype)

    def take(lo: int, hi: int) -> None:
        np.take(values, order[lo:hi], out=out[lo:hi], mode="clip")  # "raise" would copy the piece once more

    in_chunks(take, len(order))
    return out


def in_chunks(work: Callable[[int, int], None], n: int, overlap: int = 0) -> None:
    """Call ``work(lo, hi)`` over 0..n in pieces, two at a time; neighbouring pieces share ``overlap`` rows."""
    pieces = [(max(lo - overlap, 0), min(lo + CHUNK, n)) for lo in range(0, n, CHUNK)]
    if len(pieces) == 1:
        work(*pieces[0])
        return
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(work, *zip(*pieces, strict=True)))
