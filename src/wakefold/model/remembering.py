"""How a memory is learned: past states, forests over them, and how much each of their members is worth."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.base import small
from wakefold.base.parallel import thread_map
from wakefold.base.types import Bools, Floats, Ints, Singles
from wakefold.model.kernels import forest, recall, weighing
from wakefold.model.kernels.states import all_features, feature_count, futures, raw_length, states, targets

if TYPE_CHECKING:
    from wakefold.model.filtration import Filtration
    from wakefold.tracks.tracks import Tracks

Progress = Callable[[float], None]
UNITS = 16  # of time in the median track: lags and horizons are counted in them
LAGS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # units before now at which an agent's own way is compared
HORIZONS = (0.15, 0.5, 1.5, 4.0, 10.0, 20.0)  # units ahead that shares are learned for
GROWN = 2  # the first of them that forests are grown for
FINEST, COARSEST = 6, 2  # past states in a unit of time
FEW, MOST = 150_000, 300_000  # past states that are wanted, and kept at most: of more tracks, states farther apart
TREES = 32, 20  # of the map and of the own frame, for ``FEW`` states; of fewer states, up to
MORE = 4  # times as many
LEAVES = 2, 4
PLACES = 3.0, 2.0  # how much it counts in the map where a state is, and where its track began, beside where it goes
BLOCKS = 10  # of tracks one after the other, where there are not so many days
LEAST_BLOCKS = 3  # of fewer, every tree sees all, and nothing is held out
DAY = 86400.0
BACK, UNNAMED = 0.3, 0.2  # share of tracks of agents that come back; of tracks whose agents are held to be unknown
TRIED = slice(2, 4)  # horizons that velocities are tried to
ALIKE = 1.02  # of two velocities that go on about as well, the one over the longer lag has less noise
LEFT_OUT, KEPT = 0.3, 0.8  # share of the blocks that a tree does not see, and of the rows of the others that it does
ASKED, DRAWS = 1500, 20  # states that shares are learned from, and positions of each member
UNUSUAL = (0.0, 0.5, 0.8, 0.95, 1.0)  # quantiles of novelty between which shares are learned
BORROWED = 40  # questions of all kinds that are added to each of these
LEVELS = 3  # of classes that masses are learned for
DEFAULT = (0.2, 0.1, 0.1, 0.2, 0.2, 0.1, 0.1)  # shares where tracks are too few to learn any


class Seen(NamedTuple):
    """Past states (S,) of tracks, as they are compared, and what became of them.

    Attributes:
        begins: (M + 1,). track: (S,). raw: (S, .). points: (S, d).
        moves: (S, H, d) displacements to the horizons, or to the end. alive: (S, H) whether the track lasts so long.
    """

    begins: Ints
    track: Ints
    raw: Floats
    points: Floats
    moves: Floats
    alive: Bools

    @property
    def d(self) -> int:
        return self.points.shape[1]

    @classmethod
    def of(cls, tracks: Tracks, step: float, unit: float, lags: Floats) -> Seen:
        begins, track, at = _moments(tracks, step)
        raw, points = _raw(tracks, track, at, lags)
        ahead, row = unit * np.array(HORIZONS), np.arange(len(raw))
        moves = np.empty((len(raw), len(ahead), points.shape[1]))
        futures(points, begins, track, row, ahead, step, moves)
        alive = (begins[track + 1] - 1 - row)[:, None] * step >= ahead
        return cls(begins, track, raw, points, moves, alive)


def _moments(tracks: Tracks, step: float) -> tuple[Ints, Ints, Floats]:
    """First state (M + 1,) of each track, and the track and time (S,) of each state."""
    counts = (tracks.duration / step * (1 + 1e-12)).astype(np.int64) + 1
    begins = np.append(0, np.cumsum(counts))
    track = np.repeat(np.arange(len(tracks)), counts)
    number = np.arange(begins[-1]) - begins[track]
    return begins, track, tracks.times[tracks.offsets[track]] + step * number


def _raw(tracks: Tracks, track: Ints, at: Floats, lags: Floats) -> tuple[Floats, Floats]:
    """Raw states, and their positions."""
    points = tracks.points if tracks.dim > 1 else np.column_stack([tracks.points, np.zeros(len(tracks.points))])
    d = points.shape[1]
    raw = np.empty((len(track), raw_length(d, len(lags))))
    states(points, tracks.times, tracks.offsets, track, at, lags, raw)
    return raw, raw[:, :d].copy()


def lags_of(tracks: Tracks, unit: float) -> Floats:
    """Seconds before now at which ways are compared: of ``LAGS``, those that hold two steps of the tracks or more."""
    interval = tracks.median_interval
    finest = 0.0 if np.isnan(interval) else 2.0 * interval
    return np.array([lag * unit for lag in LAGS if lag * unit >= finest or lag > LAGS[0]])


def base_lag(seen: Seen, lags: Floats, ahead: Floats, longest: float) -> int:
    """Which of the lags up to the longest tells the velocity that goes on best, to the horizons ``TRIED``."""
    moves, alive, errors = seen.moves[:, TRIED, :2], seen.alive[:, TRIED], []
    for base in range(int(np.searchsorted(lags, longest, side="right"))):
        going = going_of(seen.raw, seen.d, lags, base).astype(np.float64)
        away = np.sqrt(((moves - ahead[TRIED, None] * going[:, None]) ** 2).sum(axis=2))
        known = alive & (seen.raw[:, seen.d, None] >= longest)
        means = [away[known[:, h], h].mean() if known[:, h].any() else 1.0 for h in range(known.shape[1])]
        errors.append(math.prod(means))
    return max(base for base, error in enumerate(errors) if error <= ALIKE * min(errors))


def going_of(raw: Floats, d: int, lags: Floats, base: int) -> Singles:
    """Velocity (S, 2) over the base lag, 0 of an agent that has just appeared."""
    span = np.minimum(lags[base], raw[:, d])
    way = raw[:, 2 * d + 2 + base * d : 2 * d + 4 + base * d]
    return np.divide(way, span[:, None], out=np.zeros_like(way), where=span[:, None] > 0).astype(np.float32)


def blocks_of(starts: Floats) -> Ints:
    """The block (M,) of each track by the time it starts: its day, or one of ``BLOCKS`` with as many tracks each."""
    days = np.floor((starts - starts.min()) / DAY).astype(np.int64)
    found = np.unique(days, return_inverse=True)[1]
    if found.max() + 1 >= BLOCKS // 2:
        return found
    rank = np.empty(len(starts), dtype=np.int64)
    rank[np.argsort(starts, kind="stable")] = np.arange(len(starts))
    return rank * min(BLOCKS, len(starts)) // len(starts)


def known_agents(tracks: Tracks) -> NDArray[np.str_]:
    """Names of the agents with several tracks, in order; none where they have under ``BACK`` of the tracks."""
    names, counts = np.unique(_names(tracks), return_counts=True)
    several = counts > 1
    return names[several] if counts[several].sum() >= BACK * len(tracks) else names[:0]


def numbers_of(tracks: Tracks, agents: NDArray[np.str_]) -> Floats:
    """The number (M,) of the agent of each track."""
    return numbers(_names(tracks), agents)


def numbers(names: NDArray[np.str_], agents: NDArray[np.str_]) -> Floats:
    """Numbers (n,) of names among agents in order, -1 of others: names near in order are often of one owner or kind."""
    if not len(agents):
        return np.full(len(names), -1.0)
    at = np.minimum(np.searchsorted(agents, names), len(agents) - 1)
    return np.where(agents[at] == names, at, -1).astype(np.float64)


def hidden(who: Floats) -> Floats:
    """Numbers of the agents of tracks (M,), some of which are held to be unknown: as agents met later are."""
    return np.where(np.random.default_rng(13).random(len(who)) < UNNAMED, -1.0, who)


def _names(tracks: Tracks) -> NDArray[np.str_]:
    own = tracks.attributes.get("agent")
    return tracks.ids if own is None else own.astype(np.str_)


def features_of(seen: Seen, who: Floats, lags: Floats, base: int, slow: float, daily: bool) -> tuple[Singles, Singles]:
    """Features of past states, of agents numbered ``who`` (S,), for the map and in the own frame."""
    shape = len(seen.raw), feature_count(seen.d, len(lags))
    to_map, to_own = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    all_features(seen.raw, who, seen.d, lags, base, slow, daily, to_map, to_own)
    return to_map, to_own


def targets_of(seen: Seen, lags: Floats, base: int, ahead: Floats) -> tuple[Singles, Singles]:
    """What the forests are grown for: where states are at the horizons from ``GROWN`` on, each number over its spread.

    Of a track that ends before, the map learns where; the own frame, which that tells nothing, the mean of the others.
    The map learns where states are now, too, which keeps ways apart that run side by side, and last where their tracks
    began: of that every second tree takes no notice (``forests_of``). Classes gain by it what forecasts lose.
    """
    moves, alive, ahead = seen.moves[:, GROWN:], seen.alive[:, GROWN:], ahead[GROWN:]
    residuals, out = np.empty_like(moves), []
    targets(seen.raw, seen.d, lags, base, moves, ahead, residuals)
    for every, known in ((moves, np.ones_like(alive)), (residuals, alive)):
        many = np.maximum(known.sum(axis=0), 1)[:, None]
        off = np.where(known[..., None], every - (every * known[..., None]).sum(axis=0) / many, 0.0)
        spread = np.sqrt((off**2).sum(axis=0) / many)
        out.append((off / np.where(spread > 0, spread, 1.0)).astype(np.float32).reshape(len(off), -1))
    places = seen.points, seen.points - seen.raw[:, seen.d + 2 : 2 * seen.d + 2]
    spread = float(np.sqrt(np.mean((seen.points - seen.points.mean(axis=0)) ** 2))) or 1.0
    for weight, place in zip(PLACES, places, strict=True):
        out[0] = np.column_stack([out[0], (weight / spread * (place - place.mean(axis=0))).astype(np.float32)])
    return out[0], out[1]


def forests_of(
    x: tuple[Singles, Singles],
    y: tuple[Singles, Singles],
    block: Ints,
    threads: int | None,
    progress: Progress | None,
    guides: tuple[recall.Trees, recall.Trees] | None = None,
    old: int = 0,
) -> tuple[tuple[recall.Trees, recall.Trees], tuple[Bools, Bools]]:
    """The forest of the map and that of the own frame, and the blocks (T, B) that each of their trees sees.

    Args:
        block: (S,) of each state.
        guides: forests that grow on by the states from ``old`` on, which are one more block.
    """
    blocks = int(block.max()) + 1
    more = min(max(FEW // len(block), 1), MORE)
    sizes = [trees * more for trees in TREES]
    if guides is not None:
        sizes = [len(guide.first_node) - 1 for guide in guides]
    sees = _sight(sizes[0], blocks, 0), _sight(sizes[1], blocks, 1)
    every = [(which, tree) for which in (0, 1) for tree in range(sizes[which])]
    here = np.ascontiguousarray(y[0][:, : -(y[1].shape[1] // (len(HORIZONS) - GROWN))])  # all but the start

    def one(which_tree: tuple[int, int]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        which, tree = which_tree
        rng = np.random.default_rng([which, tree])
        seen, guide = np.flatnonzero(sees[which][tree][block]), np.zeros((0, 4), dtype=np.int32)
        kept = np.zeros(0, dtype=np.int32)
        if guides is not None:
            kept, guide = _tree(guides[which], tree)
            rng = np.random.default_rng([which, tree, old])
            seen = old + np.arange(len(block) - old) if rng.random() >= LEFT_OUT else seen[:0]
        rows = (seen[rng.random(len(seen)) < KEPT] if len(block) > 100 else seen).astype(np.int32)
        rows = np.concatenate([kept, rows])
        nodes, seed = np.zeros((len(rows) + len(guide), 4), dtype=np.int32), 1 + which * 1000 + tree
        tried = x[which].shape[1] // (1 + which)
        wanted = here if which == 0 and tree % 2 else y[which]
        count = forest.grow(x[which], wanted, rows, LEAVES[which], tried, seed, guide, nodes, nodes.view(np.float32))
        return rows, nodes[:count].copy()

    grown = thread_map(one, every, threads, progress)
    return (_joined(grown[: sizes[0]]), _joined(grown[sizes[0] :])), sees


def _sight(trees: int, blocks: int, which: int) -> Bools:
    """Blocks (T, B) that trees see: each leaves out as many, and every block is left out about as often."""
    sees = np.ones((trees, blocks), dtype=bool)
    if blocks < LEAST_BLOCKS:
        return sees
    out = max(1, round(LEFT_OUT * blocks))
    rng = np.random.default_rng([7, which])
    turns = np.concatenate([rng.permutation(blocks) for _ in range(-(-trees * out // blocks))])
    for tree in range(trees):
        sees[tree, turns[tree * out : (tree + 1) * out]] = False
    return sees


def _joined(grown: list[tuple[NDArray[np.int32], NDArray[np.int32]]]) -> recall.Trees:
    rows, nodes = (list(part) for part in zip(*grown, strict=True))
    every = np.concatenate(nodes)
    first_node, first_row = (np.append(0, np.cumsum([len(part) for part in parts])) for parts in (nodes, rows))
    return recall.Trees(every, every.view(np.float32), np.concatenate(rows), first_node, first_row)


def _tree(trees: recall.Trees, tree: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Rows and nodes of one tree."""
    rows = trees.rows[trees.first_row[tree] : trees.first_row[tree + 1]]
    return rows, trees.nodes[trees.first_node[tree] : trees.first_node[tree + 1]].copy()


