"""How far, and for how long, an agent strays from the track of its class: what the tracks show of one another."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.model import Model

Floats = NDArray[np.float64]
MOST = 300  # tracks that are held out
PIECES = 4  # of a track, each with offsets of its own
LEAST = 0.1  # of the median scale, and ratio: equal tracks do not show that agents never stray


class Deviation(NamedTuple):
    """Motion beside a track (docs/algorithm.md, The calibrated filter).

    Across the heading an agent keeps an offset from the track, an Ornstein-Uhlenbeck process; along it, it gets ahead
    or behind in Brownian motion. The sd of the offset is the track's scale times a ratio that is the agent's own.

    Attributes:
        scales: ``(M,)`` of each track, metres: where tracks are sparse agents stray further.
        ratios: ``(k,)`` equally likely, rising.
        rate: at which the offset is forgotten, 1/s.
        along: noise along the heading, m/sqrt(s); at least the noise across, which is sd * sqrt(2 rate).
    """

    scales: Floats
    ratios: Floats
    rate: float
    along: float

    def quantiles(self, number: int) -> Floats:
        """So many equally likely ratios that stand for all, ``(number,)``."""
        return np.quantile(self.ratios, (np.arange(number) + 0.5) / number)

    @classmethod
    def learn(cls, model: Model) -> Deviation:
        """From tracks held out, each beside the track nearest to it; at most 300, evenly spread.

        The scale of a track is the distance at which it joins another, its death, and at least a tenth of the median. A
        ratio is the root mean square of the offsets over a quarter of a track that is held out, over the scale that the
        other track has without it, and at least a tenth. The rate is that of the autocorrelation of offsets from one
        point to the next, but at least one in a median duration: an offset is not known to last beyond a track. The
        noise along the heading is what the velocities of the two tracks differ by. A single track shows nothing of
        this: its noise, in all directions, is the model's.
        """
        tracks, dynamics, step = model.tracks, model.dynamics, model.dynamics.interval
        rate = 1.0 / (float(np.median(tracks.duration)) or step)
        if len(tracks) == 1:
            noise = dynamics.scale if dynamics.noise == "gaussian" else 0.0
            return cls(np.array([max(noise / math.sqrt(2.0 * rate), dynamics.floor)]), np.ones(1), rate, noise)
        scales = model.filtration.death[: len(tracks)]
        least = max(LEAST * float(np.median(scales)), dynamics.floor)
        ratios: list[float] = []
        products = squares = lag = 0.0
        steps = 0
        for track in np.unique(np.linspace(0, len(tracks) - 1, min(MOST, len(tracks))).round().astype(np.int64)):
            other = _others(model, int(track), int(track))[0][0]
            own, times, there = tracks[int(track)], tracks.times_of(int(track)), tracks[other]
            velocity = dynamics.velocity(own, other)
            speed = np.linalg.norm(velocity, axis=1, keepdims=True)
            heading = np.divide(velocity, speed, out=np.zeros_like(velocity), where=speed > 0)
            near = there[[int(np.square(there - point).sum(axis=1).argmin()) for point in own]]
            offset = own - near
            offset -= heading * (offset * heading).sum(axis=1, keepdims=True)
            without = _others(model, other, int(track))[1] if len(tracks) > 2 else scales[[other]]
            for piece in np.array_split(offset, min(PIECES, len(offset))):
                size = math.sqrt(float(np.square(piece).sum()) / len(piece) / max(tracks.dim - 1, 1))
                ratios.append(size / max(float(without[0]), least))
            if len(own) > 1:
                products += float((offset[1:] * offset[:-1]).sum())
                squares += float(np.square(offset[:-1]).sum())
                ahead = (np.diff(own, axis=0) / np.diff(times)[:, None] - velocity[:-1]) * heading[:-1]
                lag += float(np.square(ahead.sum(axis=1)).sum() * step)
                steps += len(own) - 1
        kept = products / squares if squares > 0 else 1.0
        rate = max(-math.log(max(kept, math.exp(-1.0))) / step, rate)
        return cls(
            np.maximum(scales, least),
            np.sort(np.maximum(ratios, LEAST)),
            rate,
            math.sqrt(lag / steps) if steps else 0.0,
        )


def _others(model: Model, track: int, held_out: int) -> tuple[list[int], Floats]:
    """Up to two tracks nearest to a track, itself and the one held out apart, and how far they are."""
    found, away = model.filtration.query(model.tracks[track], model.tracks, k=3)
    keep = (found != track) & (found != held_out)
    return found[keep].tolist(), away[keep]
