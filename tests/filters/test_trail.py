"""The trail filter: small cases that can be told beforehand, steps, late fixes, thinning and reports."""

import copy
import math
import pickle

import numpy as np
import pytest
from made import bundles, routes, straight

import wakefold as wf
from wakefold.filters.kernels.trail import REPORTS, SLOTS


@pytest.fixture(scope="module")
def model():
    return wf.learn(routes(0, 60)[0], sd=1.0)


@pytest.fixture(scope="module")
def two():
    """Two tracks far apart, of two directions."""
    return wf.learn(straight(((0, 0), (5, 0)), ((0, 900), (3, -4))), sd=1.0)


def followed(f, track, count, first=0, **start):
    belief = f.start(fix=wf.Fix(track[first]), **start)
    for k in range(first + 1, first + count):
        belief = f.step(belief, [wf.Fix(track[k])], dt=1.0)
    return belief


def same(a, b, but=()):
    """Whether two trails are the same to the bit in all that counts."""
    n, m = int(a.trails.fixes[0]), int(a.trails.told[0])
    rows = {"times": n, "points": n, "reports": m, "odds": m}
    return all(
        (getattr(a.trails, name)[0, : rows[name]] == getattr(b.trails, name)[0, : rows[name]]).all()
        if name in rows
        else (getattr(a.trails, name) == getattr(b.trails, name)).all()
        for name in a.trails._fields
        if name not in but
    )


# Small cases


def test_an_agent_on_one_of_two_tracks_goes_where_it_goes(two):
    f = wf.Trail(two, seed=1)
    for which in (0, 1):
        belief = followed(f, two.tracks[which], 6)
        assert belief.probability(which) > 0.9
        assert belief.map(0.0) == which
        for seconds in (1.0, 5.0, 12.0):
            ahead = f.forecast(belief, seconds)
            truth = two.tracks[which][5] + (two.tracks[which][1] - two.tracks[which][0]) * seconds
            np.testing.assert_allclose(ahead.mean(), truth, atol=1.5)
            assert ahead.points.shape == (f.samples, 2)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_a_single_track_in_any_space(dim):
    velocity = np.array([2.0, 1.0, -0.5])[:dim]
    one = wf.learn(straight((np.zeros(dim), velocity)), sd=0.5)
    f = wf.Trail(one)
    belief = followed(f, one.tracks[0], 5)
    assert belief.probability(0) == pytest.approx(1.0, abs=1e-12)
    assert belief.points.shape == (f.samples, dim)
    np.testing.assert_allclose(f.forecast(belief, 6.0).mean(), 10 * velocity, atol=0.3)
    assert belief.cov().shape == (dim, dim)
    assert math.isfinite(belief.log_evidence)


def test_evidence_of_one_coordinate_is_a_density_of_one():
    """Metres told as kilometres: the density is a thousand times as high for each fix, not a million times."""
    rows = [np.linspace(0, 400, 20) + k for k in range(3)]
    logs = []
    for scale in (1.0, 1024.0):
        m = wf.learn(wf.Tracks.from_arrays([scale * row[:, None] for row in rows]), sd=scale)
        logs.append(followed(wf.Trail(m), m.tracks[0], 5).log_evidence)
    assert logs[0] - logs[1] == pytest.approx(4 * math.log(1024.0), abs=0.5)


@pytest.mark.parametrize(
    "tracks",
    [
        [np.zeros((1, 2)), np.full((1, 2), 50.0)],  # single points
        [np.full((6, 2), 3.0), np.full((6, 2), 9.0)],  # at rest
        [np.arange(12.0).reshape(6, 2)] * 3,  # all the same
        [np.zeros((1, 2))],
    ],
)
def test_odd_tracks_are_answered(tracks):
    m = wf.learn(wf.Tracks.from_arrays(tracks), sd=1.0)
    f = wf.Trail(m, seed=3)
    for belief in (f.start(), followed(f, m.tracks[0], min(3, len(tracks[0])))):
        later = f.step(belief, [], dt=2.0)
        for b in (belief, later, *([f.forecast(belief, f.limit)] if f.limit else [])):
            assert np.isfinite(b.points).all()
            assert np.isfinite(b.mean()).all()
            assert sum(b.probability(k) for k in range(len(tracks))) == pytest.approx(1.0, abs=1e-12)
            assert 0.0 <= b.probability(None) <= 1.0
            assert 0.0 <= b.ended <= 1.0
        with pytest.raises(ValueError, match="too far ahead"):
            f.forecast(belief, f.limit + 1.0)