def weighed(
    past: recall.Past, tree: Filtration, seen: Seen, x: tuple[Singles, Singles], block: Ints, sees: tuple[Bools, Bools]
) -> dict[str, Floats] | None:
    """Shares, masses, novelty and doubts by what trees foretell of states in blocks that they do not see.

    None where these are too few to tell.
    """
    raw, moves, alive = seen.raw, seen.moves, seen.alive
    if block.max() + 1 < LEAST_BLOCKS:
        return None
    rng = np.random.default_rng(3)
    d = seen.d
    fit = np.flatnonzero((raw[:, d] > 0) & alive[:, 0])
    if len(fit) < 100:
        return None
    asked = np.sort(rng.choice(fit, min(ASKED, len(fit)), replace=False))
    use = [_unseen(each, block[asked]) for each in sees]
    members, horizons = recall.MEMBERS, len(HORIZONS)
    near, cross = np.zeros((len(asked), horizons, members)), np.zeros((len(asked), horizons, members, members))
    strange, known, plain = np.empty(len(asked)), np.zeros(len(asked)), np.zeros(len(asked))
    there = alive[asked]
    told = raw[asked], x[0][asked], x[1][asked]
    floor = 0.05 * past.slow * past.horizons[0]
    scores = near, cross, strange, known, plain
    weighing.held_out(*told, past, past.track[asked], moves[asked], there, *use, DRAWS, floor, *scores)
    edges = np.quantile(strange, UNUSUAL)
    centres = np.quantile(strange, (np.array(UNUSUAL[1:]) + UNUSUAL[:-1]) / 2)
    bin_of = np.clip(np.searchsorted(edges, strange, side="right") - 1, 0, len(centres) - 1)
    shares = np.tile(np.array(DEFAULT), (len(centres), horizons, 1))
    for h in range(horizons):
        for b in range(len(centres)):
            mine, every = there[:, h] & (bin_of == b), there[:, h]
            if every.sum() < BORROWED:
                continue
            weight = mine + every * min(1.0, BORROWED / every.sum())
            weighing.best_shares(
                (weight[:, None] * near[:, h]).sum(axis=0), (weight[:, None, None] * cross[:, h]).sum(axis=0),
                shares[b, h],
            )  # fmt: skip
    doubts = np.array([_doubt((known - plain)[there[:, weighing.KNOWN] & (bin_of == b)]) for b in range(len(centres))])
    doubts = np.maximum.accumulate(doubts)  # what is less known is not more certain
    if not (np.diff(centres) > 0).all():
        centres, shares, doubts = centres[-1:], shares[-1:], doubts[-1:]
    masses = _masses(past, tree, told[0], told[1], use[0], block, past.track[asked].astype(np.int64))
    return {"shares": shares, "unusual": centres, "doubts": doubts, "masses": masses}


