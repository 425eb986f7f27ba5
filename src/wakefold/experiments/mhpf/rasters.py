"""Traffic rasters of real tracks for the tanker experiments, in place of the synthetic one."""

from __future__ import annotations

from pathlib import Path
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from wakefold.experiments.mhpf import datasets

TANKERS = "tankers"  # data of the synthetic raster; that of a file is called "tankers:" and its path


def keep(file: Path, folder: Path) -> str:
    """Count the traffic in a file of tracks, any that Wakefold reads, and keep the raster in ``folder``.

    Returns:
        the name of the walks over it, as ``scenarios.data`` takes it.

    Raises:
        ValueError, OSError: see ``wakefold.read_tracks`` and ``datasets.traffic_of``.
    """
    from wakefold.io import read_tracks

    raster, starts = datasets.traffic_of(read_tracks(file)[0])
    folder.mkdir(parents=True, exist_ok=True)
    kept = (folder / f"raster-{crc32(raster.density.tobytes()):08x}.npz").resolve()
    np.savez(kept, density=raster.density, origin=raster.origin, cell=raster.cell, starts=starts)
    return f"{TANKERS}:{kept}"


def traffic(name: str) -> tuple[datasets.Raster, NDArray[np.float64]]:
    """The raster and the start cells of ``TANKERS`` or of what ``keep`` gave."""
    path = name.partition(":")[2]
    if not path:
        return datasets.tanker_traffic()
    with np.load(path) as kept:
        return datasets.Raster(kept["density"], kept["origin"], float(kept["cell"])), kept["starts"]
