"""How far, and for how long, an agent strays from the track of its class: what the tracks show of one another."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from wakefold.base import small
from wakefold.base.types import Floats, Ints
from wakefold.model.dynamics import Dynamics
from wakefold.model.kernels import components
from wakefold.model.model import Model

MOST = 300  # tracks that are held out
PIECES = 4  # of a track, each with offsets of its own
SHOWN = 30  # tracks that are held out to see how far fixes tell tracks apart
RIVALS = 100  # tracks that they are told from, and at most so many relatives
KINDS = 3  # ratios that stand for all, each with components of its own on every track
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
        power: to which the probability of a fix is raised where it tells tracks apart, in (0, 1]: whoever goes its own
            way now does so at the next step, so many fixes tell less than as many independent ones would.
    """

    scales: Floats
    ratios: Floats
    rate: float
    along: float
    power: float = 1.0

    def quantiles(self, number: int) -> Floats:
        """So many equally likely ratios that stand for all, ``(number,)``."""
        return np.quantile(self.ratios, (np.arange(number) + 0.5) / number)

    def advance(
        self, dynamics: Dynamics, points: Floats, covs: Floats, spreads: Floats, classes: Ints, dt: float
    ) -> None:
        """Move Gaussians (n, d), (n, d, d) of long-run sd ``spreads`` (n,) beside their tracks, in place."""
        parts = dynamics.substeps(dt)
        h = dt / max(parts, 1)
        across2 = spreads**2 * -math.expm1(-2.0 * self.rate * h)
        along2 = np.maximum(self.along**2 * h, across2)
        motion = (parts, h, math.exp(-self.rate * h), across2, along2)
        components.advance(points, covs, classes, *motion, dynamics.ground)

    @classmethod
    def learn(cls, model: Model) -> Deviation:
        """From tracks held out, each beside the track nearest to it; at most 300, evenly spread.

        The scale of a track is the distance at which it joins another, its death, and at least a tenth of the median. A
        ratio is the root mean square of the offsets over a quarter of a track that is held out, over the scale that the
        other track has without it, and at least a tenth. The rate is that of the autocorrelation of offsets from one
        point to the next, but at least one in a median duration: an offset is not known to last beyond a track. The
        noise along the heading is what the velocities of the two tracks differ by. A single track shows nothing of
        this: its noise, in all directions, is the model's.

        The power is the one under which the points of a track that is held out, taken for fixes, give the other tracks
        of its parent class the largest mean log-probability; at most 30 are held out, at most 200 told apart. 1 if no
        parent tells tracks apart.
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
        for track in _spread(len(tracks), MOST):
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
        learned = cls(
            np.maximum(scales, least),
            np.sort(np.maximum(ratios, LEAST)),
            rate,
            math.sqrt(lag / steps) if steps else 0.0,
        )
        return learned._replace(power=_power(model, learned))


def _spread(count: int, most: int) -> Ints:
    """At most so many of ``count`` numbers, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(np.int64))


def _power(model: Model, beside: Deviation) -> float:
    """See ``Deviation.learn``."""
    tracks, tree = model.tracks, model.filtration
    powers = np.linspace(0.0, 1.0, 41)[1:]
    scores = np.zeros(len(powers))
    for track in _spread(len(tracks), SHOWN):
        relatives = tree.members(int(tree.parent[track]))
        if len(relatives) == len(tracks):
            continue
        rivals = np.setdiff1d(np.union1d(_spread(len(tracks), RIVALS), relatives[:RIVALS]), [track])
        told = _told(model, beside, int(track), rivals)
        related = np.isin(rivals, relatives)
        told = np.maximum(told - told.max(axis=1, keepdims=True), -700.0)  # so that no probability is zero
        masses = small.exp(powers[:, None, None] * told)
        scores += small.log(masses[:, :, related].sum(axis=2) / masses.sum(axis=2)).mean(axis=1)
    return float(powers[scores.argmax()]) if scores.any() else 1.0


def _told(model: Model, beside: Deviation, track: int, rivals: Ints) -> Floats:
    """``(n, R)`` log-probability of a track up to each of its points, beside each rival from its nearest point on."""
    tracks, dynamics = model.tracks, model.dynamics
    ratios = beside.quantiles(KINDS)
    first = [tracks[int(r)][np.square(tracks[int(r)] - tracks[track][0]).sum(axis=1).argmin()] for r in rivals]
    points, classes = np.repeat(first, len(ratios), axis=0), np.repeat(rivals, len(ratios))
    spreads = beside.scales[classes] * np.tile(ratios, len(rivals))
    covs = np.eye(tracks.dim) * np.square(spreads)[:, None, None]
    log_g = np.empty((len(tracks[track]), len(classes)))
    steps = np.diff(tracks.times_of(track), prepend=tracks.times_of(track)[0])
    for k, (fix, dt) in enumerate(zip(tracks[track], steps, strict=True)):
        beside.advance(dynamics, points, covs, spreads, classes, float(dt))
        components.correct(points, covs, fix, model.sd**2 + dynamics.floor**2, log_g[k], dynamics.dims)
    sums = np.cumsum(log_g, axis=0).reshape(len(log_g), len(rivals), len(ratios))
    peak = sums.max(axis=2, keepdims=True)
    return peak[:, :, 0] + small.log(small.exp(sums - peak).sum(axis=2))


def _others(model: Model, track: int, held_out: int) -> tuple[list[int], Floats]:
    """Up to two tracks nearest to a track, itself and the one held out apart, and how far they are."""
    found, away = model.filtration.query(model.tracks[track], model.tracks, k=3)
    keep = (found != track) & (found != held_out)
    return found[keep].tolist(), away[keep]
