"""The memory of a model in slow and obvious loops: what its kernels are checked against."""

import math

import numpy as np

LEFT, RIGHT = 1 << 16, 1 << 17


def place(points, times, at):
    """Position on a track at a time; its ends before and after it."""
    return np.array([np.interp(at, times, points[:, k]) for k in range(points.shape[1])])


def raw_state(points, times, at, lags):
    here = place(points, times, at)
    parts = [here, [at - times[0], at], here - points[0]]
    return np.concatenate(parts + [here - place(points, times, at - lag) for lag in lags])


def features(raw, who, d, lags, base, slow, daily):
    """Of the map, and of the own frame."""
    now, age, time, start = raw[:d], raw[d], raw[d + 1], raw[d + 2 : 2 * d + 2]
    back = raw[2 * d + 2 :].reshape(len(lags), d)
    span = min(lags[base], age)
    velocity = back[base][:2] / span if span > 0 else np.zeros(2)
    speed = math.hypot(*velocity)
    c, s = velocity / speed if speed > 0 else (1.0, 0.0)

    def turned(v):
        return [v[0] * c + v[1] * s, v[1] * c - v[0] * s, *v[2:]]

    change = np.zeros(2)
    older = min(lags[base + 1], age) - min(lags[base], age)
    if older > 0:
        change = back[base][:2] / span - (back[base + 1][:2] - back[base][:2]) / older
    away = math.sqrt(sum(x * x for x in start))
    common = [*turned(change), c, s, math.log(speed + slow), age, away, time % 86400.0 if daily else 0.0, who]
    return (
        np.concatenate([now, now - start, common, back.ravel()]),
        np.concatenate([now, turned(start), common, *[turned(b) for b in back]]),
    )


def leaf_ranges(trees, tree, x):
    """Ranges of the rows on the way of features down a tree, from its root."""
    first, a, b = trees.first_row[tree], int(trees.first_row[tree]), int(trees.first_row[tree + 1])
    nodes = trees.nodes[trees.first_node[tree] : trees.first_node[tree + 1]]
    cuts = nodes.view(np.float32)
    out, node = [(a, b)], 0 if len(nodes) else -1
    while node >= 0:
        word, middle = int(nodes[node, 0]), int(first + nodes[node, 2])
        if x[word & 0xFFFF] <= cuts[node, 1]:
            b, node = middle, -1 if word & LEFT else node + 1
        else:
            a, node = middle, -1 if word & RIGHT else int(nodes[node, 3])
        out.append((a, b))
    return out


def steps_left(past, row):
    return int(past.begins[past.track[row] + 1]) - 1 - row


def neighbourhood(trees, past, ranges, ahead, need):
    """The rows of the smallest node with so many still on their way, and which of them these are."""
    for a, b in reversed(ranges):
        rows = trees.rows[a:b].tolist()
        alive = [row for row in rows if steps_left(past, row) >= ahead]
        if len(alive) >= need:
            break
    return rows, alive


def class_masses(past, x_map, trees, masses, reports, needs):
    """(M,) masses of leaf ranks, summed tree by tree; reports are (lo, hi, odds)."""
    out = np.full(len(past.rank), masses[-1] / len(past.rank))
    for m, need in enumerate(needs):
        for t in range(trees):
            rows, _ = neighbourhood(past.ways, past, leaf_ranges(past.ways, t, x_map), 0, need)
            for row in rows:
                out[past.rank[past.track[row]]] += masses[m] / trees / len(rows)
    for rank in range(len(out)):
        for lo, hi, odds in reports:
            out[rank] *= 1.0 if lo <= rank < hi else odds
    return out / out.sum()
