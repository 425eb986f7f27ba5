"""The definitions, in slow and obvious loops: what the fast kernels are checked against."""

import itertools
import math
from itertools import pairwise

import numpy as np

# Tracks: stops, simplification, resampling


def stops(points, times, radius, duration):
    """(n,) bool: the points of stops, see `Tracks.segment`."""
    stopped = np.zeros(len(points), dtype=bool)
    i = 0
    while i < len(points):
        inside = [
            j for j in range(i, len(points)) if all(distance(points[k], points[i]) <= radius for k in range(i, j + 1))
        ]
        if times[inside[-1]] - times[i] >= duration:
            stopped[inside] = True
            i = inside[-1] + 1
        else:
            i += 1
    return stopped


def distance(p, q):
    return math.sqrt(sum((a - b) ** 2 for a, b in zip(p, q, strict=True)))


def distance_to_path(point, path):
    """Distance from a point to the nearest place on a polyline (n, d)."""
    best = min(distance(point, p) for p in path)
    for a, b in pairwise(path):
        chord = b - a
        if chord @ chord > 0:
            share = min(1.0, max(0.0, (point - a) @ chord / (chord @ chord)))
            best = min(best, distance(point, a + share * chord))
    return best


def douglas_peucker(points, tolerance):
    """Rows kept, by the recursion of Douglas and Peucker (1973)."""
    if len(points) <= 2:
        return list(range(len(points)))
    away = [distance_to_path(p, points[[0, -1]]) for p in points[1:-1]]
    if max(away) <= tolerance:
        return [0, len(points) - 1]
    split = 1 + away.index(max(away))
    left, right = douglas_peucker(points[: split + 1], tolerance), douglas_peucker(points[split:], tolerance)
    return left + [split + row for row in right[1:]]


# Distance and filtration


def frechet(a, b):
    """Discrete Fréchet distance, Eiter and Mannila (1994), Table 1, on distances (not squares)."""
    c = {}
    for i in range(len(a)):
        for j in range(len(b)):
            total = 0.0
            for x, y in zip(a[i].tolist(), b[j].tolist(), strict=True):
                total = total + (x - y) * (x - y)
            before = [c[cell] for cell in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if cell in c]
            c[i, j] = max(math.sqrt(total), min(before)) if before else math.sqrt(total)
    return c[len(a) - 1, len(b) - 1]


def components(distances, height):
    """Set of frozensets: the parts of the graph that joins tracks no further apart than the height."""
    parts = [{i} for i in range(len(distances))]
    for i in range(len(distances)):
        for j in range(i):
            if distances[i][j] <= height:
                (p,) = (part for part in parts if i in part)
                (q,) = (part for part in parts if j in part)
                if p is not q:
                    parts.remove(q)
                    p |= q
    return {frozenset(part) for part in parts}


def single_linkage(distances):
    """All classes as {frozenset of tracks: (birth, death)}, from the partition at every distance there is."""
    heights = sorted({float(d) for row in distances for d in row} | {0.0})
    out = {frozenset([i]): (0.0, math.inf) for i in range(len(distances))}
    for height in heights:
        parts = components(distances, height)
        for part in parts:
            out.setdefault(part, (height, math.inf))
        for part, (birth, death) in out.items():
            if death == math.inf and part not in parts:
                out[part] = (birth, height)
    return out


# Dynamics


def forward_difference(points, times):
    """(n, d) velocities: forward difference over time, the last repeats the one before, one point stands still."""
    out = np.zeros_like(points)
    for i in range(len(points) - 1):
        out[i] = (points[i + 1] - points[i]) / (times[i + 1] - times[i])
    if len(points) > 1:
        out[-1] = out[-2]
    return out


def local_velocity(z, members, epsilon, floor):
    """Velocity at z of a class, given its tracks as (points, velocities): Section 3.1 of the 2016 paper."""
    weight, total = 0.0, np.zeros(len(z))
    nearest, nearest_velocity = math.inf, None
    for points, velocities in members:
        for p, v in zip(points, velocities, strict=True):
            delta = distance(z, p)
            if delta < epsilon:
                weight += 1.0 / max(delta, floor)
                total += v / max(delta, floor)
            if delta < nearest:
                nearest, nearest_velocity = delta, v
    return total / weight if weight > 0 else nearest_velocity


