"""What the pictures share: style, size, tracks as lines, and the ground: graticule or plain axes, scale, coastline."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any, ParamSpec, cast

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from wakefold.base import wording
from wakefold.base.types import Floats
from wakefold.base.wording import number_text
from wakefold.tracks.projection import Projection
from wakefold.tracks.tracks import Tracks

P = ParamSpec("P")
Box = tuple[float, float, float, float]  # x0, y0, x1, y1, metres

INK, PALE, BACKDROP = "#22303c", "#9aa5ad", "#e3e7ea"
SEA, LAND, SHORE = "#ffffff", "#f1eee6", "#b9b09c"
SMALL, SINGLE = "#6b7780", "#c4cbd0"  # classes without a colour of their own, and single tracks
# Paul Tol's "muted" scheme: nine colours that stay apart in the common forms of colour blindness.
PALETTE = ("#332288", "#cc6677", "#117733", "#ddcc77", "#88ccee", "#882255", "#44aa99", "#999933", "#aa4499")
STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same picture everywhere
    "font.size": 8.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": PALE,
    "axes.linewidth": 0.6,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "xtick.major.width": 0.5,
    "ytick.major.width": 0.5,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "legend.frameon": False,
    "legend.fontsize": 7.0,
    "figure.facecolor": "white",
    "figure.dpi": 110.0,
    "savefig.dpi": 180.0,
    "svg.hashsalt": "wakefold",  # the same ids in every run
}

_LARGEST_COASTLINE = 256 << 20  # bytes; a file is read whole
_FAR = 10_000_000.0  # m; polygons reaching farther from the centre may enclose its antipode and are not filled


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    @wraps(draw)
    def styled(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with rc_context(cast(Any, STYLE)):
            return draw(*args, **kwargs)

    return styled


def ground(
    ax: Axes, box: Box, projection: Projection | None = None, coastline: str | Path | None = None, labels: bool = True
) -> None:
    """Set up axes in plane coordinates over ``box``, in true proportions.

    Args:
        ax: empty axes.
        box: what must be seen.
        projection: draws meridians and parallels, labelled where they meet the frame, and a scale bar; without it
            plain axes in plane units.
        coastline: a GeoJSON file (RFC 7946) of lines or polygons, degrees. Polygons are filled as land, their holes
            (lakes) outlined.
        labels: whether to label the frame and draw the scale bar.
    """
    x0, y0, x1, y1 = box
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlim(x0, x1)
    ax.set_ylim(y0, y1)
    ax.set_facecolor(SEA)
    if projection is None:
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(MaxNLocator(5))
            axis.set_tick_params(labelbottom=labels, labelleft=labels, length=2.5 if labels else 0)
        return
    if coastline is not None:
        _draw_coastline(ax, projection, Path(coastline))
    _draw_graticule(ax, box, projection, labels)
    if labels:
        length = _round_number((x1 - x0) / 4)
        right, low = x1 - 0.04 * (x1 - x0), y0 + 0.04 * (y1 - y0)
        ax.plot([right - length, right], [low, low], color=INK, linewidth=1.5, solid_capstyle="butt", zorder=6)
        ax.annotate(
            length_text(length, projection),
            (right - length / 2, low),
            (0, 3),
            textcoords="offset points",
            ha="center",
            size=7,
        )


def length_text(length: float, projection: Projection | None) -> str:
    """A length for people; a bare number in the plane's own units without a projection."""
    return number_text(length) if projection is None else wording.length_text(length)


def lines_of(tracks: Tracks, box: Box, pixels: int = 3000) -> list[Floats]:
    """Every track as a line ``(n, 2)`` for a picture of ``box``, without the points that no one could see."""
    x0, y0, x1, y1 = box
    return [p[:, :2] for p in tracks.simplify(max(x1 - x0, y1 - y0) / pixels)]


def draw_lines(ax: Axes, lines: Sequence[Floats], **look: Any) -> None:
    ax.add_collection(LineCollection(list(lines), **look), autolim=False)


