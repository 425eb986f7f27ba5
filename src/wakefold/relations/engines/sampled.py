"""The engines "bootstrap" and "rbk": particles that hold the objects and the relations between them.

Algorithm 1 of Manfredotti et al. (2011). A particle holds each relation, and each object either sampled ("bootstrap")
or as a Gaussian given the relations ("rbk"). Objects that may be related make a block; blocks are weighed
and resampled on their own (a block particle filter, Rebeschini and van Handel 2015), so the number of particles needed
goes by the size of a block and not of the scene.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from wakefold.base import small
from wakefold.base.types import Floats, Ints
from wakefold.base.units import LOST
from wakefold.relations.activities import advance
from wakefold.relations.detections import Detections
from wakefold.relations.engines.association import GATE, TINY
from wakefold.relations.engines.blocks import blocks_of, move, redraw, regroup, rows_of, summary
from wakefold.relations.engines.objects import Objects, Settings, enter, exist, match, objects_of
from wakefold.relations.engines.pairs import candidates, looks, program, refresh, settled_variance, staying, switches
from wakefold.relations.engines.unseen import chances, narrow
from wakefold.relations.kernels import sampled as kernel
from wakefold.relations.kernels.looks import log_ratios
from wakefold.relations.model import Relation
from wakefold.relations.pairs import ParticlePairs
from wakefold.relations.scene import Particles, ParticleScene


def step(s: Settings, scene: ParticleScene, scan: Detections | None, dt: float) -> ParticleScene:
    """The scene after ``dt`` seconds and one scan; without a scan only time passes."""
    model = s.model
    rng = np.random.Generator(np.random.Philox(key=scene.key, counter=[0, 0, scene.step + 1, 0]))
    objects = objects_of(scene, scene.mean, scene.cov)
    # line 5 of the step before: what is reported after a step is weighted
    particles, pairs = redraw(scene.particles, scene.pairs, rng, always=s.engine == "bootstrap")
    # line 1
    move(s, particles, pairs, objects.kinds, dt, rng)
    objects.unseen[:] += dt
    # line 3
    evidence, recoveries, fresh = 0.0, 0, np.zeros(0, dtype=np.int64)
    if scan is not None:
        objects, fresh, evidence, recoveries = _look(s, objects, particles, scan, rng)
    _potentials(s, objects, particles, pairs, dt)
    _normalise(particles)
    # line 2: it reads the objects alone, so it may follow line 3
    pairs = [_switch(s, r, p, objects, particles, dt, rng) for r, p in zip(model.relations, pairs, strict=True)]
    objects, particles, pairs = _turnover(s, objects, particles, pairs, scan, fresh, scene.serials, rng)
    return ParticleScene(
        model=model,
        ids=objects.ids,
        kinds=objects.kinds,
        serial=objects.serial,
        mean=objects.mean,
        cov=objects.cov,
        existence=objects.existence,
        unseen=objects.unseen,
        pairs=tuple(pairs),
        key=scene.key,
        particles=particles,
        engine=s.engine,
        step=scene.step + 1,
        serials=scene.serials + len(fresh),
        time=scene.time + dt,
        log_evidence=scene.log_evidence + evidence,
        recoveries=scene.recoveries + recoveries,
    )


def _look(
    s: Settings, objects: Objects, particles: Particles, scan: Detections, rng: np.random.Generator
) -> tuple[Objects, Ints, float, int]:
    """Weigh and update every block by a scan, in place.

    Returns:
        The objects with their existence; detections of new objects; gain of log evidence; recoveries.
    """
    count, _, n, d = particles.mean.shape
    chance, blind = chances(particles, scan)
    u = rng.random((count, n))
    if scan.ids is not None:
        found, fresh = match(objects.ids, scan)
        offers = [found[members][found[members] >= 0] for members in blocks_of(particles)]
    else:
        fresh = np.zeros(0, dtype=np.int64)
        found = np.full(n, -1)
        offers = _offers(objects, particles, scan)
    choice = np.zeros((count, 0), dtype=np.int64)
    existence, unseen = objects.existence.copy(), objects.unseen.copy()
    owned = np.zeros(len(scan))
    evidence, recoveries = 0.0, 0
    for members, offered in zip(blocks_of(particles), offers, strict=True):
        rows, size = rows_of(members, n), len(members)
        mean = np.ascontiguousarray(particles.mean[:, :, members].reshape(count, 2 * size, d))
        cov = np.ascontiguousarray(particles.cov[:, rows[:, None], rows])
        there = existence[members] * chance[:, members]  # there and detected
        hit, miss = small.log(np.maximum(there, TINY)), small.log(np.maximum(1.0 - there, TINY))
        before = particles.log_weights[:, members[0]]
        gain = np.zeros(count)
        if scan.ids is not None:
            hit[:, chance[:, members].max(axis=0) == 0.0] = 0.0  # who is seen although nobody is expected to be
            seen = np.flatnonzero(found[members] >= 0)
            at = found[members[seen]]
            if s.engine == "bootstrap":
                recoveries += _recover(mean, seen, scan, at, rng)
            kernel.see(mean, cov, seen, scan.positions[at], scan.sd[at] ** 2, gain)
            hidden = np.setdiff1d(np.arange(size), seen)
            gain += hit[:, seen].sum(axis=1) + miss[:, hidden].sum(axis=1)
            detected = np.zeros((count, size), dtype=bool)
            detected[:, seen] = True
        else:
            choice = np.empty((count, size), dtype=np.int64)
            density = math.log(max(scan.clutter + scan.birth, TINY))
            offers_of, logs = (scan.positions[offered], scan.sd[offered] ** 2), (hit, miss, density)
            kernel.assign(mean, cov, offers_of, logs, s.hypotheses, GATE, u[:, members[0]].copy(), choice, gain)
            detected = choice >= 0
        after = before + gain
        top = after.max()
        after = after - top  # first: beside a large number the logarithm of how many there are is lost
        total = np.logaddexp.reduce(after)
        after = after - total
        evidence += float(top + total)
        weights = small.exp(after)
        still = np.where(
            detected, 1.0, exist(np.broadcast_to(existence[members], detected.shape), detected, chance[:, members])
        )
        existence[members] = np.clip(small.mean(weights, still), 0.0, 1.0)  # weights sum to 1 but for rounding
        if blind is not None:
            narrow(mean, cov, ~detected, members, blind)
        unseen[members] = np.where(small.mean(weights, detected.astype(np.float64)) >= 0.5, 0.0, unseen[members])
        if scan.ids is None:
            for k, j in enumerate(offered):
                owned[j] = (weights * np.any(choice == k, axis=1)).sum()
        particles.log_weights[:, members] = after[:, None]
        particles.mean[:, :, members] = mean.reshape(count, 2, size, d)
        particles.cov[:, rows[:, None], rows] = cov
    if scan.ids is None:
        fresh = np.flatnonzero(owned < 0.5)
    return objects._replace(existence=existence, unseen=unseen), fresh, evidence, recoveries


def _offers(objects: Objects, particles: Particles, scan: Detections) -> list[Ints]:
    """The detections each block may have: a detection is offered to the block of the object it fits best."""
    blocks = blocks_of(particles)
    if not blocks or not len(scan):
        return [np.zeros(0, dtype=np.int64) for _ in blocks]
    mean, cov = summary(particles)
    s = cov[:, :1] + scan.sd**2
    square = ((mean[:, None, 0] - scan.positions) ** 2).sum(axis=2) / s
    best = particles.block[square.argmin(axis=0)]
    return [np.flatnonzero(best == particles.block[members[0]]) for members in blocks]


def _recover(mean: Floats, seen: Ints, scan: Detections, at: Ints, rng: np.random.Generator) -> int:
    """Objects of which every sample is lost are drawn anew around their detections, in place; how many there were."""
    count = 0
    for i, j in zip(seen, at, strict=True):
        square = ((mean[:, i] - scan.positions[j]) ** 2).sum(axis=1)
        if square.min() > (LOST * scan.sd[j]) ** 2:
            mean[:, i] = scan.positions[j] + scan.sd[j] * rng.standard_normal(mean[:, i].shape)
            count += 1
    return count


def _sample(particles: Particles, rng: np.random.Generator) -> None:
    """Objects are drawn from their Gaussians, which become points, in place."""
    count, _, n, d = particles.mean.shape
    noise, states = rng.standard_normal((count, 2 * n, d)), particles.mean.reshape(count, 2 * n, d)  # a view
    for members in blocks_of(particles):
        rows = rows_of(members, n)
        cov = np.ascontiguousarray(particles.cov[:, rows[:, None], rows])
        kernel.draw(cov, np.arange(count), rows, noise, states)
    particles.cov[:] = 0.0


def _potentials(s: Settings, objects: Objects, particles: Particles, pairs: list[ParticlePairs], dt: float) -> None:
    """What related pairs look like weighs the particles in which they are related, in place."""
    for relation, p in zip(s.model.relations, pairs, strict=True):
        e = relation.evidence
        if e is None or not len(p.first):
            continue
        x, v = particles.mean[:, 0], particles.mean[:, 1]
        of = (x[:, p.second] - x[:, p.first], v[:, p.second] - v[:, p.first], v[:, p.first], v[:, p.second])
        flat = [np.ascontiguousarray(y.reshape(-1, y.shape[2])) for y in of]
        out = np.empty(len(flat[0]))
        seconds = looks(e, p.looked, dt)
        log_ratios(flat[0], flat[1], flat[2], flat[3], seconds, out)
        seen = (objects.unseen[p.first] == 0) & (objects.unseen[p.second] == 0)
        gain = np.where(p.bits & seen, seconds.share * out.reshape(p.bits.shape), 0.0)
        for k in np.flatnonzero(seen):
            particles.log_weights[:, particles.block == particles.block[p.first[k]]] += gain[:, k, None]


def _normalise(particles: Particles) -> None:
    logs = particles.log_weights
    if logs.shape[1]:
        logs -= logs.max(axis=0)
        logs -= np.logaddexp.reduce(logs, axis=0)


def _switch(
    s: Settings,
    relation: Relation,
    p: ParticlePairs,
    objects: Objects,
    particles: Particles,
    dt: float,
    rng: np.random.Generator,
) -> ParticlePairs:
    """Relations change given those of before and the objects of now (second factor of Eq. 1).

    What a switch tells of objects that are Gaussians becomes part of them, in place, pair after pair.
    """
    count, many = p.bits.shape
    _, _, n, d = particles.mean.shape
    u, bits = rng.random((many, count)), np.array(p.bits.T, order="C")
    chance = np.empty((2, many, count))
    known = objects.unseen <= relation.seen_within
    law = (*program(relation), switches(relation, dt))
    states = particles.mean.reshape(count, 2 * n, d)  # a view
    rows = {label: rows_of(np.flatnonzero(particles.block == label), n) for label in set(particles.block.tolist())}
    for k, (a, b) in enumerate(zip(p.first.tolist(), p.second.tolist(), strict=True)):
        sure = bool(known[a] and known[b])
        kernel.switch(
            states, particles.cov, (a, b), rows[int(particles.block[a])], law, sure, u[k], bits[k], *chance[:, k]
        )  # fmt: skip
    on, off = chance.transpose(0, 2, 1)
    weights = small.exp(particles.log_weights[:, p.first])
    before = (weights * p.bits).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_on = np.where(before < 1.0, (weights * ~p.bits * on).sum(axis=0) / (1.0 - before), 0.0)
        mean_off = np.where(before > 0.0, (weights * p.bits * off).sum(axis=0) / before, 0.0)
    mean_on, mean_off = np.clip(mean_on, 0.0, 1.0), np.clip(mean_off, 0.0, 1.0)
    after = np.clip((weights * np.where(p.bits, 1.0 - off, on)).sum(axis=0), 0.0, 1.0)
    about = s.model.activities_of(relation)
    stages = tuple(advance(x, before, mean_on, mean_off, dt, a) for x, a in zip(p.stages, about, strict=True))
    both = (objects.unseen[p.first] == 0) & (objects.unseen[p.second] == 0)
    return replace(p, p=after, looked=p.looked + dt * both, bits=np.ascontiguousarray(bits.T), stages=stages)


def _turnover(
    s: Settings,
    objects: Objects,
    particles: Particles,
    pairs: list[ParticlePairs],
    scan: Detections | None,
    fresh: Ints,
    serials: int,
    rng: np.random.Generator,
) -> tuple[Objects, Particles, list[ParticlePairs]]:
    """Objects leave and enter, pairs are let go and taken up, blocks follow; ``objects`` as the particles then say."""
    mean, cov = summary(particles)
    objects = objects._replace(mean=mean, cov=cov)
    stays, place = staying(objects, s.forget)
    if not stays.all():
        kept = np.flatnonzero(stays)
        rows = rows_of(kept, len(stays))
        objects = objects.keep(kept)
        particles = Particles(
            np.ascontiguousarray(particles.mean[:, :, kept]),
            np.ascontiguousarray(particles.cov[:, rows[:, None], rows]),
            particles.log_weights[:, kept],
            particles.block[kept],
        )
    old = len(objects.ids)
    if scan is not None and len(fresh):
        objects = enter(objects, scan, fresh, s.model, serials)
        particles = _join(particles, objects)
    near = candidates(objects.mean[:, 0], s.gate)
    edges, weights = _edges(s, objects, particles, near)
    before, particles = particles, regroup(particles, edges, weights, s.cluster)
    near = near[particles.block[near[:, 0]] == particles.block[near[:, 1]]]
    out = []
    for relation, p in zip(s.model.relations, pairs, strict=True):
        p, new = refresh(p, relation, s, objects, place, near)
        inside = particles.block[p.first] == particles.block[p.second]
        p, new = p.keep(inside), new[inside]
        u = rng.random(p.bits.shape)
        p.bits[:, new] = u[:, new] < p.p[new]
        _settle(relation, p, particles, np.flatnonzero(new & (np.maximum(p.first, p.second) >= old)))
        out.append(p)
    if s.engine == "bootstrap":
        _sample(particles, rng)
    same = stays.all() and old == len(objects.ids) and particles.log_weights is before.log_weights
    if s.engine == "bootstrap" or not same:
        mean, cov = summary(particles)
        objects = objects._replace(mean=mean, cov=cov)
    return objects, particles, out


def _join(particles: Particles, objects: Objects) -> Particles:
    """Particles with the objects that entered, each a block of its own."""
    count, _, old, _ = particles.mean.shape
    n, d = len(objects.ids), objects.mean.shape[2]
    mean, cov = np.empty((count, 2, n, d)), np.zeros((count, 2 * n, 2 * n))
    mean[:, :, :old] = particles.mean if old else 0.0
    mean[:, :, old:] = objects.mean[old:].transpose(1, 0, 2)
    rows = rows_of(np.arange(old), n)
    cov[:, rows[:, None], rows] = particles.cov
    new = np.arange(old, n)
    cov[:, new, new], cov[:, n + new, n + new] = objects.cov[new, 0], objects.cov[new, 2]
    cov[:, new, n + new] = cov[:, n + new, new] = objects.cov[new, 1]
    logs = np.concatenate([particles.log_weights, np.full((count, n - old), -math.log(count))], axis=1)
    first = particles.block.max() + 1 if old else 0
    return Particles(mean, cov, logs, np.concatenate([particles.block, first + np.arange(n - old)]))


def _edges(s: Settings, objects: Objects, particles: Particles, near: Ints) -> tuple[Ints, Floats]:
    """Ties that make blocks: pairs within the gate, or which may be as one of them is hidden and spread out."""
    n = len(objects.ids)
    unseen = np.flatnonzero(objects.unseen > 0)
    if len(unseen):
        reach = 3.0 * np.sqrt(np.maximum(objects.cov[:, 0], 0.0))
        apart = np.sqrt(((objects.mean[unseen, None, 0] - objects.mean[None, :, 0]) ** 2).sum(axis=2))
        maybe = apart - reach[unseen, None] - reach < s.gate
        maybe |= particles.block[unseen, None] == particles.block
        i, j = np.nonzero(maybe)
        more = np.sort(np.column_stack([unseen[i], j]), axis=1)
        near = np.concatenate([near, more[more[:, 0] != more[:, 1]]])
    if not len(near):
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0)
    near = np.unique(near[:, 0] * n + near[:, 1])
    edges = np.column_stack([near // n, near % n])
    return edges, ((objects.mean[edges[:, 0], 0] - objects.mean[edges[:, 1], 0]) ** 2).sum(axis=1)


def _settle(relation: Relation, p: ParticlePairs, particles: Particles, new: Ints) -> None:
    """New objects that start related: their velocities differ as those of long related objects do, in place."""
    settled = settled_variance(relation)
    if settled is None:
        return
    n = particles.mean.shape[2]
    for k in new:
        a, b, at = n + p.first[k], n + p.second[k], np.flatnonzero(p.bits[:, k])
        if not len(at):
            continue
        cov = particles.cov[at]
        column = cov[:, :, b] - cov[:, :, a]
        s = column[:, b] - column[:, a] + settled
        gain = column / s[:, None]
        flat = particles.mean[at].reshape(len(at), 2 * n, -1)
        flat = flat - gain[:, :, None] * (flat[:, b] - flat[:, a])[:, None]
        particles.mean[at] = flat.reshape(len(at), 2, n, -1)
        particles.cov[at] = cov - gain[:, :, None] * column[:, None]
