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


def jumps(codes: NDArray[np.int32], time: Floats, position: Sequence[Floats], geodetic: bool, max_speed: float) -> Mask:
    """Rows that would need more than ``max_speed`` (metres per second) both to be reached and to be left.

    The first row of an agent counts if it cannot be left but the next one can, the last one likewise, so that of an
    end and a wrong neighbour only the wrong one goes. Of two rows alone neither is known to be wrong.
    """
    first = starts(codes)
    into = np.zeros(len(time), dtype=bool)  # too fast from the row before

    def check(lo: int, hi: int) -> None:
        here = [p[lo + 1 : hi] for p in position]
        before = [p[lo : hi - 1] for p in position]
        distance = great_circle(*before, *here) if geodetic else np.hypot.reduce(np.subtract(here, before))
        into[lo + 1 : hi] = distance > max_speed * np.diff(time[lo:hi])

    in_chunks(check, len(time), overlap=1)
    into &= ~first
    last = np.append(first[1:], True)
    out = np.append(into[1:], False)
    return (into & out) | (first & out & ~_next(out) & ~_next(last)) | (last & into & ~_before(into) & ~_before(first))


def _next(mask: Mask) -> Mask:
    return np.append(mask[1:], True)


def _before(mask: Mask) -> Mask:
    return np.append(True, mask[:-1])


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
