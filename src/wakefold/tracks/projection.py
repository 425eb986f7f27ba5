"""A local plane for geodetic data: azimuthal equidistant, centred on the data, metres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold.base.remember import Remembers
from wakefold.base.units import DAY

YEAR = 365 * DAY
YEAR_2100 = 4_102_444_800.0


@dataclass(frozen=True)
class Projection(Remembers):
    """Azimuthal equidistant projection on WGS84 about a centre, degrees.

    Distances from the centre are true. It has no seam (the antimeridian is nowhere special) and works at the
    poles; within 1,000 km of the centre all lengths are true to 0.5 %, within 100 km to 0.005 %.
    """

    lon: float
    lat: float

    def __post_init__(self) -> None:
        for name, value, most in (("lon", self.lon, 360.0), ("lat", self.lat, 90.0)):
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not abs(value) <= most:
                raise ValueError(
                    f"the {name} of a projection's centre must be degrees, at most {most:g}, got {value!r}"
                )

    @classmethod
    def of(cls, lon: ArrayLike, lat: ArrayLike) -> Projection:
        """Centred on the mean direction of the positions (degrees), so that -179 and 179 average to 180.

        The centre is rounded to 1e-4 degrees (about 10 m): a different order of the rows gives the same plane.

        Raises:
            ValueError: no positions, or one that is not finite or has a latitude beyond a pole.
        """
        if np.size(lon) == 0 or not (np.isfinite(lon).all() and (np.abs(lat) <= 90).all()):
            raise ValueError("a projection needs positions with finite longitude and latitude in -90..90 degrees")
        lam, phi = np.radians(np.asarray(lon, dtype=np.float64)), np.radians(np.asarray(lat, dtype=np.float64))
        x, y, z = (np.cos(phi) * np.cos(lam)).mean(), (np.cos(phi) * np.sin(lam)).mean(), np.sin(phi).mean()
        return cls(
            round(float(np.degrees(np.arctan2(y, x))), 4), round(float(np.degrees(np.arctan2(z, np.hypot(x, y)))), 4)
        )

    @cached_property
    def _transformer(self):
        from pyproj import Transformer

        plane = f"+proj=aeqd +lat_0={self.lat} +lon_0={self.lon} +datum=WGS84 +units=m"
        return Transformer.from_crs("EPSG:4326", plane, always_xy=True)

    def to_plane(self, lon: ArrayLike, lat: ArrayLike) -> NDArray[np.float64]:
        """``(n, 2)`` metres east and north of the centre; NaN or inf where a position is not one."""
        from wakefold.tracks.kernels import plane

        lon, lat = (np.atleast_1d(np.asarray(angle, dtype=np.float64)) for angle in (lon, lat))
        x, y, cosine = np.empty((3, len(lon)))
        plane.azimuthal(lon, lat, float(self.lon), float(self.lat), x, y, cosine)
        out = np.stack([x, y], axis=1)
        far = ~((cosine >= plane.NEAR) & (np.abs(lat) <= 90.0))  # also what is no position
        if far.any():
            out[far] = np.stack(self._transformer.transform(lon[far], lat[far]), axis=1)
        return out

    def to_geodetic(self, points: ArrayLike) -> NDArray[np.float64]:
        """``(n, 2)`` longitude (-180..180) and latitude, degrees, of plane positions ``(n, 2)`` or ``(n, 3)``."""
        p = np.atleast_2d(np.asarray(points, dtype=np.float64))
        lon, lat = self._transformer.transform(p[:, 0], p[:, 1], direction="INVERSE")
        return np.stack([lon, lat], axis=1)

    def __str__(self) -> str:
        north, east = "N" if self.lat >= 0 else "S", "E" if self.lon >= 0 else "W"
        return f"metres about {abs(self.lat):.4g}°{north} {abs(self.lon):.4g}°{east}"


def cut_at_seam(lonlat: NDArray[np.float64]) -> list[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """A line ``(n, 2)`` of longitudes and latitudes, degrees, in parts none of which crosses the antimeridian.

    A leg is the shorter way round. Where one crosses, a part ends at longitude 180 (or -180) and the next begins at the
    other, at the latitude between (RFC 7946, 3.1.9).

    Returns:
        each part ``(k, 2)`` with the rows ``(k,)`` that its positions are; -1 for those that the cut made.
    """
    lon, lat = lonlat[:, 0], lonlat[:, 1]
    step = np.diff(lon)
    parts, begin = [], 0
    head = np.empty((0, 2))
    for k in np.flatnonzero(np.abs(step) > 180.0):
        side = np.copysign(180.0, lon[k])
        span = step[k] + 2.0 * side  # from here on past the side to the next position
        share = (side - lon[k]) / span if span != 0.0 else 0.0
        at = lat[k] + share * (lat[k + 1] - lat[k])
        rows = np.arange(begin, k + 1)
        parts.append((head, rows, np.array([[side, at]])))
        head, begin = np.array([[-side, at]]), k + 1
    parts.append((head, np.arange(begin, len(lon)), np.empty((0, 2))))
    return [
        (
            np.vstack([before, lonlat[rows], after]),
            np.concatenate([[-1] * len(before), rows, [-1] * len(after)]).astype(int),
        )
        for before, rows, after in parts
    ]


def dated(projection: Projection | None, earliest: float) -> bool:
    """Whether times from ``earliest`` on are dates: of geodetic tracks after 1970, of planar ones from 2001 on, since
    other clocks count from 0. Data without times do too."""
    return earliest >= YEAR if projection is not None else 1e9 <= earliest < YEAR_2100