def test_tracks_of_the_same_time_are_as_good_as_others(two):
    """Times of tracks are their own: shifted by hours, they say the same."""
    arrays = [two.tracks[0], two.tracks[1]]
    times = [np.arange(21.0), np.arange(21.0) + 7200.0]
    other = wf.learn(wf.Tracks.from_arrays(arrays, times), sd=1.0)
    a, b = (followed(wf.Trail(m, seed=1), two.tracks[0], 5) for m in (two, other))
    assert a.probability(0) == pytest.approx(b.probability(0), abs=1e-9)


# Steps


def test_a_step_leaves_the_belief_before_as_it_was(model):
    f = wf.Trail(model)
    belief = followed(f, model.tracks[0], 4)  # was never told a time
    before, told = copy.deepcopy(belief.trails), belief.mean()
    for given in ({"time": 1.6e9}, {"dt": 3.0}, {"dt": 0.0}):
        f.step(belief, [wf.Fix(model.tracks[0][4]), wf.CoarseClass(model.filtration.root)], **given)
        assert all((a == b).all() for a, b in zip(before, belief.trails, strict=True))
    assert (told == belief.mean()).all()
    moved = f.step(belief, [wf.Fix(model.tracks[0][4])], time=1.6e9)
    assert moved.time == 1.6e9
    np.testing.assert_allclose(np.diff(moved.trails.times[0, :4]), 1.0, atol=1e-6)


def test_the_last_fix_of_a_moment_holds(model):
    f, at = wf.Trail(model), model.tracks[0]
    belief = followed(f, at, 4)
    twice = f.step(f.step(belief, [wf.Fix(at[4] + 1.0)], dt=1.0), [wf.Fix(at[4] + 2.0), wf.Fix(at[4])], dt=0.0)
    once = f.step(belief, [wf.Fix(at[4])], dt=1.0)
    assert same(twice, once, but=("step",))


def test_late_fixes_are_put_in_their_place(model):
    f, at = wf.Trail(model, seed=2), model.tracks[0]
    order, late = [0, 1, 2, 3, 4, 5, 6, 7], [0, 1, 4, 2, 3, 7, 5, 6]
    beliefs = []
    for numbers in (order, late):
        belief = f.start(time=100.0)
        for k in numbers:
            belief = f.step(belief, [wf.Fix(at[k], sd=1.0 + k)], time=100.0 + k)
            assert belief.time == 100.0 + max(numbers[: numbers.index(k) + 1])
        beliefs.append(belief)
    assert same(*beliefs)
    a, b = (f.forecast(belief, 4.0) for belief in beliefs)
    assert (a.points == b.points).all()
    assert a.log_evidence == b.log_evidence
    with pytest.raises(ValueError, match="runs backwards"):
        f.step(beliefs[0], [wf.Fix(at[0])], time=107.0 - f.window - 1e-3)
    f.step(beliefs[0], [wf.Fix(at[0])], time=107.0 - f.window)


def test_thinning_keeps_the_first_the_last_and_even_ratios(model):
    f = wf.Trail(model)
    f.fastest = math.inf
    belief = f.start(fix=wf.Fix((0.0, 0.0)), time=0.0)
    for k in range(1, 3000):
        belief = f.step(belief, [wf.Fix((float(k), 0.0))], time=float(k))
        times = belief.trails.times[0, : belief.trails.fixes[0]]
        assert times[0] == 0.0
        assert times[-1] == k
        assert (np.diff(times) > 0).all()
    assert len(times) == SLOTS
    assert (belief.trails.points[0, :, 0] == times).all()
    ages = k - times[:-1]
    assert (ages[:-1] / ages[1:] < 4.0).all()  # two thirds of an octave each would be even


def test_a_belief_is_small(model):
    belief = followed(wf.Trail(model), model.tracks[0], 5)
    assert sum(column.nbytes for column in belief.trails) <= 1000


def test_steps_and_forecasts_of_a_forecast_go_on_from_there(model):
    f = wf.Trail(model)
    belief = followed(f, model.tracks[0], 8, time=50.0)
    twice, once = f.forecast(f.forecast(belief, 2.0), 3.0), f.forecast(belief, 5.0)
    assert (twice.points == once.points).all()
    assert twice.time == once.time == 62.0
    assert f.step(once, [], dt=1.0).time == 63.0
    on = f.step(f.forecast(belief, 2.0), [wf.Fix(model.tracks[0][9])], dt=0.0)
    assert same(on, f.step(belief, [wf.Fix(model.tracks[0][9])], dt=2.0))
    for wrong in (-1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="horizon"):
            belief.forecast(wrong)


