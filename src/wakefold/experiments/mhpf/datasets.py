"""Seeded generators of data sets like the papers' (Hawasly et al. 2016, Sections 2 and 4), which were never released.

The first three live in the unit square, with points evenly spaced, one second apart: "uniformly discretised"
(Section 4). The tanker set is walks over a raster of traffic density, here synthetic or counted from AIS.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold.base.types import Floats
from wakefold.tracks.tracks import Tracks

__all__ = [
    "Raster",
    "common_ends",
    "configuration_space",
    "density_of",
    "junction",
    "tanker_traffic",
    "traffic_of",
    "walks",
]

SPACING = 0.02  # of the points of the first three sets
# Centre x, y and radius of the obstacles of the configuration space.
OBSTACLES = np.array(
    [[0.26, 0.70, 0.13], [0.57, 0.42, 0.14], [0.80, 0.76, 0.11], [0.24, 0.24, 0.10], [0.86, 0.22, 0.07]]
)


def junction(seed: int = 0) -> Tracks:
    """14 walks through a Y-junction, after Figure 1 of the 2016 paper, in the unit square.

    Five go up the stem and left, five right, two come down from the left, two cross from arm to arm.
    """
    rng = np.random.default_rng(seed)
    foot, fork, left, right = (0.5, 0.06), (0.5, 0.5), (0.08, 0.95), (0.92, 0.93)
    routes = [(foot, fork, left)] * 5 + [(foot, fork, right)] * 5 + [(left, fork, foot)] * 2 + [(left, fork, right)] * 2
    out = []
    for route in routes:
        a, b, c = np.array(route) + rng.normal(0.0, 0.018, size=(3, 2))
        s = np.linspace(0.0, 1.0, 200)[:, None]
        out.append((1 - s) ** 2 * a + 2 * s * (1 - s) * b + s**2 * c + _wobble(rng, 200, 0.008))
    return _tracks(out, SPACING)


def common_ends(seed: int = 0) -> Tracks:
    """13 tracks with a common start and a common end, after Figure 5 (right), in the unit square.

    Four families of three, two of them above and two below, and one straight track between them.
    """
    rng = np.random.default_rng(seed)
    # Amplitudes of the first three sine waves across the way from start to end, per family.
    families = [(0.42, 0.0, 0.06), (0.20, 0.12, 0.0), (-0.20, 0.10, 0.0), (-0.42, 0.0, -0.05), (0.0, 0.0, 0.0)]
    out = []
    for family, size in zip(families, (3, 3, 3, 3, 1), strict=True):
        for _ in range(size):
            amplitude = np.array(family) + rng.normal(0.0, [0.025, 0.02, 0.012])
            s = np.linspace(0.0, 1.0, 400)
            across = sum(a * np.sin((k + 1) * np.pi * s) for k, a in enumerate(amplitude))
            wobble = _wobble(rng, 400, 0.006) * np.sin(np.pi * s)[:, None]  # none at the ends, which are common
            out.append(np.stack([0.05 + 0.9 * s, 0.5 + across], axis=1) + wobble)
    return _tracks(out, SPACING)


def configuration_space(seed: int = 0, number: int = 33) -> Tracks:
    """Ways around the five ``OBSTACLES`` between general starts and goals, after Figure 5 (left), in the unit square.

    Each is the cheapest way over a grid whose cost is a smooth random field, dear near obstacles, so that ways between
    the same places differ. Two thirds go between eight regions along the border, so that there are classes to find;
    the others between any two free places at least half the square apart.
    """
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(seed)
    cells = 56
    centre = (np.arange(cells) + 0.5) / cells
    grid = np.stack(np.meshgrid(centre, centre, indexing="ij"), axis=-1)
    clearance = _clearance(grid.reshape(-1, 2)).reshape(cells, cells)
    regions = np.array(
        [[0.08, 0.1], [0.5, 0.08], [0.93, 0.08], [0.94, 0.5], [0.93, 0.94], [0.5, 0.93], [0.07, 0.93], [0.06, 0.48]]
    )
    journeys = [(0, 4), (0, 5), (1, 6), (2, 6), (3, 7), (0, 3), (6, 3), (1, 5)]
    out: list[Floats] = []
    while len(out) < number:
        k = len(out)
        if k % 3 < 2:
            ends = regions[list(journeys[(k // 3) % len(journeys)])] + rng.normal(0.0, 0.02, size=(2, 2))
        else:
            ends = rng.uniform(0.05, 0.95, size=(2, 2))
        if np.linalg.norm(ends[1] - ends[0]) < 0.5 or (_clearance(ends) < 0.03).any():
            continue
        field = gaussian_filter(rng.normal(size=(cells, cells)), 5.0)
        cost = np.exp(0.35 * field / field.std()) * (1.0 + np.exp(-clearance / 0.03))
        cost[clearance < 0.01] = np.inf
        way = centre[_cheapest_way(cost, *np.clip((ends * cells).astype(int), 0, cells - 1))]
        way[[0, -1]] = ends
        smooth = gaussian_filter(_evenly(way, 0.005), 9.0, axes=(0,), mode="nearest")
        smooth[[0, -1]] = ends
        out.append(smooth)
    return _tracks(out, SPACING)


class Raster(NamedTuple):
    """Traffic density over a rectangle.

    Attributes:
        density: ``(rows, columns)``, the first row lowest; its largest value is 1.
        origin: ``(2,)`` lower left corner.
        cell: side of a cell, in plane units.
    """

    density: Floats
    origin: Floats
    cell: float

    def centre(self, cells: ArrayLike) -> Floats:
        """Positions ``(n, 2)`` of the centres of cells ``(n, 2)`` (row, column)."""
        return self.origin + self.cell * (np.asarray(cells)[..., ::-1] + 0.5)


def density_of(points: ArrayLike, offsets: ArrayLike, box: Sequence[float], rows: int = 96) -> Raster:
    """Traffic density: how many tracks pass through each cell, smoothed over one cell, on a logarithmic scale.

    Args:
        points: ``(P, 2)`` positions of all tracks, one after the other; neighbours are joined by straight lines.
        offsets: ``(M + 1,)`` first point of each track.
        box: x0, y0, x1, y1 of the rectangle.
        rows: of square cells over the height of the rectangle.
    """
    from scipy.ndimage import gaussian_filter

    points, offsets = np.asarray(points, dtype=np.float64), np.asarray(offsets, dtype=np.int64)
    x0, y0, x1, y1 = box
    cell = (y1 - y0) / rows
    columns = max(1, round((x1 - x0) / cell))
    passing = np.zeros(rows * columns)
    for first, last in pairwise(offsets):
        way = _evenly(points[first:last], 0.5 * cell)
        place = np.floor((way - [x0, y0]) / cell).astype(int)
        inside = (place >= 0).all(axis=1) & (place[:, 0] < columns) & (place[:, 1] < rows)
        passing[np.unique(place[inside, 1] * columns + place[inside, 0])] += 1
    density = np.log1p(gaussian_filter(passing.reshape(rows, columns), 0.7))
    return Raster(density / (density.max() or 1.0), np.array([x0, y0]), cell)


def tanker_traffic(seed: int = 0) -> tuple[Raster, Floats]:
    """A synthetic raster of tanker traffic in a gulf and the places walks start from, after Figure 8.

    Six ports along a northern coast and three ways to the open sea in the south are joined by lanes of differing use;
    some traffic strays. The raster is counted, as from AIS, from 1,500 ships on these lanes, 96 x 144 cells of side 5.

    Returns:
        the raster, and start cells ``(9, 2)`` (row, column).
    """
    rng = np.random.default_rng(seed)
    width, height = 720.0, 480.0
    ports = np.array([[30, 300], [110, 400], [215, 440], [330, 430], [450, 445], [570, 400], [690, 330]], dtype=float)
    sea = np.array([[90, 12], [400, 12], [700, 60]], dtype=float)
    bends = rng.uniform([120, 150], [620, 330], size=(len(ports), len(sea), 2))
    use = rng.gamma(0.8, size=(len(ports), len(sea))) + 0.05
    use /= use.sum()
    ships, offsets = [], [0]
    for lane in rng.choice(use.size, size=1500, p=use.ravel()):
        p, s = divmod(int(lane), len(sea))
        bend = 0.5 * (0.5 * (ports[p] + sea[s]) + bends[p, s])
        t = np.linspace(0.0, 1.0, 60)[:, None]
        way = (1 - t) ** 2 * ports[p] + 2 * t * (1 - t) * bend + t**2 * sea[s]
        ships.append(way + _wobble(rng, 60, 6.0 if rng.random() < 0.85 else 25.0))
        offsets.append(offsets[-1] + len(way))
    raster = density_of(np.concatenate(ships), offsets, (0.0, 0.0, width, height))
    starts = np.floor(np.concatenate([ports, sea])[:, ::-1] / raster.cell).astype(int)
    return raster, starts


def traffic_of(tracks: Tracks, rows: int = 96, starts: int = 9) -> tuple[Raster, Floats]:
    """The raster of the traffic of real tracks, such as AIS, and busy places for walks to start from.

    The rectangle holds the middle 99 % of the points along each axis. A track is cut where nothing was received for
    two hours. Starts are the densest cells, each at least an eighth of the rows from the others and off the edge.

    Args:
        rows: of square cells over the height of the rectangle.
        starts: how many start cells.

    Returns:
        the raster, and start cells ``(starts, 2)`` (row, column), the densest first.

    Raises:
        ValueError: the tracks do not cover a rectangle, or have not so many places with traffic.
    """
    pieces = tracks.segment(max_gap=7200.0)
    points = pieces.points[:, :2]
    low, high = np.quantile(points, [0.005, 0.995], axis=0)
    if not (high > low).all():
        raise ValueError(f"the tracks ({len(tracks)}, {len(points)} points) do not cover a rectangle")
    raster = density_of(points, pieces.offsets, (*low.tolist(), *high.tolist()), rows)
    left = raster.density.copy()
    left[[0, -1]] = left[:, [0, -1]] = 0.0
    row, column = np.indices(left.shape)
    cells: list[tuple[int, int]] = []
    while len(cells) < starts:
        at = np.unravel_index(int(left.argmax()), left.shape)
        if left[at] == 0.0:
            raise ValueError(f"only {len(cells)} of {starts} places with traffic, {rows // 8} cells apart")
        cells.append((int(at[0]), int(at[1])))
        left[np.hypot(row - at[0], column - at[1]) < rows / 8] = 0.0
    return raster, np.array(cells)


def walks(
    raster: Raster, starts: ArrayLike, number: int = 194, seed: int = 0, *, straight: float = 8.0, shortest: int = 40
) -> Tracks:
    """Random walks that prefer denser cells and seldom turn (Section 4.2), smoothed, two cells between points.

    From cell to one of its eight neighbours with probability proportional to the fourth power of the (logarithmic)
    density there times exp(``straight`` cos(turn)), the turn away from the heading over the last eight or so moves. A
    walk ends at the edge, where there is no traffic, on coming back to a cell it has been in, or after twice as many
    cells as the raster has rows.

    Args:
        raster: see ``density_of`` and ``tanker_traffic``.
        starts: ``(S, 2)`` cells (row, column) to start from, in turn.
        number: of walks.
        straight: how much walks dislike to turn.
        shortest: cells; shorter walks are drawn again.

    Raises:
        ValueError: from these starts no walk of that length is found.
    """
    from scipy.ndimage import gaussian_filter1d

    rng = np.random.default_rng(seed)
    rows, columns = raster.density.shape
    begins = np.asarray(starts, dtype=np.int64)
    moves = np.array([[0, 1], [1, 1], [1, 0], [1, -1], [0, -1], [-1, -1], [-1, 0], [-1, 1]])
    ways = moves / np.linalg.norm(moves, axis=1)[:, None]
    weight = np.zeros((rows, columns))
    weight[1:-1, 1:-1] = np.where(raster.density < 0.1, 0.0, raster.density**4)[1:-1, 1:-1]
    out: list[Floats] = []
    tries = 0
    while len(out) < number:
        tries += 1
        if tries > 200 * number:
            raise ValueError(f"no walk of {shortest} cells found from {len(begins)} starts")
        here, heading, been = begins[len(out) % len(begins)], np.zeros(2), []
        seen: set[tuple[int, int]] = set()
        while len(been) < 2 * rows and (place := (int(here[0]), int(here[1]))) not in seen:
            seen.add(place)
            been.append(here)
            there = np.clip(here + moves, 0, [rows - 1, columns - 1])
            size = np.linalg.norm(heading)
            p = weight[there[:, 0], there[:, 1]] * np.exp(straight * (ways @ (heading / size) - 1.0 if size else 0.0))
            if p.sum() == 0.0:
                break
            move = min(7, int(np.searchsorted(np.cumsum(p), rng.random() * p.sum(), side="right")))
            heading = 0.875 * heading + ways[move]
            here = here + moves[move]
        if len(been) >= shortest:
            out.append(gaussian_filter1d(raster.centre(been), 2.0, axis=0, mode="nearest"))
    return _tracks(out, 2.0 * raster.cell)


def _tracks(ways: Sequence[Floats], spacing: float) -> Tracks:
    return Tracks.from_arrays([_evenly(way, spacing) for way in ways])


def _evenly(way: Floats, spacing: float) -> Floats:
    """Points along a polyline, evenly apart, as near to ``spacing`` as both ends allow."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], max(2, round(along[-1] / spacing) + 1))
    return np.stack([np.interp(at, along, column) for column in way.T], axis=1)


