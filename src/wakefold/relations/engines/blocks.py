"""Particles of a scene in blocks: objects that may be related share weights, different blocks are independent.

Arrays as in ``scene.Particles``: M particles, n objects.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from wakefold.base import small
from wakefold.base.types import Floats, Ints
from wakefold.relations.engines.objects import Settings
from wakefold.relations.engines.pairs import diffusions
from wakefold.relations.kernels import sampled as kernel
from wakefold.relations.model import Sampler
from wakefold.relations.motion import moving
from wakefold.relations.pairs import ParticlePairs
from wakefold.relations.scene import Particles


def blocks_of(particles: Particles) -> list[Ints]:
    """The objects of each block, in the order of their first objects."""
    return _places(particles.block)


def _places(labels: Ints) -> list[Ints]:
    """Where each label stands, in the order of their first places."""
    out: dict[int, list[int]] = {}
    for place, label in enumerate(labels.tolist()):
        out.setdefault(label, []).append(place)
    return [np.array(places) for places in out.values()]


def rows_of(members: Ints, n: int) -> Ints:
    """Rows of a covariance that belong to some objects: positions, then velocities."""
    return np.concatenate([members, n + members])


def redraw(
    particles: Particles, pairs: tuple[ParticlePairs, ...], rng: np.random.Generator, always: bool
) -> tuple[Particles, list[ParticlePairs]]:
    """Copies, each block resampled systematically: ``always``, or when its effective size is below half of M."""
    mean, cov, logs = (np.array(x, order="C") for x in (particles.mean, particles.cov, particles.log_weights))
    bits = [np.array(p.bits) for p in pairs]
    count, n = logs.shape
    for members in blocks_of(particles):
        u, order = rng.random(), rng.permutation(count)  # drawn even if unused, so that the stream keeps its step
        weights = small.exp(logs[:, members[0]])
        if not always and 1.0 / (weights**2).sum() >= 0.5 * count:
            continue
        edges = np.cumsum(weights)
        kept = np.searchsorted(edges, (np.arange(count) + u) / count * edges[-1])
        kept = np.minimum(kept, count - 1)[order]  # shuffled: blocks that meet are paired at random
        mean[:, :, members] = mean[kept][:, :, members]
        rows = rows_of(members, n)
        cov[:, rows[:, None], rows] = cov[kept[:, None, None], rows[:, None], rows]
        logs[:, members] = -math.log(count)
        for p, held in zip(pairs, bits, strict=True):
            inside = np.flatnonzero(particles.block[p.first] == particles.block[members[0]])
            held[:, inside] = held[kept[:, None], inside]
    again = [replace(p, bits=b) for p, b in zip(pairs, bits, strict=True)]
    return Particles(mean, cov, logs, particles.block), again


def move(
    s: Settings, particles: Particles, pairs: list[ParticlePairs], kinds: Ints, dt: float, rng: np.random.Generator
) -> None:
    """Objects move given the relations of before (first factor of Eq. 1), in place; "bootstrap" samples them."""
    count, _, n, d = particles.mean.shape
    q = np.array(diffusions(s.model))[kinds] if n else np.zeros(0)
    if s.engine == "bootstrap":
        _sampled_motions(s, particles, kinds, dt, rng)
    noise = rng.standard_normal((count, 2 * n, d)) if s.engine == "bootstrap" else None
    free = np.array([isinstance(m, Sampler) for m in s.model.objects.values()], dtype=bool)[kinds]
    acting = [
        (r.couples, p) for r, p in zip(s.model.relations, pairs, strict=True) if r.couples is not None and len(p.first)
    ]
    states = particles.mean.reshape(count, 2 * n, d)  # a view
    for members in blocks_of(particles):
        place = np.full(n, -1)
        place[members] = np.arange(len(members))
        ties = [(how, p, k) for how, p in acting for k in np.flatnonzero(place[p.first] >= 0)]
        held = np.array([p.bits[:, k] for _, p, k in ties], dtype=bool).reshape(len(ties), count).T.tobytes()
        company: dict[bytes, list[int]] = {}  # particles in which the same relations hold
        for m in range(count):
            company.setdefault(held[m * len(ties) : (m + 1) * len(ties)], []).append(m)
        rows = rows_of(members, n)
        for on, alike in company.items():
            at = np.array(alike)
            couplings = [
                (int(place[p.first[k]]), int(place[p.second[k]]), how)
                for (how, p, k), is_on in zip(ties, on, strict=True)
                if is_on
            ]
            f, w = moving(q[members], couplings, dt)
            if free[members].any():  # a sampler has moved them: couplings act on velocities alone
                f, w = f.copy(), w.copy()
                moved = np.flatnonzero(free[members])
                f[moved] = np.eye(len(f))[moved]
                w[moved], w[:, moved] = 0.0, 0.0
            kernel.carry(np.array(f), np.array(w), at, rows, states, particles.cov, noise is None)
            if noise is not None:
                kernel.draw(np.array(w)[None], at, rows, noise, states)


def _sampled_motions(s: Settings, particles: Particles, kinds: Ints, dt: float, rng: np.random.Generator) -> None:
    count, _, _, d = particles.mean.shape
    for number, (kind, motion) in enumerate(s.model.objects.items()):
        which = np.flatnonzero(kinds == number)
        if isinstance(motion, Sampler) and len(which):
            x, v = (particles.mean[:, i][:, which].reshape(-1, d) for i in range(2))
            moved = [np.asarray(a, dtype=np.float64) for a in motion.move(x, v, dt, rng)]
            for a in moved:
                if a.shape != x.shape or not np.isfinite(a).all():
                    raise ValueError(f"kind {kind!r}: move must give finite positions and velocities {x.shape}")
            for i, a in enumerate(moved):
                particles.mean[:, i, which] = a.reshape(count, len(which), d)


def summary(particles: Particles) -> tuple[Floats, Floats]:
    """Mean ``(n, 2, d)`` of each object and its covariance (position, cross, velocity) averaged over the axes."""
    _, _, n, d = particles.mean.shape
    weights = small.exp(particles.log_weights)  # (M, n)
    mean = (weights[:, None, :, None] * particles.mean).sum(axis=0).transpose(1, 0, 2)
    cov = np.empty((n, 3))
    own, away = np.arange(n), particles.mean - mean.transpose(1, 0, 2)
    for at, (i, j) in enumerate(((0, 0), (0, 1), (1, 1))):
        within = particles.cov[:, own + i * n, own + j * n]
        product = away[:, i] * away[:, j]
        cov[:, at] = (weights * (within + (product[:, :, 0] + product[:, :, 1]) / d)).sum(axis=0)
    return mean, cov


def regroup(particles: Particles, edges: Ints, weights: Floats, cluster: int) -> Particles:
    """New blocks: objects tied by edges, the tightest first, as long as a block has at most ``cluster`` objects.

    Blocks that meet multiply their weights; objects that part forget how they depended on one another.

    Args:
        edges: ``(E, 2)``; weights: ``(E,)`` sorts them, the smallest first.

    Returns:
        New particles; arrays in which nothing changes are those given.
    """
    n, block = len(particles.block), np.arange(len(particles.block))
    size = np.ones(n, dtype=np.int64)
    old = np.array(particles.block)
    apart = (old[edges[:, 0]] != old[edges[:, 1]]) if len(edges) else np.zeros(0, bool)
    for e in np.lexsort((edges[:, 1], edges[:, 0], weights, apart)) if len(edges) else []:
        a, b = block[edges[e, 0]], block[edges[e, 1]]
        if a != b and size[a] + size[b] <= cluster:
            keep, gone = min(a, b), max(a, b)
            block[block == gone] = keep
            size[keep] += size[gone]
    logs, cov = particles.log_weights, particles.cov
    for members in _places(block):
        firsts = [members[places[0]] for places in _places(old[members])]
        if len(firsts) > 1:
            total = logs[:, firsts].sum(axis=1)
            total -= np.logaddexp.reduce(total)
            logs = np.array(logs)
            logs[:, members] = total[:, None]
    same = block[:, None] == block
    if not same.all():
        cov = np.array(cov)
        cov[:, ~np.tile(same, (2, 2))] = 0.0
    return Particles(particles.mean, cov, logs, block)