def box_around(points: ArrayLike, margin: float = 0.03, slimmest: float = 0.3) -> Box:
    """What shows all points, with a margin, widened until the shorter side is at least ``slimmest`` of the longer."""
    places = np.asarray(points, dtype=np.float64)
    if not len(places):
        raise ValueError("there is nothing to draw")
    if places.shape[1] < 2:
        raise ValueError("a picture needs two coordinates, these tracks have one")
    low, high = places[:, :2].min(axis=0), places[:, :2].max(axis=0)
    longest = float((high - low).max()) or 1.0
    half = np.maximum((high - low) / 2, longest * slimmest / 2) + longest * margin
    middle = (low + high) / 2
    return (*(middle - half).tolist(), *(middle + half).tolist())


def size_of(box: Box, longest: float, room: tuple[float, float] = (0.0, 0.0)) -> tuple[float, float]:
    """Width and height in inches: the longer side of ``box`` takes ``longest``, the labels around it ``room``."""
    scale = longest / max(box[2] - box[0], box[3] - box[1])
    return (box[2] - box[0]) * scale + room[0], (box[3] - box[1]) * scale + room[1]


def legend_below(figure: Figure, handles: Sequence[Artist], columns: int, **look: Any) -> None:
    """A legend under the axes: in so many columns, or in fewer if the figure is too narrow for them."""
    for count in range(min(columns, len(handles)), 0, -1):
        legend = figure.legend(handles=handles, loc="outside lower center", ncols=count, **look)
        if count == 1 or legend.get_window_extent().width <= 0.98 * figure.bbox.width:
            return
        legend.remove()


