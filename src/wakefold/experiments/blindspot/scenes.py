"""Three people walk through a blind spot: two of them together, a third behind them alone (Manfredotti et al. 2011).

What happens unseen differs from scene to scene:

- "pair pauses": the two stop for a while, the third passes them and comes out first (the paper's scene);
- "third is faster": the third overtakes them without a pause;
- "order kept": they come out as they went in;
- "pair really splits": one of the two stops, the other walks on.

Walkers keep to a wanted speed and to a wanted place across the corridor, which they change in the blind spot; the two
keep their places beside each other. Nothing here is the motion model of the filters.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wakefold.base.types import Floats

SCENES = ("pair pauses", "third is faster", "order kept", "pair really splits")
BLIND = (8.0, 14.0)  # m along the corridor
LENGTH = 24.0  # m; a scene ends once all are past it
DT = 0.4  # s between scans
SD = 0.1  # m, of a detection
DETECTED = 0.98  # where it is not blind
CLUTTER = 1e-3  # false detections per square metre and scan
SIDE = 2.0  # m: half the width of what the sensor covers
_SUBSTEPS = 8


class Walk(NamedTuple):
    """A scene.

    Attributes:
        truth: ``(T, 3, 2)`` positions of the two who start together, and of the third, metres.
        scans: T arrays ``(m, 2)`` of detections, in no order.
    """

    truth: Floats
    scans: list[Floats]


def visible(points: Floats) -> Floats:
    """``(n,)`` probability that somebody at ``points (n, 2)`` is detected."""
    inside = (points[:, 0] > BLIND[0]) & (points[:, 0] < BLIND[1])
    return np.where(inside, 0.0, DETECTED)


def walk(scene: str, seed: int) -> Walk:
    """One random scene; the same name and seed give the same.

    Raises:
        ValueError: no scene of that name.
    """
    if scene not in SCENES:
        raise ValueError(f"scene must be one of {', '.join(SCENES)}, got {scene!r}")
    rng = np.random.default_rng([SCENES.index(scene), seed])
    pace = rng.normal(1.2, 0.1)
    speed = np.array([pace, pace, pace if scene != "third is faster" else pace * rng.uniform(1.6, 2.0)])
    gap = rng.uniform(2.5, 4.0) if scene != "third is faster" else rng.uniform(3.0, 4.5)
    centre, apart, third = rng.normal(0.0, 0.4), rng.uniform(0.6, 0.9), rng.normal(0.0, 0.4)
    across = np.array([centre - apart / 2, centre + apart / 2, third])
    later = across + np.array([1.0, 1.0, 0.0]) * rng.normal(0.0, 0.4) + np.array([0.0, 0.0, 1.0]) * rng.normal(0.0, 0.4)
    if scene == "pair really splits":  # each goes his own way
        later[:2] = across[:2] + rng.normal(0.0, 0.4, 2)
    stops, place, pause = np.zeros(3, dtype=bool), rng.uniform(BLIND[0] + 1.5, BLIND[1] - 1.5), rng.uniform(4.0, 8.0)
    if scene == "pair pauses":
        stops[:2] = True
    elif scene == "pair really splits":
        stops[int(rng.integers(2))] = True
    x = np.column_stack([np.array([0.0, rng.normal(0.0, 0.1), -gap]), across])
    v = np.column_stack([speed, np.zeros(3)])
    waited, truth, h = np.zeros(3), [x.copy()], DT / _SUBSTEPS
    jostle = rng.normal(size=(int(90.0 / h), 3, 2)) * 0.15 * np.sqrt(h)
    for k in range(len(jostle)):
        standing = stops & (x[:, 0] >= place) & (waited < pause)
        waited[standing] += h
        wanted = np.column_stack(
            [np.where(standing, 0.0, speed), np.where(x[:, 0] > BLIND[0], later, across) - x[:, 1]]
        )
        v += (wanted - v) * h / 0.6 + jostle[k]  # walkers reach their speed within about a second
        v[standing] *= np.exp(-h / 0.2)
        x = x + v * h
        if (k + 1) % _SUBSTEPS == 0:
            truth.append(x.copy())
            if (x[:, 0] > LENGTH).all():
                break
    out = np.array(truth)
    return Walk(out, [_scan(at, rng) for at in out])


def _scan(at: Floats, rng: np.random.Generator) -> Floats:
    seen = at[rng.random(len(at)) < visible(at)]
    seen = seen + SD * rng.normal(size=seen.shape)
    count = rng.poisson(CLUTTER * 2 * SIDE * (LENGTH + 5.0))
    false = np.column_stack([rng.uniform(-5.0, LENGTH, count), rng.uniform(-SIDE, SIDE, count)])
    every = np.concatenate([seen, false[visible(false) > 0.0]])
    return every[rng.permutation(len(every))]