def _doubt(gains: Floats) -> float:
    """The share of agents that go none of the ways known, from log-odds (n,) of their position if they do (EM)."""
    share, odds = 0.5, small.exp(np.clip(-gains, -50.0, 50.0))
    for _ in range(50):
        none = share * odds
        share = float((1.0 + (none / (none + 1.0 - share)).sum()) / (10.0 + len(gains)))  # as if 1 in 10 did before
    return share


def _unseen(sees: Bools, block: Ints) -> Ints:
    """Trees (n, t) that have not seen the block (n,) of a state, filled up with -1."""
    table = [np.flatnonzero(~sees[:, b]) for b in range(sees.shape[1])]
    most = max(len(trees) for trees in table)
    padded = np.array([np.pad(trees, (0, most - len(trees)), constant_values=-1) for trees in table])
    return padded[block]


def _masses(
    past: recall.Past, tree: Filtration, raw: Floats, x_map: Singles, use: Ints, block: Ints, track: Ints
) -> Floats:
    """Shares (4,) of members in class masses, under which the true classes are most probable (EM)."""
    blocks = np.zeros(len(tree), dtype=np.int64)  # of each leaf rank
    blocks[past.rank] = block[past.begins[:-1]]
    lo, hi, fallback = [], [], []
    for level in tree.levels(LEVELS):
        cuts = tree.cuts(float(level))
        at = np.searchsorted(cuts, past.rank[track], side="right") - 1
        lo.append(cuts[at])
        hi.append(cuts[at + 1])
        others = np.array([np.append(0, np.cumsum(blocks != b)) for b in range(int(block.max()) + 1)])
        own = block[past.begins[track]]
        fallback.append((others[own, hi[-1]] - others[own, lo[-1]]) / others[own, -1])
    low, high, base = np.stack(lo, axis=1), np.stack(hi, axis=1), np.stack(fallback, axis=1)
    out = np.empty((*base.shape, recall.MAP + 1))
    weighing.class_shares(raw, x_map, past, use, low, high, base, out)
    every = out[base > 0]  # classes that others than the block of the state have
    masses = np.full(recall.MAP + 1, 1.0 / (recall.MAP + 1))
    if len(every):
        for _ in range(100):
            joint = every * masses
            masses = (joint / joint.sum(axis=1, keepdims=True)).mean(axis=0)
    return np.maximum(masses, 1e-3) / np.maximum(masses, 1e-3).sum()
