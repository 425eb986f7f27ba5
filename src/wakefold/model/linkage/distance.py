"""The discrete Fréchet distance between tracks.

The least over all couplings (walks along both tracks that never turn back) of the largest distance between the two
positions at one time; Eiter and Mannila, "Computing discrete Fréchet distance", TU Wien CD-TR 94/64, 1994. The times
of the tracks play no part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold.base.parallel import thread_map
from wakefold.base.types import Floats
from wakefold.tracks.tracks import Tracks

_CELLS = 1 << 28  # cells of the dynamic programme in one piece of work: some tens of milliseconds


def frechet(a: ArrayLike, b: ArrayLike) -> float:
    """Discrete Fréchet distance of two tracks, ``(n, d)`` and ``(m, d)`` positions (or ``(n,)`` for d = 1), metres.

    Raises:
        ValueError: an empty track, a position that is not finite, different dimensions, or a distance that overflows.
    """
    return float(frechet_matrix(Tracks.from_arrays([a], ids=["a"]), Tracks.from_arrays([b], ids=["b"]))[0, 0])


def frechet_matrix(
    tracks: Tracks | Sequence[ArrayLike],
    others: Tracks | Sequence[ArrayLike] | None = None,
    *,
    dtype: Literal["float64", "float32"] = "float64",
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> NDArray[np.floating]:
    """Discrete Fréchet distances of all pairs of tracks, metres.

    Args:
        tracks: M tracks, or one array of positions each.
        others: N tracks; the M tracks themselves if None.
        dtype: "float64" gives the bits of a plain float64 dynamic programme over ``sqrt(dx² + dy² + ...)``.
            "float32" is twice as fast; the error is at most ``2**-24 * (diagonal + 4 * distance)``, with the diagonal
            of the bounding box of all points (derived in docs/filtration.md).
        threads: all cores by default; the result does not depend on it.
        progress: called with the share of the work done, 0 to 1.

    Returns:
        ``(M, M)`` or ``(M, N)``.

    Raises:
        ValueError: an empty track or a position that is not finite (naming the track), different dimensions, or a
            distance that overflows.
    """
    from wakefold.model.kernels.simd import LANES
    from wakefold.model.linkage.kernels.frechet import TILE, pack_columns, rows_against_columns

    if dtype not in LANES:
        raise ValueError(f"dtype must be 'float64' or 'float32', got {dtype!r}")
    tracks = tracks if isinstance(tracks, Tracks) else Tracks.from_arrays(tracks)
    symmetric = others is None
    others = tracks if others is None else others if isinstance(others, Tracks) else Tracks.from_arrays(others)
    if tracks.dim != others.dim:
        raise ValueError(f"tracks of {tracks.dim} and {others.dim} coordinates have no distance")
    out = np.zeros((len(tracks), len(others)), dtype=dtype)
    if out.size == 0:
        return out
    (points, other_points), exponent = in_units([tracks.points, others.points], dtype)

    # Longest first: neighbours in a batch are of similar length, and each row meets only columns no longer than it.
    # Those equally long by place: what settles one distance of a batch is likely to settle the others.
    rows, columns = (np.lexsort((each.points[each.offsets[:-1], 0], -each.lengths)) for each in (tracks, others))
    skip = np.arange(1, len(rows) + 1) if symmetric else np.zeros(len(rows), dtype=np.int64)
    lanes = LANES[dtype]
    width = others.lengths[columns[::lanes]]
    begin = np.concatenate([[0], np.cumsum(-(-width // TILE) * TILE)])
    packed = np.empty(begin[-1] * tracks.dim * lanes, dtype=dtype)
    boxes = np.empty(2 * len(packed) // TILE, dtype=dtype)
    pack_columns(other_points, others.offsets, columns, width, begin, packed, boxes)

    cells = tracks.lengths[rows] * lanes * (begin[-1] - begin[np.minimum(skip // lanes, len(width))])
    piece = (np.cumsum(cells) - cells) // _CELLS
    pieces = np.split(np.arange(len(rows)), np.flatnonzero(np.diff(piece)) + 1)
    axes = (0,) * tracks.dim

    def work(piece: NDArray[np.int64]) -> None:
        of_rows, of_columns = (points, tracks.offsets), (other_points, others.offsets)
        packing = width, begin, packed, boxes
        rows_against_columns(of_rows, rows[piece], skip[piece], of_columns, columns, packing, axes, symmetric, out)

    thread_map(work, pieces, threads, progress)
    with np.errstate(over="ignore"):
        np.ldexp(out, exponent, out=out)
    if not np.isfinite(out).all():
        a, b = np.argwhere(~np.isfinite(out))[0]
        raise ValueError(f"tracks {str(tracks.ids[a])!r} and {str(others.ids[b])!r} are too far apart: overflow")
    return out


def distances_from(track: Tracks, tracks: Tracks, others: NDArray[np.int64]) -> Floats:
    """Discrete Fréchet distances ``(n,)`` of one track to some of the tracks, in the calling thread.

    Raises:
        ValueError: a distance that overflows.
    """
    from wakefold.model.linkage.kernels.frechet import pairs_of_tracks

    by = np.argsort(tracks.offsets[others + 1] - tracks.offsets[others], kind="stable")
    one, axes = np.zeros(len(others), dtype=np.int64), (0,) * tracks.dim
    found, out = np.empty(len(others)), np.empty(len(others))
    pairs_of_tracks(track.points, track.offsets, one, tracks.points, tracks.offsets, others[by], axes, found)
    out[by] = found
    if not np.isfinite(out).all():
        raise ValueError(f"track {str(tracks.ids[others[np.argmax(out)]])!r} is too far away: overflow")
    return out


def in_units(points: list[Floats], dtype: str) -> tuple[list[NDArray[np.floating]], int]:
    """Points as the kernel takes them, and the power of two its distances are to be multiplied by.

    float64: as given. float32: about the middle of the bounding box of all of them, in units of half its longest side
    rounded down to a power of two. Scaling is exact, squares cannot overflow, and rounding a coordinate costs a share
    of the size of the box, however far from the origin it lies.
    """
    if dtype == "float64":
        return list(points), 0
    low = np.min([each.min(axis=0) for each in points], axis=0)
    high = np.max([each.max(axis=0) for each in points], axis=0)
    middle = low / 2 + high / 2
    exponent = int(np.frexp((high / 2 - low / 2).max())[1]) - 1
    return [np.ldexp(each - middle, -exponent).astype(np.float32) for each in points], exponent
