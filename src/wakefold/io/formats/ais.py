"""What all AIS readers share: sentinels, units."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wakefold.base.units import KNOT

NO_SPEED = 102.3
"""Knots; AIS for "not available"."""

Column = NDArray[np.floating]


def motion(sog: Column, cog: Column, heading: Column) -> dict[str, NDArray[np.float32]]:
    """Columns ``sog`` (m/s), ``cog`` and ``heading`` (degrees, 0 to 360) of speeds in knots and angles in degrees.

    NaN for what is not available (ITU-R M.1371: speed 102.3, course 360, heading 511) or out of range. Signed angles
    are turned: -60.6 is 299.4.
    """
    with np.errstate(invalid="ignore"):
        speed = np.where((sog >= 0) & (sog < NO_SPEED - 0.05), sog * KNOT, np.nan)
    return {"sog": speed.astype(np.float32), "cog": _angle(cog), "heading": _angle(heading)}


def _angle(degrees: Column) -> NDArray[np.float32]:
    with np.errstate(invalid="ignore"):
        turned = np.where(degrees < 0, degrees + 360, degrees)
        return np.where((turned >= 0) & (turned < 360), turned, np.nan).astype(np.float32)


MARINECADASTRE = (
    {"mmsi", "basedatetime", "lat", "lon"},
    {"mmsi", "basedatetime", "latitude", "longitude"},
)
DMA = {"timestamp", "mmsi", "latitude", "longitude"}
