"""The memory of a model: what it says of an agent, kept on disk, and what is refused there."""

import math

import naive_trail as naive
import numpy as np
import pytest
from bounds import FALSE_ALARM
from made import bundles, routes, straight
from scipy.stats import binom

import wakefold as wf
from wakefold.base import store
from wakefold.base.compile import kernel
from wakefold.base.store import StoreError
from wakefold.filters.kernels import trail as kernel_module
from wakefold.model.kernels import recall
from wakefold.model.memory import Memory
from wakefold.model.model import load
from wakefold.model.remembering import _sight


@pytest.fixture(scope="module")
def model():
    return wf.learn(routes(0, 40)[0], sd=1.0)


def followed(f, track, count, **start):
    belief = f.start(fix=wf.Fix(track[0]), **start)
    for k in range(1, count):
        belief = f.step(belief, [wf.Fix(track[k])], dt=1.0)
    return belief


@kernel
def drawn(trails, past, member, seconds, reports, odds, seed, rows, out):
    """Past states of one member for a trail."""
    room = kernel_module._room(past)
    kernel_module._look(trails.times[0], trails.points[0], trails.who[0], trails.fixes[0], past, room)
    counts, dice = np.zeros(recall.MEMBERS, dtype=np.int64), np.full(1, seed, dtype=np.uint64)
    counts[member] = len(rows)
    used = len(room.use_map)
    recall.members(
        room.raw, past, used, room.ranges, room.depths, seconds, counts, reports, odds, dice, rows, out
    )  # fmt: skip
    return room.raw, room.to_map, room.to_own


@kernel
def split(shares, n, counts):
    recall.rounded(shares, n, counts)


@kernel
def between(past, strange, seconds, out):
    recall.shares_at(past, strange, seconds, out)


@pytest.mark.parametrize("told", [False, True])
@pytest.mark.parametrize("member", range(7))
def test_a_member_draws_each_past_state_as_often_as_it_should(model, member, told):
    """Within what chance may do to any of the states, once in 10,000 runs; and moves as the state did."""
    memory, past = model.memory, model.memory.past
    belief = followed(wf.Trail(model), model.tracks[0], 8)
    seconds, n = 4.0 * memory.step, 40_000
    reports = np.array([[0, 10], [5, 30]])[: 2 * told]
    odds = np.array([0.2, 4.0])[: 2 * told]
    rows, out = np.empty(n, dtype=np.int64), np.empty((n, 2))
    raw, to_map, to_own = drawn(belief.trails, past, member, seconds, reports, odds, 12345, rows, out)
    forest, x = (past.ways, to_map) if member < 3 else (past.own, to_own)
    g = np.array(
        [math.prod(o for (lo, hi), o in zip(reports, odds, strict=True) if not lo <= r < hi) for r in memory.rank]
    )
    chance = np.zeros(len(memory.points))
    if member == 6:
        alive = np.array([naive.steps_left(past, row) >= 4 for row in range(len(chance))])
        chance = 1.0 * alive * g[past.track]
    else:
        trees = len(forest.first_node) - 1
        for t in range(trees):
            ranges = naive.leaf_ranges(forest, t, x)
            _, alive = naive.neighbourhood(forest, past, ranges, 4, (1, 4, 16, 4, 16, 64)[member])
            for row in alive:
                chance[row] += g[past.track[row]] / len(alive)
    chance /= chance.sum()
    often = np.bincount(rows, minlength=len(chance))
    slack = 1e-3 * n if member == 6 and told else 0.0  # which gives up after so many tries
    some = np.flatnonzero(chance > 0)
    assert often[chance == 0].sum() <= slack
    error = FALSE_ALARM / len(some) / 2
    assert (often[some] >= binom.ppf(error, n, chance[some]) - slack).all()
    assert (often[some] <= binom.ppf(1 - error, n, chance[some]) + slack).all()
    if member < 3:
        np.testing.assert_allclose(out, raw[:2] + past.points[rows + 4] - past.points[rows], atol=1e-6)


