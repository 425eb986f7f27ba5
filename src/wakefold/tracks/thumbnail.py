"""A small picture of tracks as SVG text, for notebooks: no drawing library is needed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_MOST_TRACKS, _MOST_POINTS = 300, 60  # a sketch stays under about 200 kB


def sketch(points: NDArray[np.float64], offsets: NDArray[np.int64], width: int = 320, height: int = 220) -> str:
    """An ``<svg>`` of tracks ``points[offsets[i]:offsets[i + 1]]``, in true proportions, y upwards.

    Of more than 300 tracks every k-th is drawn, and of a long track every k-th point.
    """
    if not len(points):
        return ""
    plane = np.zeros((len(points), 2))
    plane[:, : min(2, points.shape[1])] = points[:, :2]
    low, high = plane.min(axis=0), plane.max(axis=0)
    margin = 6.0
    extent = np.maximum(high - low, 1e-300)
    scale = min((width - 2 * margin) / extent[0], (height - 2 * margin) / extent[1])
    middle = np.array([width, height]) / 2
    pixels = (plane - (low + high) / 2) * scale * [1, -1] + middle
    lines = []
    for i in range(0, len(offsets) - 1, -(-(len(offsets) - 1) // _MOST_TRACKS)):
        track = pixels[offsets[i] : offsets[i + 1]]
        rows = np.unique(np.linspace(0, len(track) - 1, min(len(track), _MOST_POINTS)).round().astype(int))
        lines.append(f'<polyline points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in track[rows])}"/>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}">'
        '<g fill="none" stroke="#0072b2" stroke-opacity="0.35" stroke-width="1" stroke-linecap="round">'
        f"{''.join(lines)}</g></svg>"
    )