# The multiscale hierarchy of particle filters: Algorithms 1 to 3 as docs/algorithm.md settles them


def resample(weights, positions):
    """Index of the particle at each position in [0, 1) of the cumulated weights."""
    edges = np.cumsum(weights) / np.sum(weights)
    return [min(int(np.sum(edges <= u)), len(weights) - 1) for u in positions]


def alive(tree, level):
    return [c for c in range(len(tree.birth)) if tree.birth[c] <= level < tree.death[c]]


def holds(tree, outer, inner):
    return set(tree.members(inner).tolist()) <= set(tree.members(outer).tolist())


def fix_weight(z, fix, family, sd, dof, diagonal):
    delta, d = distance(z, fix), len(z)
    if family == "log":
        return -math.log(min(max(delta / diagonal, 1e-4), 1.0))
    if family == "gaussian":
        return math.exp(-0.5 * (delta / sd) ** 2) / (math.sqrt(2 * math.pi) * sd) ** d
    scale = math.gamma((dof + d) / 2) / (math.gamma(dof / 2) * (dof * math.pi) ** (d / 2) * sd**d)
    return scale * (1 + (delta / sd) ** 2 / dof) ** (-(dof + d) / 2)


def coarse_weight(tree, c, named, level, family, confidence, diagonal):
    if family == "log":
        return -math.log(min(max(tree.tree_distance(c, named) / diagonal, 1e-4), 1.0))
    others = len(alive(tree, level)) - 1
    if others == 0:
        return 1.0
    return confidence if c == named else (1 - confidence) / others


def mhpf_step(tree, field, belief, evidence, used, rule, family, draws, h, dof, diagonal):
    """One step of MHPF; returns the base set, the coarse sets, the class masses and the log evidence.

    Args:
        field: function (position, class) -> velocity.
        belief: (points, classes, weights) of the base set.
        evidence: list of ("fix", position, sd) and ("coarse", class, level, confidence), in the order of use.
        used: inner classes that keep a set.
        draws: dict of positions (resampling), replace (list of (particle, class)), noise (N, d), and copy_noise, a
            function (class, particle) -> (d,).
        h: length of the step; one sub-step.
    """
    points, classes, weights = belief
    # Algorithm 1, lines 12-13: resample, replace classes
    kept = resample(weights, draws["positions"])
    points, classes = [points[i] for i in kept], [int(classes[i]) for i in kept]
    for particle, c in draws["replace"]:
        classes[particle] = c
    count = len(points)
    sets = {"base": [[z, c, 1.0 / count] for z, c in zip(points, classes, strict=True)]}
    # line 3 and Algorithm 2: the masses, up from the leaves
    mass = masses(tree, sets["base"])
    # lines 4-6: copies of the particles below each class, before propagation
    for c in used:
        sets[c] = [[z, c, w, i] for i, (z, leaf, w) in enumerate(sets["base"]) if holds(tree, c, leaf)]
    # lines 7-9: every particle moves under the dynamics of its class
    for i, x in enumerate(sets["base"]):
        x[0] = x[0] + h * field(x[0], x[1]) + draws["noise"][i]
    for c in used:
        for x in sets[c]:
            x[0] = x[0] + h * field(x[0], c) + draws["copy_noise"](c, x[3])
    # lines 10-11, Algorithm 3
    log_evidence = 0.0
    for item in evidence:
        if item[0] == "fix":
            observed = list(sets["base"])
            g = [fix_weight(x[0], item[1], family, item[2], dof, diagonal) for x in observed]
            observed_classes = list(range(len(tree)))
        else:
            _, named, level, confidence = item
            observed_classes = alive(tree, level)
            observed, g = [], []
            for c in observed_classes:
                members = sets[c] if c in sets else [x for x in sets["base"] if x[1] == c]
                observed += members
                g += [coarse_weight(tree, c, named, level, family, confidence, diagonal)] * len(members)
        before = sum(x[2] for x in observed)
        for x, factor in zip(observed, g, strict=True):
            x[2] *= factor
        after = sum(x[2] for x in observed)
        for x in observed:
            x[2] /= after
        log_evidence += math.log(after / before)
        # Algorithm 2: the observed classes from their weights, down by proportion, up by sums
        new = {}
        for c in observed_classes:
            new[c] = sum(x[2] for x in observed if x[1] == c)
        leaves = {}
        for leaf in range(len(tree)):
            above = next(c for c in observed_classes if holds(tree, c, leaf))
            leaves[leaf] = mass[leaf] * new[above] / mass[above] if mass[above] > 0 else 0.0
        after_mass = {c: sum(leaves[t] for t in tree.members(c).tolist()) for c in range(len(tree.birth))}
        ratio = {c: after_mass[c] / mass[c] if mass[c] > 0 else 0.0 for c in after_mass}
        seen = {id(x) for x in observed}
        for members in sets.values():
            for x in members:
                if rule == "arxiv2016" or id(x) not in seen:
                    x[2] *= ratio[x[1]]
        mass = after_mass
    total = sum(x[2] for x in sets["base"])
    for x in sets["base"]:
        x[2] /= total
    return sets, mass, log_evidence