def _wobble(rng: np.random.Generator, count: int, size: float) -> Floats:
    """A smooth random deviation ``(count, 2)`` of about this size, as of a hand that draws."""
    from scipy.ndimage import gaussian_filter1d

    noise = gaussian_filter1d(rng.normal(size=(count, 2)), count / 10, axis=0, mode="wrap")
    return size * noise / noise.std()


def _clearance(points: Floats) -> Floats:
    """Distance of points (n, 2) from the nearest obstacle, negative inside one."""
    away = np.linalg.norm(points[:, None] - OBSTACLES[:, :2], axis=2) - OBSTACLES[:, 2]
    return away.min(axis=1)


def _cheapest_way(cost: Floats, start: NDArray[np.int64], goal: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cells (n, 2) of the cheapest way over a grid (8 neighbours, mean cost of the two cells times their distance)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    rows, columns = cost.shape
    number = np.arange(cost.size).reshape(cost.shape)
    tails, heads, prices = [], [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = (slice(0, rows - dy), slice(max(0, -dx), columns - max(0, dx)))
        there = (slice(dy, rows), slice(max(0, dx), columns + min(0, dx)))
        price = 0.5 * (cost[here] + cost[there]) * np.hypot(dy, dx)
        free = np.isfinite(price)
        tails.append(number[here][free])
        heads.append(number[there][free])
        prices.append(price[free])
    graph = coo_array((np.concatenate(prices), (np.concatenate(tails), np.concatenate(heads))), shape=(cost.size,) * 2)
    first, last = int(number[tuple(start)]), int(number[tuple(goal)])
    _, before = dijkstra(graph.tocsr(), directed=False, indices=first, return_predecessors=True)
    way = [last]
    while way[-1] != first:
        way.append(int(before[way[-1]]))
    return np.array(np.unravel_index(way[::-1], cost.shape)).T
