"""A position fix: fine evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wakefold.base.checks import real, shown
from wakefold.tracks.arrays import MOST_AXES

if TYPE_CHECKING:
    from wakefold.tracks.projection import Projection


class Fix:
    """A position fix: plane coordinates, or longitude and latitude.

    Args:
        position: ``(d,)`` metres in the model's plane.
        lon, lat: degrees WGS84, instead of ``position``; needs a model learned from geodetic tracks.
        sd: standard deviation of the fix per axis, metres; without it the filter's own.

    Raises:
        ValueError: a number that is missing, not finite or out of range; the message names the field.
    """

    __slots__ = ("lonlat", "position", "sd")

    def __init__(
        self,
        position: ArrayLike | None = None,
        *,
        lon: float | None = None,
        lat: float | None = None,
        sd: float | None = None,
    ) -> None:
        self.position: NDArray[np.float64] | None = None
        self.lonlat: tuple[float, float] | None = None
        if position is not None:
            if lon is not None or lat is not None:
                raise ValueError("Fix takes a position or lon and lat, not both")
            try:
                self.position = np.atleast_1d(np.asarray(position, dtype=np.float64))
            except (TypeError, ValueError, OverflowError):
                raise ValueError(f"Fix position must be numbers, got {shown(position)}") from None
            if self.position.ndim != 1 or not 1 <= len(self.position) <= MOST_AXES:
                raise ValueError(f"Fix position must be 1 to {MOST_AXES} coordinates, got shape {self.position.shape}")
            if not all(map(math.isfinite, self.position.tolist())):
                raise ValueError(f"Fix position must be finite, got {self.position.tolist()}")
        else:
            if lon is None or lat is None:
                raise ValueError("Fix needs a position, or lon and lat")
            lon, lat = real(lon, "Fix lon"), real(lat, "Fix lat")
            if not -180.0 <= lon <= 360.0:  # NaN too
                raise ValueError(f"Fix lon must be degrees within -180..360, got {lon}")
            if not -90.0 <= lat <= 90.0:
                raise ValueError(f"Fix lat must be degrees within -90..90, got {lat}")
            self.lonlat = (float(lon), float(lat))
        if sd is not None and (np.ndim(sd) > 0 or not 0.0 < (sd := real(sd, "Fix sd")) < math.inf):
            raise ValueError(f"Fix sd must be a positive number of metres, one for all axes, got {shown(sd)}")
        self.sd = None if sd is None else float(sd)

    def on_plane(self, projection: Projection | None, dim: int) -> NDArray[np.float64]:
        """``(d,)`` metres in the plane of a model.

        Raises:
            ValueError: lon and lat for a planar model, or a wrong number of coordinates.
        """
        if self.position is None:
            assert self.lonlat is not None
            if projection is None:
                raise ValueError("this model was learned from planar tracks: give the Fix a position, not lon and lat")
            position = projection.to_plane(*self.lonlat)[0]
            if dim != 2:
                raise ValueError(f"the model is {dim}-D: give the Fix a position of {dim} coordinates")
            return position
        if len(self.position) != dim:
            raise ValueError(f"the model is {dim}-D, the Fix has {len(self.position)} coordinates")
        return self.position

    def __repr__(self) -> str:
        where = f"lon={self.lonlat[0]}, lat={self.lonlat[1]}" if self.lonlat else f"{self.position}"
        return f"Fix({where}{'' if self.sd is None else f', sd={self.sd:g}'})"


def on_plane(fixes: Sequence[Fix | None], projection: Projection | None, dim: int) -> list[Fix | None]:
    """The same fixes, their longitudes and latitudes projected at once onto the plane of a model.

    One that does not fit the model stays as it is: ``Fix.on_plane`` says why.
    """
    out = list(fixes)
    rows = [k for k, fix in enumerate(out) if fix is not None and fix.lonlat is not None]
    if projection is None or dim != 2 or not rows:
        return out
    places = projection.to_plane(*zip(*(fix.lonlat for k in rows if (fix := out[k]) and fix.lonlat), strict=True))
    sound = np.asarray(np.isfinite(places).all(axis=1))
    for k, place, good in zip(rows, places, sound, strict=True):
        if good and (fix := out[k]):
            out[k] = moved = Fix.__new__(Fix)  # checked already
            moved.position, moved.lonlat, moved.sd = place, None, fix.sd
    return out