def test_class_masses_are_the_sums_over_trees(model):
    past, tree, f = model.memory.past, model.filtration, wf.Trail(model)
    belief = followed(f, model.tracks[3], 9)
    level = float(tree.levels(3)[1])
    class_ = int(tree.alive(level)[0])
    told = f.step(belief, [wf.CoarseClass(class_, level, 0.7)], dt=0.0)
    _, to_map, _ = drawn(
        belief.trails, past, 0, 1.0, np.zeros((0, 2), dtype=np.int64), np.zeros(0), 1, np.empty(1, dtype=np.int64),
        np.empty((1, 2)),
    )  # fmt: skip
    odds = 0.3 / 0.7 / (len(tree.alive(level)) - 1)
    for b, reports in ((belief, []), (told, [(tree.lo[class_], tree.hi[class_], odds)])):
        wanted = naive.class_masses(past, to_map, len(past.ways.first_node) - 1, past.masses, reports, (1, 4, 16))
        np.testing.assert_allclose(b._masses, wanted, rtol=1e-9)


def test_shares_of_two_tracks_are_those_of_no_knowledge_and_of_the_track_that_is_followed():
    """Trees of two tracks of two directions hold one of them in each leaf: masses in closed form."""
    m = wf.learn(straight(((0, 0), (5, 0)), ((0, 900), (3, -4)), seconds=40), sd=1.0)
    belief = followed(wf.Trail(m), m.tracks[1], 20)
    masses = m.memory.masses
    assert belief.probability(1) == pytest.approx(1.0 - masses[-1] / 2, abs=0.05)
    assert belief.probability(1) <= 1.0 - masses[-1] / 2 + 1e-12


def test_counts_are_shares_rounded():
    rng = np.random.default_rng(0)
    for _ in range(200):
        shares, n = rng.dirichlet(np.full(7, 0.3)), int(rng.integers(1, 200))
        counts = np.empty(7, dtype=np.int64)
        split(shares, n, counts)
        assert counts.sum() == n
        assert (np.abs(counts - shares * n) <= 1.0 + 1e-9).all()


def test_shares_are_told_between_horizons_and_kinds(model):
    past = model.memory.past
    out = np.empty(7)
    for b, strange in enumerate(past.unusual):
        for h, seconds in enumerate(past.horizons):
            between(past, strange, seconds, out)
            np.testing.assert_allclose(out, past.shares[b, h], atol=1e-12)
    between(past, past.unusual[0] - 1.0, math.sqrt(past.horizons[0] * past.horizons[1]), out)
    np.testing.assert_allclose(out, past.shares[0, :2].mean(axis=0), atol=1e-9)
    between(past, past.unusual[-1], 1e9, out)
    np.testing.assert_allclose(out, past.shares[-1, -1], atol=1e-12)
    plain = np.eye(7)[-1]  # where nobody was before, places say nothing
    for times, share in ((1.5, 0.5), (2.0, 1.0), (1e9, 1.0)):
        between(past, times * past.unusual[-1], 1e9, out)
        np.testing.assert_allclose(out, (1 - share) * past.shares[-1, -1] + share * plain, atol=1e-12)


def test_trees_leave_out_every_block_about_as_often():
    for blocks in (3, 7, 10):
        sees = _sight(40, blocks, 0)
        left = (~sees).sum(axis=0)
        assert left.max() - left.min() <= 2
        assert (sees.any(axis=1)).all()
    for blocks in (1, 2):
        assert _sight(8, blocks, 0).all()


# Kept on disk


def test_a_memory_comes_back_to_the_bit(model, tmp_path):
    f = wf.Trail(model, seed=3)
    belief = followed(f, model.tracks[0], 6, time=1.6e9)
    belief = f.step(belief, [wf.CoarseClass(int(model.filtration.alive(20.0)[0]), 20.0)], dt=1.0)
    model.save(tmp_path / "model")
    belief.save(tmp_path / "belief")
    back = load(tmp_path / "model")
    read = wf.Belief.load(tmp_path / "belief", back.filtration)
    assert all((a == b).all() for a, b in zip(read.trails, belief.trails, strict=True))
    with pytest.raises(ValueError, match="on"):
        read.mean()
    g = wf.Trail(back, seed=3)
    for other in (read.on(back), g._own(read), g.step(read, [], dt=0.0)):
        mine = f.step(belief, [], dt=0.0) if other.step > belief.step else belief
        assert (other.points == mine.points).all()
        assert (other._masses == mine._masses).all()
        assert (other.time, other.ended, other.log_evidence) == (mine.time, mine.ended, mine.log_evidence)
        assert other.probability(None) == mine.probability(None)
    assert (g.forecast(read, 5.0).points == f.forecast(belief, 5.0).points).all()


