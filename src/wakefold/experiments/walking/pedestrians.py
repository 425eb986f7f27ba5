"""Pedestrians with the groups they walk in: ETH (Pellegrini et al. 2009) and UCY (Lerner et al. 2007).

As OpenTraj keeps them: one directory for each scene, with ``obsmat.txt`` (frame, id, x, z, y, vx, vz, vy; metres) and
``groups.txt`` (the ids of a group on each line).
"""

from __future__ import annotations

import math
import os
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from wakefold.tracks.tracks import Tracks

SCENES = {"eth": "ETH/seq_eth", "hotel": "ETH/seq_hotel", "zara01": "UCY/zara01", "students03": "UCY/students03"}
FRAME = 0.4  # seconds from one annotated frame to the next
MOST_BYTES = 200_000_000


class PedestrianScene(NamedTuple):
    """People of one scene.

    Attributes:
        name: of the scene.
        tracks: their tracks, metres and seconds; times are whole multiples of ``FRAME`` from the first frame on.
        groups: ids of the people of each group; people may be in several.
    """

    name: str
    tracks: Tracks
    groups: tuple[tuple[str, ...], ...]

    def partners(self) -> frozenset[tuple[str, str]]:
        """All pairs of people who share a group, each in the order of ``tracks.ids``."""
        place = {name: i for i, name in enumerate(self.tracks.ids.tolist())}
        ordered = (sorted(set(group) & place.keys(), key=place.__getitem__) for group in self.groups)
        return frozenset(pair for group in ordered for pair in combinations(group, 2))


def read_scene(directory: str | os.PathLike[str], name: str | None = None) -> PedestrianScene:
    """Read one scene.

    Frame numbers are taken down to whole frames: in seq_eth the annotation is every sixth frame, yet shifts by three
    and by five twice on its way.

    Args:
        directory: of ``obsmat.txt`` and ``groups.txt``.
        name: of the scene; that of the directory by default.

    Raises:
        FileNotFoundError: a file is not there.
        ValueError: a line that cannot be read, or somebody who is in two places at once; the message names it.
    """
    folder = Path(directory)
    rows = _numbers(folder / "obsmat.txt", least=5)
    table = np.array([values[:5] for _, values in rows])
    frames, who = np.floor(table[:, 0]).astype(np.int64), table[:, 1].astype(np.int64)
    order = np.lexsort((frames, who))
    frames, who, xy = frames[order], who[order], table[order][:, [2, 4]]
    same = np.diff(who) == 0
    steps = np.diff(frames)[same]
    if (steps <= 0).any():
        at = int(np.flatnonzero(same)[np.argmax(steps <= 0)])
        raise ValueError(f"{folder / 'obsmat.txt'}: {who[at]} is in two places in frame {frames[at]}")
    between = int(np.bincount(steps).argmax()) if len(steps) else 1
    clock = frames // between
    clock -= clock.min()
    people, first = np.unique(who, return_index=True)
    tracks = Tracks(xy, clock * FRAME, np.append(first, len(who)), people.astype(np.str_))
    groups = []
    for number, (line, values) in enumerate(_numbers(folder / "groups.txt", least=1)):
        if number == 0 and len(values) == 1:
            continue  # students03 begins with the number of its groups
        if not all(value.is_integer() for value in values):
            raise ValueError(f"{folder / 'groups.txt'} line {line}: ids must be whole numbers")
        groups.append(tuple(str(int(value)) for value in values))
    return PedestrianScene(name or folder.name, tracks, tuple(groups))


def read_scenes(root: str | os.PathLike[str]) -> list[PedestrianScene]:
    """The four scenes of ``SCENES`` below ``root``, OpenTraj's ``datasets`` directory.

    Raises:
        FileNotFoundError, ValueError: as ``read_scene``.
    """
    return [read_scene(Path(root) / place, name) for name, place in SCENES.items()]


def _numbers(file: Path, least: int) -> list[tuple[int, list[float]]]:
    """Lines of numbers, with where they stand."""
    if file.stat().st_size > MOST_BYTES:
        raise ValueError(f"{file} is larger than {MOST_BYTES // 1_000_000} MB")
    out: list[tuple[int, list[float]]] = []
    for number, line in enumerate(file.read_text(encoding="ascii", errors="replace").splitlines(), start=1):
        try:
            values = [float(word) for word in line.split()]
        except ValueError:
            raise ValueError(f"{file} line {number}: not numbers: {line[:60]!r}") from None
        if not values:
            continue
        if len(values) < least or not all(map(math.isfinite, values)):
            raise ValueError(f"{file} line {number}: needs at least {least} finite numbers, got {line[:60]!r}")
        out.append((number, values))
    if not out:
        raise ValueError(f"{file} is empty")
    return out
