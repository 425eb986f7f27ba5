"""Which objects there are: what the engines of the relational filter share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.base.types import Floats, Ints
from wakefold.relations.detections import Detections
from wakefold.relations.model import RelationalModel
from wakefold.relations.scene import Scene

GONE = 0.01  # an object is let go when it exists with less than this probability


class Settings(NamedTuple):
    """What ``RelationalFilter`` was told."""

    model: RelationalModel
    engine: str
    particles: int
    gate: float
    forget: float
    cluster: int
    hypotheses: int
    histories: int


class Objects(NamedTuple):
    """The columns of ``Scene`` that tell of objects."""

    ids: NDArray
    kinds: Ints
    serial: Ints
    mean: Floats
    cov: Floats
    existence: Floats
    unseen: Floats

    def keep(self, rows: NDArray) -> Objects:
        return Objects(
            self.ids[rows],
            self.kinds[rows],
            self.serial[rows],
            self.mean[rows],
            self.cov[rows],
            self.existence[rows],
            self.unseen[rows],
        )


def objects_of(scene: Scene, mean: Floats, cov: Floats) -> Objects:
    """Copies of the columns, with the states given, to be worked on."""
    return Objects(
        scene.ids,
        scene.kinds.copy(),
        scene.serial.copy(),
        mean.copy(),
        cov.copy(),
        scene.existence.copy(),
        scene.unseen.copy(),
    )


def match(ids: NDArray, scan: Detections) -> tuple[Ints, Ints]:
    """Which detection each object has, ``(n,)``, -1 for none; and the detections of new objects.

    Raises:
        ValueError: ids of another type than before.
    """
    assert scan.ids is not None
    if len(ids) and len(scan) and (ids.dtype.kind == "U") != (scan.ids.dtype.kind == "U"):
        raise ValueError("Detections ids were whole numbers before and are texts now, or the other way round")
    if not len(ids) or not len(scan):
        return np.full(len(ids), -1), np.arange(len(scan))
    if len(ids) == len(scan) and (ids == scan.ids).all():
        return np.arange(len(ids)), np.zeros(0, dtype=np.int64)
    order = np.argsort(scan.ids, kind="stable")
    at = order[np.minimum(np.searchsorted(scan.ids[order], ids), len(order) - 1)]
    found = np.where(scan.ids[at] == ids, at, -1)
    known = np.zeros(len(scan), dtype=bool)
    known[found[found >= 0]] = True
    return found, np.flatnonzero(~known)


def enter(objects: Objects, scan: Detections, fresh: Ints, model: RelationalModel, serials: int) -> Objects:
    """Append the objects first seen in the detections ``fresh``."""
    if not len(fresh):
        return objects
    d = scan.positions.shape[1]
    if len(objects.ids) == 0:
        objects = objects._replace(mean=np.zeros((0, 2, d)))
    kinds = scan.kind_numbers(model.kinds)[fresh]
    serial = serials + np.arange(len(fresh))
    if scan.ids is not None:
        ids = scan.ids[fresh]
        existence = np.ones(len(fresh))
    else:
        ids = _free_names(objects.ids, serial)
        existence = np.full(len(fresh), scan.birth / (scan.birth + scan.clutter) if scan.birth > 0 else 0.0)
    speed = np.array([motion.speed for motion in model.objects.values()])[kinds]
    mean = np.stack([scan.positions[fresh], np.zeros((len(fresh), d))], axis=1)
    cov = np.column_stack([scan.sd[fresh] ** 2, np.zeros(len(fresh)), speed**2])
    old = objects.ids if len(objects.ids) else ids[:0]  # so that an empty scene takes the type of the first ids
    return Objects(
        np.concatenate([old, ids]),
        np.concatenate([objects.kinds, kinds]),
        np.concatenate([objects.serial, serial]),
        np.concatenate([objects.mean, mean]),
        np.concatenate([objects.cov, cov]),
        np.concatenate([objects.existence, existence]),
        np.concatenate([objects.unseen, np.zeros(len(fresh))]),
    )


def _free_names(taken: NDArray, serial: Ints) -> NDArray:
    if taken.dtype.kind == "U" and len(taken):
        return np.array([f"?{s}" for s in serial])
    first = max(int(taken.max()) + 1 if len(taken) else 0, int(serial[0]))
    return first + np.arange(len(serial))


def exist(existence: Floats, seen: NDArray[np.bool_], chance: Floats) -> Floats:
    """Existence after a scan: a miss tells against it as far as a detection was to be expected."""
    if seen.all():
        return np.ones(seen.shape)
    missed = existence * (1.0 - chance)
    with np.errstate(invalid="ignore", divide="ignore"):
        after = np.where(missed + 1.0 - existence > 0.0, missed / (missed + 1.0 - existence), 1.0)
    return np.where(seen, 1.0, after)
