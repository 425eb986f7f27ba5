"""The discrete Fréchet distance of many pairs at once, one pair per SIMD lane.

Eiter and Mannila (1994), Table 1: with d the distance of two points,

    c(i, j) = max(d(a_i, b_j), min(c(i-1, j), c(i, j-1), c(i-1, j-1))),    F = c(last, last)

The programme runs on squared distances and takes one root at the end. That changes no bit: the root is monotone and
correctly rounded, so it commutes with max and min, and F = sqrt(max of squares) = max of sqrt(squares).

Tracks of different length share the lanes of a batch: the shorter are padded with copies of their last point. That
changes no distance, since standing still at the end is what a coupling may do anyway.
"""

from __future__ import annotations

# The first parameter of an intrinsic is numba's typing context, which the caller does not give.
# pyright: reportCallIssue=false
import numpy as np

from wakefold.kernels.compile import inner, kernel
from wakefold.kernels.simd import LANES, fill, higher, load, lower, point, squared_distance, store

TILE = 4  # rows of the table carried through one sweep of the columns, so that each column is loaded a quarter as often
LANES32, LANES64 = LANES["float32"], LANES["float64"]


@inner
def lanes_of(array):
    """Lanes of a vector of the array's dtype."""
    return LANES32 if array.itemsize == 4 else LANES64


@kernel
def longest(offsets, tracks, start, stop):
    """Points of the longest of ``tracks[start:stop]``."""
    length = offsets[0]
    for k in range(start, stop):
        length = max(length, offsets[tracks[k] + 1] - offsets[tracks[k]])
    return length


@kernel
def pack(points, start, stop, rows, out, lane):
    """Write one track into a lane of a batch and pad it with its last point.

    Args:
        points: ``(P, d)`` of the batch's dtype; the track is rows ``start:stop``.
        rows: points the batch has, >= stop - start.
        out: ``(>= rows * d * LANES,)`` flat batch, see ``wakefold.kernels.simd``.
    """
    d = points.shape[1]
    lanes = lanes_of(out)
    for axis in range(d):
        for row in range(stop - start):
            out[(row * d + axis) * lanes + lane] = points[start + row, axis]
        for row in range(stop - start, rows):
            out[(row * d + axis) * lanes + lane] = points[stop - 1, axis]


@inner
def batch_squared(a, rows, b, columns, table, axes):
    """Squared Fréchet distances of one batch, left in ``table[(columns - 1) * LANES : columns * LANES]``.

    Args:
        a: batch of ``rows`` points, a multiple of TILE.
        b: batch of ``columns`` points.
        table: ``(>= columns * LANES,)`` scratch: the last row of the table computed so far.
        axes: tuple of d integers.
    """
    never = fill(table, np.inf)
    for j in range(columns):
        store(table, j, never)
    corner = fill(table, 0.0)  # c(-1, -1): a coupling starts at (0, 0) only
    for i in range(0, rows, TILE):
        a0, a1, a2, a3 = point(a, i, axes), point(a, i + 1, axes), point(a, i + 2, axes), point(a, i + 3, axes)
        left0 = left1 = left2 = left3 = never
        for j in range(columns):
            p = point(b, j, axes)
            above = load(table, j)
            # The neighbour that was finished last enters the minimum last, which keeps the chain of waits short.
            c0 = higher(squared_distance(a0, p), lower(above, lower(corner, left0)))
            c1 = higher(squared_distance(a1, p), lower(c0, lower(left0, left1)))
            c2 = higher(squared_distance(a2, p), lower(c1, lower(left1, left2)))
            c3 = higher(squared_distance(a3, p), lower(c2, lower(left2, left3)))
            store(table, j, c3)
            corner, left0, left1, left2, left3 = above, c0, c1, c2, c3
        corner = never


@kernel
def pack_columns(points, offsets, columns, width, begin, out):
    """Pack tracks into batches of LANES neighbours in ``columns``; the last batch repeats its last track.

    Args:
        points, offsets: ragged tracks.
        columns: ``(n,)`` track of each column, batches of similar length if it is sorted by length.
        width: ``(batches,)`` points of the longest track of each batch.
        begin: ``(batches + 1,)`` first point of each batch in ``out``, counted in points of all lanes.
        out: flat, ``(begin[-1] * d * LANES,)``.
    """
    d = points.shape[1]
    lanes = lanes_of(out)
    for g in range(len(width)):
        batch = out[begin[g] * d * lanes : begin[g + 1] * d * lanes]
        for lane in range(lanes):
            track = columns[min(g * lanes + lane, len(columns) - 1)]
            pack(points, offsets[track], offsets[track + 1], width[g], batch, lane)


