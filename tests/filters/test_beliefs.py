"""Settings of filters, and what beliefs answer and refuse."""

import copy
import math
import pickle
from datetime import date, datetime

import numpy as np
import pytest
from made import bundles

import wakefold as wf


@pytest.fixture(scope="module")
def model():
    return wf.learn(bundles(), scale=0.4, sd=1.5)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"particles": 0}, "particles"),
        ({"particles": 1.5}, "particles"),
        ({"likelihood": "cauchy"}, "likelihood"),
        ({"sd": 0.0}, "sd"),
        ({"sd": math.nan}, "sd"),
        ({"dof": -1.0}, "dof"),
        ({"depletion": 1.5}, "depletion"),
        ({"resampling": "magic"}, "resampling"),
        ({"ess_threshold": 0.0}, "ess_threshold"),
        ({"rule": "mine"}, "rule"),
        ({"levels": "some"}, "levels"),
    ],
)
def test_settings_out_of_range_are_named(model, settings, match):
    with pytest.raises(ValueError, match=match):
        wf.MHPF(model, **settings)


def test_beliefs_of_another_size_are_refused(model):
    with pytest.raises(ValueError, match="30 particles"):
        wf.BL1(model, 40).step(wf.BL1(model, 30).start(), [], dt=1.0)


def test_level_estimates_use_the_sets_of_that_level(model):
    tree = model.filtration
    f = wf.MHPF(model, 60, levels="all", seed=1)
    belief = f.step(f.start(), [wf.Fix(model.tracks[5][1], sd=2.0)], dt=1.0)
    for level in np.unique(tree.birth):
        points, logs = [], []
        for c in tree.alive(level):
            if c < len(tree):
                chosen = belief.classes == c
                points += list(belief.points[chosen])
                logs += list(belief.log_weights[chosen])
            else:
                at = np.flatnonzero(belief.stack.nodes == c)
                for a in at:
                    rows = slice(belief.stack.start[a], belief.stack.start[a + 1])
                    points += list(belief.stack.points[rows])
                    logs += list(belief.stack.log_weights[rows])
        assert len(points) == 60  # every level has exactly N particles
        w = np.exp(logs)
        np.testing.assert_allclose(belief.mean(level=level), np.average(points, axis=0, weights=w))
        np.testing.assert_allclose(
            belief.cov(level=level), np.cov(np.transpose(points), aweights=w, ddof=0), rtol=1e-9, atol=1e-12
        )
    few = wf.MHPF(model, 60, levels=[float(tree.birth[tree.root])], seed=1)
    partial = few.step(few.start(), [], dt=1.0)
    partial.mean(level=float(tree.birth[tree.root]))
    with pytest.raises(ValueError, match="no particle sets"):
        partial.mean(level=float(np.median(tree.birth[tree.birth > 0])))


def test_a_model_of_one_track(model):
    one = wf.learn(wf.Tracks.from_arrays([np.arange(10.0)[:, None] * [1.0, 0.5]]), scale=0.1, sd=0.3)
    for f in (wf.MHPF(one, 20), wf.MHPF(one, 20, levels="all"), wf.BL1(one, 20), wf.BL2(one, 20)):
        belief = f.start(at="begin")
        for k in range(1, 6):
            belief = f.step(belief, [wf.Fix(one.tracks[0][k]), wf.CoarseClass(0)], dt=1.0)
        assert np.linalg.norm(belief.mean() - one.tracks[0][5]) < 0.5
        assert belief.map(0.0) == 0


