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

from wakefold.base.compile import inner, kernel
from wakefold.model.kernels.simd import (
    fill,
    furthest_squared,
    higher,
    lanes_of,
    load,
    lower,
    point,
    squared_distance,
    store,
    times,
    within,
)

TILE = 4  # rows of the table carried through one sweep of the columns, so that each column is loaded a quarter as often
BELOW = 1 - 2.0**-20  # below a square by more than fused products can change it


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
        out: ``(>= rows * d * LANES,)`` flat batch, see ``wakefold.model.kernels.simd``.
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


@inner
def box_blocks(batch, rows, d, boxes):
    """Bounding boxes of the blocks of TILE points of a batch of ``rows`` points: a low and a high point each."""
    stride = d * lanes_of(batch)
    for block in range(rows // TILE):
        for k in range(stride):
            low = high = batch[block * TILE * stride + k]
            for row in range(block * TILE + 1, (block + 1) * TILE):
                low, high = min(low, batch[row * stride + k]), max(high, batch[row * stride + k])
            boxes[2 * block * stride + k], boxes[(2 * block + 1) * stride + k] = low, high


@inner
def farthest_pair(a, row, down, b, column, right, axes):
    """Largest squared distance of the pairs ``(row, column)``, and twice more, each so far further down and right."""
    worst = squared_distance(point(a, row, axes), point(b, column, axes))
    for k in range(1, TILE - 1):
        p, q = point(a, row + k * down, axes), point(b, column + k * right, axes)
        worst = higher(worst, squared_distance(p, q))
    return worst


@inner
def settled_lanes(a, a_boxes, rows, b, b_boxes, columns, table, axes):
    """Pairs of a batch whose Fréchet distance is that of their first or last points, as most are in distant pairs.

    It is at least that. Equal to it is enough if some coupling keeps below it in between. Looked for are couplings
    from block to block of TILE x TILE cells, a block costing the largest distance of its two boxes: a sixteenth of the
    programme. In the first block and the last they go along cells.

    Args:
        a, b: batches of ``rows`` and ``columns`` points, multiples of TILE, two blocks at least.
        a_boxes, b_boxes: of their blocks.
        table: ``(>= columns / TILE * LANES,)`` scratch; the squared distances of the pairs found are left in its
            first vector.
        axes: tuple of d integers.

    Returns:
        bit mask of these lanes.
    """
    never, nothing = fill(table, np.inf), fill(table, 0.0)
    one, none = np.intp(1), np.intp(0)  # literals would compile farthest_pair four times
    down, across = rows // TILE, columns // TILE
    first = squared_distance(point(a, 0, axes), point(b, 0, axes))
    last = squared_distance(point(a, rows - 1, axes), point(b, columns - 1, axes))
    ends = higher(first, last)
    limit = times(ends, fill(table, BELOW))
    for j in range(across):
        store(table, j, never)
    corner, left = nothing, never
    for i in range(down):
        low, high = point(a_boxes, 2 * i, axes), point(a_boxes, 2 * i + 1, axes)
        least = left = never
        for j in range(across if i < down - 1 else across - 1):
            above = load(table, j)
            cost = furthest_squared(low, high, point(b_boxes, 2 * j, axes), point(b_boxes, 2 * j + 1, axes))
            if i + j == 0:
                cost = farthest_pair(a, one, one, b, one, one, axes)
            cost = higher(cost, lower(lower(above, corner), left))
            store(table, j, cost)
            corner, left, least = above, cost, lower(least, cost)
        if i < down - 1:
            corner = never
            if within(least, nothing, limit) == 0:
                return 0
    from_above = higher(load(table, across - 1), farthest_pair(a, rows - TILE, one, b, columns - 1, none, axes))
    from_left = higher(left, farthest_pair(a, rows - 1, none, b, columns - TILE, one, axes))
    between = higher(corner, farthest_pair(a, rows - TILE, one, b, columns - TILE, one, axes))
    store(table, 0, ends)
    return within(lower(lower(from_above, from_left), between), nothing, limit)


@kernel
def pack_columns(points, offsets, columns, width, begin, out, boxes):
    """Pack tracks into batches of LANES neighbours in ``columns``; the last batch repeats its last track.

    Args:
        points, offsets: ragged tracks.
        columns: ``(n,)`` track of each column, batches of similar length if it is sorted by length.
        width: ``(batches,)`` points of the longest track of each batch.
        begin: ``(batches + 1,)`` first point of each batch in ``out``, counted in points of all lanes: each has its
            width, rounded up to whole blocks of TILE points.
        out: flat, ``(begin[-1] * d * LANES,)``.
        boxes: flat, ``(2 * begin[-1] / TILE * d * LANES,)``, the boxes of the blocks.
    """
    d = points.shape[1]
    lanes = lanes_of(out)
    for g in range(len(width)):
        batch, whole = out[begin[g] * d * lanes : begin[g + 1] * d * lanes], begin[g + 1] - begin[g]
        for lane in range(lanes):
            track = columns[min(g * lanes + lane, len(columns) - 1)]
            pack(points, offsets[track], offsets[track + 1], whole, batch, lane)
        box_blocks(batch, whole, d, boxes[2 * begin[g] // TILE * d * lanes :])


@kernel
def rows_against_columns(tracks, rows, skip, others, columns, packing, axes, mirror, out):
    """Fréchet distances of some tracks to packed columns, ``out[track, column's track]``.

    Args:
        tracks: points and offsets of the ragged tracks of the rows.
        rows: ``(r,)`` tracks.
        skip: ``(r,)`` leading columns each row does not need.
        others: the same of the columns, of the dtype of ``packed``.
        columns: ``(c,)`` tracks.
        packing: width, begin, packed, boxes, see ``pack_columns``.
        axes: tuple of d integers.
        mirror: write ``out[column's track, track]`` too.
        out: written where a row needs a column; distances, not squared.
    """
    (points, offsets), (other_points, other_offsets), (width, begin, packed, boxes) = tracks, others, packing
    d = points.shape[1]
    lanes = lanes_of(packed)
    tallest = longest(offsets, rows, np.intp(0), len(rows)) + TILE
    a, a_boxes = np.empty(tallest * d * lanes, packed.dtype), np.empty(2 * tallest // TILE * d * lanes, packed.dtype)
    widest = 0
    for each in width:
        widest = max(widest, each)
    table, b = np.empty(widest * lanes, packed.dtype), np.empty(widest * d * lanes, packed.dtype)
    rest = np.empty(len(columns), np.int64)
    for r in range(len(rows)):
        track = rows[r]
        height = (offsets[track + 1] - offsets[track] + TILE - 1) // TILE * TILE
        for lane in range(lanes):
            pack(points, offsets[track], offsets[track + 1], height, a, lane)
        box_blocks(a, height, d, a_boxes)
        left = 0
        for g in range(skip[r] // lanes, len(width)):
            batch, whole = packed[begin[g] * d * lanes : begin[g + 1] * d * lanes], begin[g + 1] - begin[g]
            settled, found = 0, 0
            if min(height, whole) > TILE:
                batch_boxes = boxes[2 * begin[g] // TILE * d * lanes :]
                settled = settled_lanes(a, a_boxes, height, batch, batch_boxes, whole, table, axes)
            if settled == 0:
                batch_squared(a, height, batch, width[g], table, axes)
                settled, found = -1, (width[g] - 1) * lanes
            for column in range(max(skip[r], g * lanes), min((g + 1) * lanes, len(columns))):
                lane = column - g * lanes
                if settled >> lane & 1:
                    out[track, columns[column]] = np.sqrt(table[found + lane])
                else:
                    rest[left] = column
                    left += 1
        # The pairs that were not settled, in batches of their own.
        for start in range(0, left, lanes):
            across = width[rest[start] // lanes]
            for lane in range(lanes):
                other = columns[rest[min(start + lane, left - 1)]]
                pack(other_points, other_offsets[other], other_offsets[other + 1], across, b, lane)
            batch_squared(a, height, b, across, table, axes)
            for k in range(start, min(start + lanes, left)):
                out[track, columns[rest[k]]] = np.sqrt(table[(across - 1) * lanes + k - start])
        if mirror:
            for k in range(skip[r], len(columns)):
                out[columns[k], track] = out[track, columns[k]]


@kernel
def pairs_of_tracks(points, offsets, first, others, other_offsets, second, axes, out):
    """Fréchet distances of listed pairs of tracks.

    Args:
        points, offsets: ragged tracks.
        first: ``(n,)`` one of them for each pair.
        others, other_offsets, second: the other track of each pair, likewise. No padding is wasted if neighbours in the
            list are of similar lengths.
        axes: tuple of d integers.
        out: ``(n,)`` distances.
    """
    d = points.shape[1]
    lanes = lanes_of(points)
    a = np.empty((longest(offsets, first, np.intp(0), len(first)) + TILE) * d * lanes, points.dtype)
    widest = longest(other_offsets, second, np.intp(0), len(second))
    b, table = np.empty(widest * d * lanes, points.dtype), np.empty(widest * lanes, points.dtype)
    for start in range(0, len(first), lanes):
        stop = min(start + lanes, len(first))
        rows = (longest(offsets, first, start, stop) + TILE - 1) // TILE * TILE
        columns = longest(other_offsets, second, start, stop)
        for lane in range(lanes):
            k = min(start + lane, stop - 1)
            pack(points, offsets[first[k]], offsets[first[k] + 1], rows, a, lane)
            pack(others, other_offsets[second[k]], other_offsets[second[k] + 1], columns, b, lane)
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
        pack(track, np.intp(0), len(track), rows, a, lane)
    widest = longest(offsets, others, np.intp(0), len(others))
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