@pytest.mark.parametrize("seconds", [1e6, 1e25, 1e300])
def test_gaps_of_any_length(model, seconds):
    f = wf.Trail(model)
    belief = f.step(followed(f, model.tracks[0], 5), [], dt=seconds)
    assert (np.abs(belief.points) < 2000.0).all()  # no farther than in the longest of past voyages
    assert np.abs(belief.probability(None) - 0.5) <= 0.5
    assert 0.5 < belief.ended <= 1.0
    again = f.step(belief, [wf.Fix(model.tracks[0][5])], dt=1.0)
    assert np.isfinite(again.mean()).all()
    assert np.isfinite(f.step(f.start(), [], dt=seconds).points).all()
    with pytest.raises(ValueError, match="finite"):
        f.step(f.step(f.start(), [], dt=1.7e308), [], dt=1.7e308)


def test_a_jump_begins_a_new_trail(model):
    f = wf.Trail(model)
    belief = followed(f, model.tracks[0], 5)
    jumped = f.step(belief, [wf.Fix((1e5, 1e5))], dt=1.0)
    assert (belief.recoveries, jumped.recoveries) == (0, 1)
    assert jumped.trails.fixes[0] == 1
    assert np.linalg.norm(jumped.mean() - 1e5) < 1.0


def test_the_same_seed_gives_the_same_bits_and_other_agents_others(model):
    f, at = wf.Trail(model, seed=5), model.tracks[0]
    a, b = (f.forecast(followed(f, at, 6, agent="a"), 4.0) for _ in range(2))
    c = f.forecast(followed(f, at, 6, agent="b"), 4.0)
    assert (a.points == b.points).all()
    assert (a.points != c.points).any()
    assert (a._masses == c._masses).all()
    for other in (pickle.loads(pickle.dumps(a)), copy.deepcopy(a), copy.copy(a)):  # noqa: S301 -- to workers
        assert (other.points == a.points).all()
        assert (other.time, other.ahead, other.step) == (a.time, a.ahead, a.step)
        assert other.level(10.0).probability.tolist() == a.level(10.0).probability.tolist()


# Reports


def test_a_report_multiplies_the_odds_of_its_class(model):
    tree, f = model.filtration, wf.Trail(model)
    level = float(tree.levels(3)[1])
    alive = tree.alive(level)
    belief = followed(f, model.tracks[0], 6)
    for class_ in alive[:3].tolist():
        for confidence in (0.5, 0.9, 0.99):
            told = f.step(belief, [wf.CoarseClass(class_, level, confidence)], dt=0.0)
            p = belief.probability(class_)
            factor = min((len(alive) - 1) * confidence / (1 - confidence), 1000.0)
            wanted = p * factor / (p * factor + 1 - p)
            assert told.probability(class_) == pytest.approx(wanted, rel=1e-9)
            if factor > 1:
                assert told.probability(class_) > p
            assert np.isfinite(f.forecast(told, 5.0).points).all()


@pytest.mark.parametrize("confidence", [1e-300, 1e-9, 0.2, 1.0])
def test_no_report_is_so_sure_that_a_class_becomes_impossible(model, confidence):
    tree, f = model.filtration, wf.Trail(model)
    belief = followed(f, model.tracks[0], 6)
    level = float(tree.levels(3)[1])
    for k in range(2 * REPORTS + 1):
        class_ = int(tree.alive(level)[k % 2])
        belief = f.step(belief, [wf.CoarseClass(class_, level, confidence)], dt=0.0)
        assert belief.trails.told[0] == min(k + 1, REPORTS)
        masses = [belief.probability(c) for c in tree.alive(level)]
        assert min(masses) > 0.0
        assert sum(masses) == pytest.approx(1.0, abs=1e-12)
        assert np.isfinite(f.forecast(belief, 5.0).points).all()


def test_a_report_of_the_only_class_says_nothing(model):
    f = wf.Trail(model)
    belief = followed(f, model.tracks[0], 6)
    told = f.step(belief, [wf.CoarseClass(model.filtration.root)], dt=0.0)
    assert told.trails.told[0] == 0
    assert (told._masses == belief._masses).all()


def test_levels_agree_with_each_other():
    m = wf.learn(bundles(count=12), sd=1.0)
    tree, f = m.filtration, wf.Trail(m)
    belief = followed(f, m.tracks[0], 3)
    assert belief.probability(tree.root) == pytest.approx(1.0, abs=1e-12)
    for level in tree.levels(5):
        assert belief.level(float(level)).probability.sum() == pytest.approx(1.0, abs=1e-12)
    for parent in range(len(tree), len(tree.birth)):
        children = np.flatnonzero(tree.parent == parent)
        children = children[children != parent]
        total = sum(belief.probability(int(c)) for c in children)
        assert belief.probability(parent) == pytest.approx(total, abs=1e-12)
