"""A local plane for geodetic data: azimuthal equidistant, centred on the data, metres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold.base.remember import Remembers
from wakefold.base.units import DAY

YEAR = 365 * DAY


@dataclass(frozen=True)
class Projection(Remembers):
    """Azimuthal equidistant projection on WGS84 about a centre, degrees.

    Distances from the centre are true. It has no seam (the antimeridian is nowhere special) and works at the
    poles; within 1,000 km of the centre all lengths are true to 0.5 %, within 100 km to 0.005 %.
    """

    lon: float
    lat: float

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
        x, y = self._transformer.transform(np.asarray(lon, dtype=np.float64), np.asarray(lat, dtype=np.float64))
        return np.stack([np.atleast_1d(x), np.atleast_1d(y)], axis=1)

    def to_geodetic(self, points: ArrayLike) -> NDArray[np.float64]:
        """``(n, 2)`` longitude (-180..180) and latitude, degrees, of plane positions ``(n, 2)`` or ``(n, 3)``."""
        p = np.atleast_2d(np.asarray(points, dtype=np.float64))
        lon, lat = self._transformer.transform(p[:, 0], p[:, 1], direction="INVERSE")
        return np.stack([lon, lat], axis=1)

    def __str__(self) -> str:
        north, east = "N" if self.lat >= 0 else "S", "E" if self.lon >= 0 else "W"
        return f"metres about {abs(self.lat):.4g}°{north} {abs(self.lon):.4g}°{east}"


def dated(projection: Projection | None, earliest: float) -> bool:
    """Whether times from ``earliest`` on are dates: of geodetic tracks after 1970. Data without times count from 0."""
    return projection is not None and earliest >= YEAR