def test_learning_does_not_depend_on_threads():
    tracks = routes(1, 30)[0]
    one, two = (wf.learn(tracks, sd=1.0).remember(threads=n) for n in (1, 2))
    for a, b in zip(one.packed()[0].values(), two.packed()[0].values(), strict=True):
        assert (a == b).all()


CHANGES = {
    "begins": lambda a: a + np.arange(len(a)),
    "points": lambda a: a[:-1],
    "going": lambda a: a.astype(np.float64),
    "lags": lambda a: a[::-1],
    "shares": lambda a: a * np.nan,
    "masses": lambda a: a - 1.0,
    "doubts": lambda a: a + 1.0,
    "unusual": lambda a: a.astype(np.float32),
    "ways_rows": lambda a: a + len(a),
    "ways_first_node": lambda a: a + 1,
    "ways_first_row": lambda a: a[::-1],
    "ways_nodes": lambda a: np.column_stack([a[:, :3], np.full(len(a), 2**30)]).astype(np.int32),
    "own_nodes": lambda a: np.full_like(a, 0xFFFF),
    "own_rows": lambda a: a - 1,
    "own_first_row": lambda a: a.astype(np.float64),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_memory_that_reaches_beyond_itself_is_refused(model, name):
    arrays, meta = model.memory.packed()
    with pytest.raises(ValueError, match=r"its|begin|shape|operand"):
        Memory.unpacked({**arrays, name: CHANGES[name](arrays[name])}, meta, model.filtration)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("step", 0.0),
        ("step", math.nan),
        ("unit", math.nan),
        ("slow", math.inf),
        ("base", 99),
        ("base", -1),
        ("dim", 0),
        ("dim", 3),
    ],
)
def test_numbers_of_a_memory_out_of_range_are_refused(model, name, value):
    arrays, meta = model.memory.packed()
    with pytest.raises(ValueError, match="its memory"):
        Memory.unpacked(arrays, {**meta, name: value}, model.filtration)


def test_a_memory_of_other_coordinates_is_refused(model, tmp_path):
    three = wf.learn(wf.Tracks.from_arrays([np.column_stack([t, t[:, 0]]) for t in model.tracks]), sd=1.0)
    arrays, meta = three.memory.packed()
    model.save(tmp_path / "model")
    own, told = store.load(tmp_path / "model", "model")
    mixed = {**own, **{f"memory_{key}": a for key, a in arrays.items()}}
    store.save(tmp_path / "mixed", mixed, {**told, "memory": meta}, "model")
    with pytest.raises(StoreError, match="sound model"):
        load(tmp_path / "mixed")


def test_damaged_trees_answer_something_or_are_refused(model):
    """Words, rows and begins changed at random: no read beyond an array, no endless way."""
    rng = np.random.default_rng(8)
    arrays, meta = model.memory.packed()
    belief, refused = followed(wf.Trail(model), model.tracks[0], 6), 0
    for _ in range(150):
        bad = {key: a.copy() for key, a in arrays.items()}
        name = str(rng.choice(["ways_nodes", "own_nodes", "ways_rows", "own_rows", "begins", "ways_first_row"]))
        flat = bad[name].reshape(-1)
        at = rng.integers(0, len(flat), 3)
        flat[at] = rng.integers(-(2**31), 2**31, 3) if rng.random() < 0.5 else flat[rng.permutation(at)] ^ 1
        try:
            memory = Memory.unpacked(bad, meta, model.filtration)
        except ValueError:
            refused += 1
            continue
        b = belief._of(belief.trails, memory=memory)
        assert np.isfinite(b.forecast(5.0).points).all()
        assert b._masses.sum() == pytest.approx(1.0)
    assert 10 < refused < 150