@pytest.mark.parametrize("make", [wf.MHPF, wf.BL1, wf.BL2, wf.Calibrated])
def test_a_belief_about_other_classes_is_refused_and_a_copy_of_a_filter_is_as_good(make):
    rng = np.random.default_rng(0)
    small, large = (
        wf.learn(wf.Tracks.from_arrays([np.cumsum(rng.normal(1, 1, (20, 2)), axis=0) for _ in range(n)]))
        for n in (5, 60)
    )
    f, belief = make(small, seed=1), make(large).start()
    for ask in (lambda: f.step(belief, [], dt=1.0), lambda: f.forecast(belief, 3.0)):
        with pytest.raises(ValueError, match="another filtration"):
            ask()
    start = f.start(time=0.0)
    once = f.step(start, [wf.Fix((1.0, 1.0), sd=1.0)], dt=1.0)
    for again in (pickle.loads(pickle.dumps(f)), copy.deepcopy(f)):  # noqa: S301 -- to worker processes
        twice = again.step(pickle.loads(pickle.dumps(start)), [wf.Fix((1.0, 1.0), sd=1.0)], dt=1.0)  # noqa: S301
        assert (twice.points == once.points).all()
        assert (twice.log_weights == once.log_weights).all()


@pytest.mark.parametrize(
    "time",
    [
        "2020-01-01",
        date(2020, 1, 1),
        datetime(2020, 1, 1),  # without a zone: UTC
        *(np.datetime64("2020-01-01", unit) for unit in ("D", "m", "ns")),
    ],
)
def test_a_time_is_a_time_in_any_form(time, model):
    assert wf.BL1(model).start(time=time).time == 1_577_836_800.0


@pytest.mark.parametrize("time", ["now", np.nan, np.datetime64("NaT")])
def test_what_is_no_time_is_refused(time, model):
    with pytest.raises(ValueError, match="is not a time"):
        wf.BL1(model).start(time=time)


@pytest.mark.parametrize("made", [wf.BL1, wf.BL2, wf.MHPF, wf.Calibrated])
@pytest.mark.parametrize("taken", [wf.BL1, wf.BL2, wf.MHPF, wf.Calibrated])
def test_a_filter_refuses_the_beliefs_of_other_kinds_of_filter(model, made, taken):
    belief, f = made(model, 27).start(), taken(model, 27)
    assert isinstance(belief, wf.Belief)
    assert isinstance(belief, f.kind) == (made is taken)
    for ask in (lambda: f.step(belief, [], dt=1.0), lambda: f.forecast(belief, 3.0)):
        if made is taken:
            ask()
            continue
        with pytest.raises(
            ValueError, match=f"another filter, {made.__name__}: start a new one with this {taken.__name__}"
        ):
            ask()
    with pytest.raises(TypeError, match="takes a Belief"):
        f.forecast("here", 3.0)


@pytest.mark.parametrize("make", [wf.BL1, wf.MHPF, wf.Calibrated])
def test_evidence_since_the_last_recovery_goes_on_where_the_total_is_lost(model, make, tmp_path):
    f = make(model, 40, seed=0)
    belief = f.step(f.start(), [wf.Fix(model.tracks[2][0], sd=2.0)], dt=0.0)
    assert belief.log_evidence_since == belief.log_evidence
    lost = f.step(belief, [wf.Fix((1e200, 0.0), sd=1.0)], dt=1.0)
    assert (lost.log_evidence, lost.log_evidence_since, lost.recoveries) == (-math.inf, 0.0, 1)
    after = f.step(lost, [wf.Fix(lost.mean(), sd=3.0)], dt=0.0)
    assert after.log_evidence == -math.inf
    assert math.isfinite(after.log_evidence_since)
    assert after.log_evidence_since < 0
    after.save(tmp_path / "belief")
    again = wf.Belief.load(tmp_path / "belief", model.filtration)
    assert type(again) is type(after)
    assert again.log_evidence_since == after.log_evidence_since


def test_a_filter_tells_how_many_classes_it_draws_anew(model):
    assert [wf.MHPF(model, 200, depletion=v).redrawn for v in (0.0, 0.001, 0.01, 1.0)] == [0, 0, 2, 200]
    assert wf.BL2(model, 200, depletion=0.5).redrawn == 0