def _round_number(most: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is at most ``most``."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(k * power for k in (1, 2, 5) if k * power <= most * (1 + 1e-9)))


def _draw_graticule(ax: Axes, box: Box, projection: Projection, labels: bool) -> None:
    x0, y0, x1, y1 = box
    grid = np.stack(np.meshgrid(np.linspace(x0, x1, 25), np.linspace(y0, y1, 25)), axis=-1).reshape(-1, 2)
    lon, lat = projection.to_geodetic(grid).T
    # Longitudes relative to the centre, so that the antimeridian is no seam.
    relative = (lon - projection.lon + 180) % 360 - 180
    west, east, south, north = relative.min(), relative.max(), lat.min(), lat.max()
    for pole in (-90.0, 90.0):
        x, y = projection.to_plane(projection.lon, pole)[0]
        if x0 <= x <= x1 and y0 <= y <= y1:
            west, east, south, north = -180.0, 179.999, min(south, pole), max(north, pole)
    west, east = west + projection.lon, east + projection.lon
    meridian_step = min(_round_number((east - west) / 2.5), 30.0)
    parallel_step = min(_round_number((north - south) / 2.5), 30.0)
    # Lines reach a little beyond the frame, as its extreme latitude may lie between two points of the grid.
    up = np.linspace(max(south - 0.05 * (north - south), -90), min(north + 0.05 * (north - south), 90), 201)
    along = np.linspace(west - 0.05 * (east - west), east + 0.05 * (east - west), 401)
    lines, bottom, left = [], [], []
    for value in _multiples(west, east, meridian_step):
        lines.append(projection.to_plane(np.full(len(up), value), up))
        name = _degrees(value, meridian_step, "EW")
        bottom += [(at, name) for at in _crossings(lines[-1][:, ::-1], y0, x0, x1)]
    for value in _multiples(south, north, parallel_step):
        lines.append(projection.to_plane(along, np.full(len(along), value)))
        name = _degrees(value, parallel_step, "NS")
        left += [(at, name) for at in _crossings(lines[-1], x0, y0, y1)]
    ax.add_collection(LineCollection(lines, colors=PALE, linewidths=0.3, alpha=0.5, zorder=0.5), autolim=False)
    for axis, marks in ((ax.xaxis, bottom), (ax.yaxis, left)):
        axis.set_ticks([at for at, _ in marks] if labels else [], labels=[name for _, name in marks] if labels else [])


def _multiples(low: float, high: float, step: float) -> Floats:
    return np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step


def _crossings(line: Floats, edge: float, low: float, high: float) -> list[float]:
    """Where a line (n, 2) crosses its first coordinate = edge, as values of the second, within low..high."""
    side = line[:, 0] - edge
    k = np.flatnonzero(side[:-1] * side[1:] < 0)
    share = side[k] / (side[k] - side[k + 1])
    at = line[k, 1] + share * (line[k + 1, 1] - line[k, 1])
    return at[(low <= at) & (at <= high)].tolist()


def _degrees(value: float, step: float, sides: str) -> str:
    value = (value + 180) % 360 - 180 if sides == "EW" else value
    decimals = max(0, int(np.ceil(-np.log10(step) - 1e-9)))
    side = "" if round(abs(value), decimals) in (0, 180) and sides == "EW" else sides[0] if value >= 0 else sides[1]
    return f"{abs(value):.{decimals}f}°{side}"


def _draw_coastline(ax: Axes, projection: Projection, path: Path) -> None:
    lines, areas = _read_coastline(path, path.stat().st_mtime_ns, projection)
    ax.add_collection(PolyCollection(areas, facecolors=LAND, edgecolors="none", zorder=0.2), autolim=False)
    ax.add_collection(LineCollection(lines, colors=SHORE, linewidths=0.5, zorder=0.3), autolim=False)


@lru_cache(maxsize=1)  # a figure of many panels reads its file once, an edited file is read again
def _read_coastline(path: Path, modified: int, projection: Projection) -> tuple[list[Floats], list[Floats]]:
    """All lines, and those that bound land, metres."""
    if path.stat().st_size > _LARGEST_COASTLINE:
        raise ValueError(f"{path} is larger than {_LARGEST_COASTLINE >> 20} MiB: cut it to the region first")
    lines, areas = [], []
    try:
        for closed, ring in _geojson_lines(json.loads(path.read_text(encoding="utf-8"))):
            lonlat = np.asarray(ring, dtype=np.float64)[:, :2]
            line = projection.to_plane(lonlat[:, 0], lonlat[:, 1])
            if np.isfinite(line).all():
                lines.append(line)
                if closed and np.hypot(*line.T).max() < _FAR:
                    areas.append(line)
    except (ValueError, TypeError, IndexError, KeyError, AttributeError, RecursionError) as error:
        raise ValueError(f"{path} is not a GeoJSON file of lines or polygons: {error}") from None
    return lines, areas


def _geojson_lines(item: dict[str, Any]) -> Iterator[tuple[bool, list]]:
    """(is it an area's outline, positions) of every line and outer ring of a GeoJSON object."""
    match item.get("type"):
        case "FeatureCollection":
            for feature in item["features"]:
                yield from _geojson_lines(feature)
        case "Feature":
            if item["geometry"] is not None:
                yield from _geojson_lines(item["geometry"])
        case "GeometryCollection":
            for geometry in item["geometries"]:
                yield from _geojson_lines(geometry)
        case "LineString":
            yield False, item["coordinates"]
        case "MultiLineString":
            yield from ((False, line) for line in item["coordinates"])
        case "Polygon":
            yield from ((k == 0, ring) for k, ring in enumerate(item["coordinates"]))
        case "MultiPolygon":
            yield from ((k == 0, ring) for polygon in item["coordinates"] for k, ring in enumerate(polygon))
        case "Point" | "MultiPoint":
            return
        case kind:
            raise ValueError(f"unknown type {kind!r}")


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as the file's ending says (png, svg, pdf); the same figure gives the same bytes."""
    undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(Path(path).suffix.lower(), {})
    with rc_context(cast(Any, STYLE)):
        figure.savefig(path, metadata=undated)