def masses(tree, base):
    leaves = {t: sum(x[2] for x in base if x[1] == t) for t in range(len(tree))}
    return {c: sum(leaves[t] for t in tree.members(c).tolist()) for c in range(len(tree.birth))}


# Reading ------------------------------------------------------------------------------------------------------------


def clean_rows(rows, max_speed):
    """The rules of docs/reading.md on rows ``(agent, time, x, y)`` in the order of a file.

    Returns:
        Tracks in order of appearance of their agents, each a list of rows in order of time; how many rows were
        duplicates, at the same time elsewhere, and jumps.
    """
    counts = {"duplicate": 0, "same time": 0, "jump": 0}
    tracks = {}
    for row in rows:
        tracks.setdefault(row[0], []).append(row)
    for agent, track in tracks.items():
        kept = []
        for row in sorted(track, key=lambda r: r[1]):
            if kept and kept[-1][1] == row[1]:
                counts["duplicate" if kept[-1][2:] == row[2:] else "same time"] += 1
            else:
                kept.append(row)
        tracks[agent] = kept
    more = {}
    for agent, track in tracks.items():
        first, *others = sorted(bodies(track, max_speed), key=lambda strand: -len(strand))
        tracks[agent] = first
        for k, other in enumerate(others):
            if len(other) >= 3:
                more[f"{agent}#{k + 2}"] = other
            else:
                counts["jump"] += len(other)
    return tracks | more, counts


def bodies(track, max_speed, most=8):
    """Rows of one agent in order of time, taken apart into strands without a leg above ``max_speed``."""
    strands, waiting = [], []
    for row in track:
        near = [
            (math.dist(strand[-1][2:], row[2:]), k)
            for k, strand in enumerate(waiting)
            if math.dist(strand[-1][2:], row[2:]) <= max_speed * (row[1] - strand[-1][1])
        ]
        if near:
            waiting[min(near)[1]].append(row)
            continue
        strands.append([row])
        if len(waiting) < most:
            waiting.append(strands[-1])
        else:
            waiting[min(range(most), key=lambda k: waiting[k][-1][1])] = strands[-1]
    return strands


# Relations ----------------------------------------------------------------------------------------------------------


def pair_motion(related, q, k, noise, dt, parts=2000):
    """Transition and noise of two objects on one axis, state (x1, x2, v1, v2), by small steps of the diffusion."""
    a = np.zeros((4, 4))
    a[0, 2] = a[1, 3] = 1.0
    diffusion = np.diag([0.0, 0.0, q**2, q**2])
    if related:
        # w = v2 - v1: dw = -k w dt + noise dW; the centre (v1 + v2) / 2 diffuses as that of two independent objects
        a[2:, 2:] = [[-k / 2, k / 2], [k / 2, -k / 2]]
        centre, apart = q**2 / 2, noise**2 / 4
        diffusion[2:, 2:] = [[centre + apart, centre - apart], [centre - apart, centre + apart]]
    h = dt / parts
    step = np.eye(4) + a * h + a @ a * h**2 / 2
    f, w = np.eye(4), np.zeros((4, 4))
    for _ in range(parts):
        w = step @ w @ step.T + diffusion * h
        f = step @ f
    return f, w


