"""The discrete Fréchet distance between tracks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wakefold.kernels.frechet import rows_plain
from wakefold.parallel import thread_map
from wakefold.tracks import Floats, Tracks


def frechet_condensed(
    tracks: Tracks, threads: int | None = None, progress: Callable[[float], None] | None = None
) -> Floats:
    m = len(tracks)
    out = np.empty(m * (m - 1) // 2)
    thread_map(lambda i: rows_plain(tracks.points, tracks.offsets, i, i + 1, out), range(m), threads, progress)
    return out


def frechet_matrix(tracks: Tracks, threads: int | None = None) -> Floats:
    from scipy.spatial.distance import squareform

    return squareform(frechet_condensed(tracks, threads)) if len(tracks) > 1 else np.zeros((1, 1))