def test_a_stored_trail_that_is_none_is_refused(model, tmp_path):
    f = wf.Trail(model)
    belief = f.step(followed(f, model.tracks[0], 4), [wf.CoarseClass(0, 0.0)], dt=1.0)
    belief.save(tmp_path / "belief")
    arrays, meta = store.load(tmp_path / "belief", "belief")
    changes = {
        "times": -arrays["times"], "points": arrays["points"][0], "fixes": np.array([99]),
        "told": np.array([-1]), "sd": np.zeros(1), "odds": np.zeros_like(arrays["odds"]), "clock": np.array([np.nan]),
        "reports": arrays["reports"] + [0, 1000], "settings": np.array([-1.0, 5.0]), "step": np.array([1.0]),
    }  # fmt: skip
    for name, value in changes.items():
        store.save(tmp_path / "bad", {**arrays, name: np.ascontiguousarray(value)}, meta, "belief")
        with pytest.raises(StoreError, match="damaged"):
            wf.Belief.load(tmp_path / "bad", model.filtration)
    three = {**arrays, "points": np.zeros((1, 20, 3))}
    store.save(tmp_path / "bad", three, meta, "belief")
    read = wf.Belief.load(tmp_path / "bad", model.filtration)
    for ask in (lambda: read.on(model), lambda: f.step(read, [], dt=1.0)):
        with pytest.raises(ValueError, match="coordinates"):
            ask()


# Growth


def test_an_extended_memory_answers_nearly_as_one_learned_anew():
    """Of agents, half of the forecasts differ by under half of their spread; classes by under 0.1 on average."""
    first, second, third = (list(routes(seed, 25)[0]) for seed in (1, 2, 3))
    names = [f"t{k}" for k in range(75)]
    known = wf.learn(wf.Tracks.from_arrays(first, ids=names[:25]), sd=1.0)
    known.remember()
    twice = known.extend(wf.Tracks.from_arrays(second, ids=names[25:50]))
    twice = twice.extend(wf.Tracks.from_arrays(third, ids=names[50:]))
    anew = wf.learn(wf.Tracks.from_arrays(first + second + third, ids=names), sd=1.0)
    assert twice._memory
    asked, _ = routes(9, 20)
    level = float(anew.filtration.levels(3)[1])
    gaps, classes = [], []
    for track in asked:
        a, b = (followed(wf.Trail(m), track, 20) for m in (twice, anew))
        near, far = (wf.Trail(m).forecast(x, 6.0) for m, x in ((twice, a), (anew, b)))
        gaps.append(np.linalg.norm(near.mean() - far.mean()) / math.sqrt(np.trace(far.cov())))
        for c in anew.filtration.alive(level).tolist():
            members = anew.filtration.members(c).tolist()
            classes.append(abs(sum(a.probability(k) for k in members) - b.probability(c)))
    assert np.median(gaps) < 0.5
    assert np.mean(classes) < 0.1
    before = followed(wf.Trail(known), asked[0], 10, time=1.6e9)
    after = wf.Trail(twice).step(before.on(twice), [wf.Fix(asked[0][10])], dt=1.0)
    assert after.step == before.step + 1
    assert after.trails.fixes[0] == 11
    assert after.recoveries == 0


def test_reports_go_on_with_the_model_that_grew(model):
    f, tree = wf.Trail(model), model.filtration
    level = float(tree.levels(3)[1])
    class_ = int(tree.alive(level)[0])
    belief = f.step(followed(f, model.tracks[0], 4), [wf.CoarseClass(class_, level)], dt=1.0)
    large = model.extend(wf.Tracks.from_arrays(list(routes(8, 5)[0]), ids=[f"n{k}" for k in range(5)]))
    moved = belief.on(large)
    lo, hi = moved.trails.reports[0, 0]
    members = set(large.filtration.ids[large.filtration.order[lo:hi]].tolist())
    assert set(tree.ids[tree.members(class_)].tolist()) <= members
    assert (moved.trails.odds == belief.trails.odds).all()


def test_all_answers_of_bundles_of_any_dimension_are_numbers():
    for dim in (1, 2, 3):
        m = wf.learn(bundles(count=9, dim=dim), sd=1.0)
        for track in m.tracks:
            belief = followed(wf.Trail(m), track, len(track))
            assert np.isfinite(belief.forecast(2.0).points).all()
            assert 0.0 < belief.probability(None) < 1.0