def relation_by_enumeration(fixes, dt, sd, q, speed, k, noise, prior, on, off):
    """P(related at the last fix) for two objects always seen, over all histories of the relation; their log evidence.

    Args:
        fixes: (T, 2, d).
        on, off: probabilities of switching in a step.
    """
    motions = [pair_motion(r, q, k, noise, dt) for r in (False, True)]
    d = fixes.shape[2]
    h = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0]])
    odds = {False: [], True: []}
    for history in itertools.product([False, True], repeat=len(fixes)):
        log = math.log(prior if history[0] else 1 - prior)
        mean = np.zeros((4, d))
        mean[:2] = fixes[0]
        cov = np.diag([sd**2, sd**2, speed**2, speed**2])
        if history[0]:  # long related: w has its law of the long run
            c = np.array([0, 0, -1.0, 1.0])
            gain = cov @ c / (c @ cov @ c + noise**2 / (2 * k))
            mean, cov = mean - np.outer(gain, c @ mean), cov - np.outer(gain, c @ cov)
        for before, after, z in zip(history[:-1], history[1:], fixes[1:], strict=True):
            f, w = motions[before]
            mean, cov = f @ mean, f @ cov @ f.T + w
            s = h @ cov @ h.T + sd**2 * np.eye(2)
            away = z - h @ mean
            log -= 0.5 * (d * np.linalg.slogdet(2 * np.pi * s)[1] + np.sum(away * np.linalg.solve(s, away)))
            gain = cov @ h.T @ np.linalg.inv(s)
            mean, cov = mean + gain @ away, cov - gain @ h @ cov
            change = off if before else on
            chance = change if before != after else 1 - change
            log += math.log(chance) if chance > 0 else -math.inf
        odds[history[-1]].append(log)
    logs = {r: np.logaddexp.reduce(odds[r]) for r in odds}
    total = np.logaddexp(logs[False], logs[True])
    return math.exp(logs[True] - total), total


def kalman_fixes(fixes, dt, sd, q, speed):
    """Kalman filter of one object at nearly constant velocity: means (T, 2, d), covariances (T, 2, 2), log evidence."""
    d, log = fixes.shape[1], 0.0
    f = np.array([[1.0, dt], [0.0, 1.0]])
    w = q**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    mean, cov = np.stack([fixes[0], np.zeros(d)]), np.diag([sd**2, speed**2])
    means, covs = [mean], [cov]
    for z in fixes[1:]:
        mean, cov = f @ mean, f @ cov @ f.T + w
        s = cov[0, 0] + sd**2
        away = z - mean[0]
        log -= 0.5 * (d * math.log(2 * math.pi * s) + np.sum(away**2) / s)
        gain = cov[:, 0] / s
        mean, cov = mean + np.outer(gain, away), cov - np.outer(gain, cov[0])
        means.append(mean)
        covs.append(cov)
    return np.array(means), np.array(covs), log


def faded_looks(relative, speeds, seen, dts, evidence):
    """Log-odds that looks at a pair add up to, t seconds of both being seen counting as t^(1 - fade).

    Args:
        relative: (T, 2, 2) position and velocity of one to the other after each step.
        speeds: (T, 2) of both.
        seen: (T,) whether both were detected.
        dts: (T,) seconds of each step.
    """

    def cell(edges, value):
        inside = [i for i in range(len(edges) - 1) if edges[i] <= value < edges[i + 1]]
        return inside[0] if inside else len(edges) - 2

    total, looked = 0.0, 0.0
    for (u, w), (one, other), both, dt in zip(relative, speeds, seen, dts, strict=True):
        if both:
            i = cell(evidence.distance, math.hypot(*u))
            j = cell(evidence.relative_speed, math.hypot(*w))
            k = cell(evidence.speed, 0.5 * (one + other))
            after = looked + dt
            total += evidence.log_ratio[i, j, k] * (after ** (1 - evidence.fade) - looked ** (1 - evidence.fade))
            looked = after
    return total
