"""Extremely randomised trees over past states (Geurts, Ernst and Wehenkel 2006), kept as intervals.

The rows of a tree stand in the order of its leaves, so that every node is a range of them: a neighbourhood of any size
is found on one way down. Inner nodes are four words in preorder, the left child right behind its parent: the feature
and, in bits 16 and 17, whether the left and the right child are leaves; the cut (bits of a float32; at most that goes
left); where the right child's rows begin; the right child.
"""

import numpy as np

from wakefold.base.compile import inner, kernel

FEATURE, LEFT, RIGHT = 0xFFFF, 1 << 16, 1 << 17
DEEPEST = 60
SHOWN = 256  # rows that a cut of a larger node is chosen by
FRACTION = 2.0**-53


@inner
def uniform(dice):
    """The next number of a small generator (xorshift64*, Marsaglia 2003; Vigna 2016), in [0, 1)."""
    x = dice[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    dice[0] = x
    return np.float64((x * np.uint64(0x2545F4914F6CDD1D)) >> np.uint64(11)) * FRACTION


@inner
def _cut(x, y, rows, a, b, leaf, dice, names, tried, sums):
    """The best of ``tried`` random cuts of the rows a..b, by how much targets vary less: feature (-1: none), cut."""
    m = b - a
    if m > SHOWN:
        for i in range(SHOWN):
            j = a + i + int(uniform(dice) * (m - i))
            rows[a + i], rows[j] = rows[j], rows[a + i]
        m = SHOWN
    outputs = y.shape[1]
    total, left = sums[0], sums[1]
    for o in range(outputs):
        total[o] = 0.0
        for i in range(a, a + m):
            total[o] += y[rows[i], o]
    best, chosen, cut, seen = -1.0, -1, np.float32(0.0), 0
    for k in range(len(names)):
        j = k + int(uniform(dice) * (len(names) - k))
        names[k], names[j] = names[j], names[k]
        f = names[k]
        low = high = x[rows[a], f]
        for i in range(a + 1, a + m):
            v = x[rows[i], f]
            if v < low:
                low = v
            elif v > high:
                high = v
        if not high > low:
            continue
        at = np.float32(low + uniform(dice) * (high - low))
        if not at < high:
            at = low
        for o in range(outputs):
            left[o] = 0.0
        n = 0
        for i in range(a, a + m):
            if x[rows[i], f] <= at:
                n += 1
                for o in range(outputs):
                    left[o] += y[rows[i], o]
        gain = 0.0
        for o in range(outputs):
            right = total[o] - left[o]
            gain += left[o] * left[o] / n + right * right / (m - n)
        if gain > best:
            best, chosen, cut = gain, f, at
        seen += 1
        if seen >= tried:
            break
    return chosen, cut


@kernel
def grow(x, y, rows, leaf, tried, seed, guide, nodes, cuts):
    """One tree: orders ``rows`` (n,) by leaves and fills ``nodes`` (n, 4), of which ``cuts`` is the float32 view.

    Args:
        x: (S, F) features. y: (S, O) targets, of like scale.
        leaf: a node of fewer than twice so many rows is not cut.
        tried: features a cut is chosen from.
        guide: nodes of a tree whose cuts are kept, (k, 4): it grows on where it ends.

    Returns:
        how many nodes.
    """
    dice = np.array([np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0x632BE59BD9B4E019)])
    names, sums = np.arange(x.shape[1]), np.empty((2, y.shape[1]))
    known = guide.view(np.float32)
    todo = np.empty((2 * DEEPEST + 8, 6), dtype=np.int64)  # first and last row, parent, side, node of the guide, depth
    todo[0] = 0, len(rows), -1, 0, (0 if len(guide) else -1), 0
    waiting, made = 1, 0
    while waiting:
        waiting -= 1
        a, b, parent, side, led, depth = todo[waiting]
        feature, cut = -1, np.float32(0.0)
        if led >= 0:
            feature, cut = guide[led, 0] & FEATURE, known[led, 1]
        elif b - a >= 2 * leaf and depth < DEEPEST:
            feature, cut = _cut(x, y, rows, a, b, leaf, dice, names, tried, sums)
        if feature < 0:
            if parent >= 0:
                nodes[parent, 0] |= RIGHT if side else LEFT
            continue
        i, j = a, b - 1
        while i <= j:
            if x[rows[i], feature] <= cut:
                i += 1
            else:
                rows[i], rows[j] = rows[j], rows[i]
                j -= 1
        node = made
        made += 1
        if side:
            nodes[parent, 3] = node
        nodes[node, 0], nodes[node, 2], nodes[node, 3] = feature, i, -1
        cuts[node, 1] = cut
        on_left = on_right = -1
        if led >= 0:
            on_left = -1 if guide[led, 0] & LEFT else led + 1
            on_right = -1 if guide[led, 0] & RIGHT else guide[led, 3]
        todo[waiting] = i, b, node, 1, on_right, depth + 1
        todo[waiting + 1] = a, i, node, 0, on_left, depth + 1
        waiting += 2
    return made


@inner
def descend(x, trees, tree, begins, ends):
    """The way of features (F,) down a tree: ranges of its rows ``begins``, ``ends`` (DEEPEST + 2,); their number."""
    first = trees.first_row[tree]
    a, b = first, trees.first_row[tree + 1]
    node, last = trees.first_node[tree], trees.first_node[tree + 1]
    base = node
    begins[0], ends[0], depth = a, b, 1
    if node == last:  # a single leaf
        return depth
    while True:
        word, middle = trees.nodes[node, 0], min(max(first + trees.nodes[node, 2], a), b)
        if x[word & FEATURE] <= trees.cuts[node, 1]:
            b = middle
            final = word & LEFT
            node += 1
        else:
            a = middle
            final = word & RIGHT
            node = base + trees.nodes[node, 3]
        begins[depth], ends[depth] = a, b
        depth += 1
        if final or depth > DEEPEST:
            return depth
