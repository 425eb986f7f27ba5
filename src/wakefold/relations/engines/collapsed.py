"""The engine "collapsed": objects by Kalman filters, the relation of each pair within the gate summed out.

A relation of a pair is a switching linear system of two modes (related or not) over the difference of the two objects,
kept as a few Gaussians in each mode; its cost is linear in the pairs. Several relations of one pair are each held
against "unrelated". Hidden objects are told from those they are related to.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wakefold.base import small
from wakefold.base.types import Floats
from wakefold.relations.activities import advance
from wakefold.relations.detections import Detections
from wakefold.relations.engines.association import TINY, associate
from wakefold.relations.engines.objects import Objects, Settings, enter, exist, match, objects_of
from wakefold.relations.engines.pairs import (
    candidates,
    looks,
    motions,
    program,
    refresh,
    relative_motions,
    staying,
    switches,
)
from wakefold.relations.kernels import objects as alone
from wakefold.relations.kernels import pairs as kernel
from wakefold.relations.kernels.histories import WIDTH
from wakefold.relations.model import Relation
from wakefold.relations.pairs import GaussianPairs
from wakefold.relations.scene import CollapsedScene

NONE = np.zeros(0)


def step(s: Settings, scene: CollapsedScene, scan: Detections | None, dt: float) -> CollapsedScene:
    """The scene after ``dt`` seconds and one scan; without a scan only time passes."""
    model, objects = s.model, objects_of(scene, scene.own_mean, scene.own_cov)
    believed, spread = np.array(scene.mean), np.array(scene.cov)
    moves = motions(model, objects.kinds, dt)
    alone.predict(objects.mean, objects.cov, moves)
    alone.predict(believed, spread, moves)
    hidden = objects.unseen > 0  # what its company tells of a hidden object is the better prediction
    objects.mean[hidden], objects.cov[hidden] = believed[hidden], spread[hidden]
    objects.unseen[:] += dt
    n = len(objects.ids)
    found, fresh, evidence = np.full(n, -1), np.zeros(0, np.int64), 0.0
    existence = objects.existence
    if scan is not None:
        chance = scan.chance(objects.mean[:, 0]) if n else NONE
        if scan.ids is not None:
            found, fresh = match(objects.ids, scan)
            there = np.where(found >= 0, np.where(chance > 0.0, existence * chance, 1.0), 1.0 - existence * chance)
            evidence = float(small.log(np.maximum(there, TINY)).sum())
            existence = exist(existence, found >= 0, chance)
        else:
            found, fresh, existence = associate(objects, scan, chance, s.hypotheses)
    seen = found >= 0
    z, variance = np.zeros((n, objects.mean.shape[2])), np.zeros(n)
    if scan is not None and seen.any():
        which = np.flatnonzero(seen)
        z[which], variance[which] = scan.positions[found[which]], scan.sd[found[which]] ** 2
        evidence += alone.update(objects.mean, objects.cov, which, z[which], variance[which])
        objects.unseen[which] = 0.0
    objects = objects._replace(existence=existence)
    pairs = [
        _step_pairs(s, r, p, objects, z, variance, seen, dt) for r, p in zip(model.relations, scene.pairs, strict=True)
    ]
    stays, place = staying(objects, s.forget)
    if not stays.all():
        objects = objects.keep(stays)
    if scan is not None:
        objects = enter(objects, scan, fresh, model, scene.serials)
    if model.relations:
        near = candidates(objects.mean[:, 0], s.gate)
        pairs = [refresh(p, r, s, objects, place, near)[0] for r, p in zip(model.relations, pairs, strict=True)]
    mean, cov = _with_company(s, pairs, objects)
    return CollapsedScene(
        model=model,
        ids=objects.ids,
        kinds=objects.kinds,
        serial=objects.serial,
        mean=mean,
        cov=cov,
        own_mean=objects.mean,
        own_cov=objects.cov,
        existence=objects.existence,
        unseen=objects.unseen,
        pairs=tuple(pairs),
        key=scene.key,
        step=scene.step + 1,
        serials=scene.serials + len(fresh),
        time=scene.time + dt,
        log_evidence=scene.log_evidence + evidence,
        recoveries=scene.recoveries,
    )


def _step_pairs(
    s: Settings,
    relation: Relation,
    pairs: GaussianPairs,
    objects: Objects,
    z: Floats,
    variance: Floats,
    seen: NDArray[np.bool_],
    dt: float,
) -> GaussianPairs:
    p, counts = np.array(pairs.p), np.array(pairs.counts)
    held = kernel.Held(pairs.first, pairs.second, p, counts, pairs.states)
    states = np.empty((len(pairs.states) + 2 * len(p), WIDTH))  # each mode may gain one
    seen_now = kernel.Seen(z, variance, seen, objects.unseen <= relation.seen_within, objects.mean, objects.cov)
    told = relation.couples is not None or relation.evidence is not None
    motions_of = relative_motions(s.model, relation, dt)
    law = kernel.Law(motions_of, switches(relation, dt), *program(relation), s.histories, told)
    switched = kernel.Switches(np.empty_like(p), np.empty_like(p), np.empty_like(p))
    many = kernel.step(held, seen_now, law, looks(relation.evidence, pairs.looked, dt), switched, states)
    about = s.model.activities_of(relation)
    stages = tuple(advance(x, *switched, dt, a) for x, a in zip(pairs.stages, about, strict=True))
    looked = pairs.looked + dt * (seen[pairs.first] & seen[pairs.second])
    return GaussianPairs(pairs.first, pairs.second, p, looked, stages, counts, states[:many])


def _with_company(s: Settings, pairs: list[GaussianPairs], objects: Objects) -> tuple[Floats, Floats]:
    """Position and velocity as believed: a hidden object is where its own motion or its company has taken it."""
    mean, cov = objects.mean.copy(), objects.cov.copy()
    unseen = objects.unseen > 0
    if not unseen.any() or not (~unseen).any():
        return mean, cov
    n, d = len(mean), mean.shape[2]
    weight, first, second = np.zeros((n, 2)), np.zeros((n, 2, d)), np.zeros((n, 2, 2))
    for relation, p in zip(s.model.relations, pairs, strict=True):
        if relation.couples is not None:
            held = kernel.Held(p.first, p.second, p.p, p.counts, p.states)
            kernel.hidden(held, unseen, objects.mean, objects.cov, weight, first, second)
    told = np.flatnonzero(weight[:, 0] > 0.0)
    if not len(told):
        return mean, cov
    alone = small.exp(weight[told, 1])  # the probability that no relation holds
    share = ((1.0 - alone) / weight[told, 0])[:, None]
    own = mean[told].copy()
    mean[told] = alone[:, None, None] * own + share[:, :, None] * first[told]
    moments = np.column_stack([second[told, 0, 0], second[told, 0, 1], second[told, 1, 1]])
    away = mean[told] - own
    pp, pv, vv = ((away[:, i] * away[:, j]).sum(axis=1) / d for i, j in ((0, 0), (0, 1), (1, 1)))
    cov[told] = alone[:, None] * cov[told] + share * moments - np.column_stack([pp, pv, vv])
    return mean, cov