@kernel
def rows_against_columns(points, offsets, rows, skip, columns, width, begin, packed, axes, mirror, out):
    """Fréchet distances of some tracks to packed columns, ``out[track, column's track]``.

    Args:
        points, offsets: ragged tracks of the rows.
        rows: ``(r,)`` tracks.
        skip: ``(r,)`` leading columns each row does not need.
        columns, width, begin, packed: see ``pack_columns``.
        axes: tuple of d integers.
        mirror: write ``out[column's track, track]`` too.
        out: written where a row needs a column; distances, not squared.
    """
    d = points.shape[1]
    lanes = lanes_of(packed)
    a = np.empty((longest(offsets, rows, 0, len(rows)) + TILE) * d * lanes, packed.dtype)
    widest = width[0]
    for each in width:
        widest = max(widest, each)
    table = np.empty(widest * lanes, packed.dtype)
    for r in range(len(rows)):
        track = rows[r]
        height = (offsets[track + 1] - offsets[track] + TILE - 1) // TILE * TILE
        for lane in range(lanes):
            pack(points, offsets[track], offsets[track + 1], height, a, lane)
        for g in range(skip[r] // lanes, len(width)):
            batch = packed[begin[g] * d * lanes : begin[g + 1] * d * lanes]
            batch_squared(a, height, batch, width[g], table, axes)
            for column in range(max(skip[r], g * lanes), min((g + 1) * lanes, len(columns))):
                distance = np.sqrt(table[(width[g] - 1) * lanes + column - g * lanes])
                out[track, columns[column]] = distance
                if mirror:
                    out[columns[column], track] = distance


@kernel
def pairs_of_tracks(points, offsets, first, second, axes, out):
    """Fréchet distances of listed pairs of tracks.

    Args:
        points, offsets: ragged tracks.
        first, second: ``(n,)`` tracks; no padding is wasted if neighbours in the list are of similar lengths.
        axes: tuple of d integers.
        out: ``(n,)`` distances.
    """
    d = points.shape[1]
    lanes = lanes_of(points)
    a = np.empty((longest(offsets, first, 0, len(first)) + TILE) * d * lanes, points.dtype)
    b = np.empty(longest(offsets, second, 0, len(second)) * d * lanes, points.dtype)
    table = np.empty(longest(offsets, second, 0, len(second)) * lanes, points.dtype)
    for start in range(0, len(first), lanes):
        stop = min(start + lanes, len(first))
        rows = (longest(offsets, first, start, stop) + TILE - 1) // TILE * TILE
        columns = longest(offsets, second, start, stop)
        for lane in range(lanes):
            k = min(start + lane, stop - 1)
            pack(points, offsets[first[k]], offsets[first[k] + 1], rows, a, lane)
            pack(points, offsets[second[k]], offsets[second[k] + 1], columns, b, lane)
        batch_squared(a, rows, b, columns, table, axes)
        for k in range(start, stop):
            out[k] = np.sqrt(table[(columns - 1) * lanes + k - start])


@kernel
def track_against_tracks(track, points, offsets, others, axes, out):
    """Fréchet distances of one track to listed others.

    Args:
        track: ``(n, d)`` points.
        points, offsets: ragged tracks.
        others: ``(m,)`` tracks; no padding is wasted if neighbours in the list are of similar lengths.
        axes: tuple of d integers.
        out: ``(m,)`` distances.
    """
    d = points.shape[1]
    lanes = lanes_of(points)
    rows = (len(track) + TILE - 1) // TILE * TILE
    a = np.empty(rows * d * lanes, points.dtype)
    for lane in range(lanes):
        pack(track, 0, len(track), rows, a, lane)
    widest = longest(offsets, others, 0, len(others))
    b, table = np.empty(widest * d * lanes, points.dtype), np.empty(widest * lanes, points.dtype)
    for start in range(0, len(others), lanes):
        stop = min(start + lanes, len(others))
        columns = longest(offsets, others, start, stop)
        for lane in range(lanes):
            other = others[min(start + lane, stop - 1)]
            pack(points, offsets[other], offsets[other + 1], columns, b, lane)
        batch_squared(a, rows, b, columns, table, axes)
        for k in range(start, stop):
            out[k] = np.sqrt(table[(columns - 1) * lanes + k - start])
