"""Rivals are right, no method looks ahead, all are asked the same, and what is not answered counts."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import wakefold as wf
from wakefold.forecast import classes, dressing, rivals
from wakefold.forecast.followed import follow
from wakefold.forecast.methods import FILTERS, NAMES, of_filter
from wakefold.forecast.questions import ask
from wakefold.forecast.samples import judged


def river(seed: int, count: int, start: float = 0.0) -> wf.Tracks:
    """Voyages up one of two arms of a river, a position every 40 s, one after the other; metres."""
    rng = np.random.default_rng(seed)
    points, clocks = [], []
    for k in range(count):
        times = 40.0 * np.arange(60)
        x = rng.uniform(4, 7) * times + rng.normal(0, 4, 60)
        y = (1 if k % 2 else -1) * 0.6 * np.maximum(x - 5000, 0) + rng.normal(0, 40) + rng.normal(0, 4, 60)
        points.append(np.stack([x, y], axis=1))
        clocks.append(start + 900.0 * k + times)
    return wf.Tracks.from_arrays(points, clocks, ids=[f"s{seed}v{k}" for k in range(count)])


@pytest.fixture(scope="module")
def model() -> wf.Model:
    return wf.learn(river(0, 40).resample(spacing=150.0), epsilon=200.0, scale=2.0, sd=20.0)


TERMS: dict[str, Any] = {"horizons": [300, "10min"], "every": "2min", "after": "2min"}


def test_rivals_are_exact_where_they_should_be() -> None:
    times = 60.0 * np.arange(41)
    points = np.stack([5.0 * times, np.zeros(41)], axis=1)
    asked = ask(wf.Tracks.from_arrays([points], [times]), [300.0, 900.0], 120.0, 480.0)
    bend = np.stack([5.0 * times, 100.0 * np.sin(times / 300)], axis=1)
    curved = ask(wf.Tracks.from_arrays([bend], [times]), [300.0, 900.0], 120.0, 120.0)
    back = wf.Tracks.from_arrays([points, points[::-1] + np.array([0.0, 1.0])], [times, times], ids=["there", "back"])
    past = rivals.Past(back, 120.0)
    found = {
        "constant velocity": (rivals.ConstantVelocity(120.0), asked),
        "nearest track": (rivals.NearestTrack(past, 120.0), asked),
        "windows": (rivals.Windows(past, 1), asked),
        "windows, curved": (rivals.Windows(rivals.Past(curved.fixes, 120.0), 1), curved),
    }
    for name, (rival, some) in found.items():
        off = np.linalg.norm(rival.ensemble(some)[:, :, 0] - some.truth, axis=2)
        assert np.nanmax(off) < (1e-6 if "curved" not in name else 15.0), name


def test_windows_that_ended_say_nothing() -> None:
    times = 60.0 * np.arange(41)
    line = np.stack([5.0 * times, np.zeros(41)], axis=1)
    short, long = line[:21] + np.array([0.0, 1.0]), line + np.array([0.0, 300.0])
    past = rivals.Past(wf.Tracks.from_arrays([short, long], [times[:21], times]), 120.0)
    asked = ask(wf.Tracks.from_arrays([line], [times]), [300.0, 1500.0], 120.0, 480.0)
    at = np.flatnonzero(asked.fixes.times[asked.row] == 840.0)[0]
    gone = rivals.Windows(past, 2).ensemble(asked)[at] - asked.here[at]
    assert np.allclose(gone[0, :, 0], 1500.0, atol=1.0)
    assert np.allclose(gone[1, :, 0], 7500.0, atol=400.0)  # all of the longer one


def test_residuals_turn_with_the_agent() -> None:
    frame = dressing.frames(np.array([[3.0, 0.0], [0.0, 2.0], [0.0, 0.0]]))
    assert np.allclose(frame[0], np.eye(2))
    assert np.allclose(frame[1] @ [1.0, 0.5], [-0.5, 1.0])
    assert np.allclose(frame[2], np.eye(2))
    rng = np.random.default_rng(1)
    way = rng.normal(0, 1, (4000, 2))
    turned = dressing.frames(way)
    own = rng.normal(0, 1, (4000, 1, 2)) * [5.0, 1.0] + [2.0, 0.0]
    truth = np.einsum("qaf,qhf->qha", turned, own)
    found = dressing.residuals(truth, np.zeros_like(truth), turned, np.array([60.0]))
    assert np.allclose(found[0].mean(axis=0), [2.0, 0.0], atol=0.5)
    assert np.allclose(found[0].std(axis=0), [5.0, 1.0], rtol=0.25)
    answer = dressing.worn(np.zeros((4000, 1, 2)), turned, found[0], 1.0)
    dressed = judged(answer[:, None], truth)
    assert abs(np.mean(dressed.within(0.5)) - 0.5) < 0.08
    assert abs(np.mean(dressed.within(0.9)) - 0.9) < 0.06


def test_the_last_fifth_is_held_back_or_every_fifth_where_time_tells_nothing() -> None:
    tracks = river(0, 20)
    assert np.flatnonzero(dressing.held_back(tracks)).tolist() == [16, 17, 18, 19]
    at_once = wf.Tracks.from_arrays([*tracks], [tracks.times_of(0)] * 20)
    assert np.flatnonzero(dressing.held_back(at_once)).tolist() == [4, 9, 14, 19]


def test_no_method_looks_ahead(model: wf.Model) -> None:
    tracks = river(7, 1, 1e6)
    other = tracks[0].copy()
    other[31:] += 5000.0
    changed = wf.Tracks.from_arrays([other], [tracks.times], ids=tracks.ids)
    asked, theirs = (ask(each, [300.0], 120.0, 120.0) for each in (tracks, changed))
    past = rivals.Past(model.tracks, 120.0)
    made = [rivals.ConstantVelocity(300.0), rivals.Kalman(0.1, 10.0, 5.0), rivals.NearestTrack(past, 120.0)]
    answers = [(rival.ensemble(asked), rival.ensemble(theirs)) for rival in (*made, rivals.Windows(past, 5))]
    for name in ("BL1", "MHPF", "Calibrated"):
        answers.append((follow(FILTERS[name](model), asked), follow(FILTERS[name](model), theirs)))
    before = asked.fixes.times[asked.row] <= tracks.times[30]
    assert 5 < before.sum() < len(asked) - 5
    for one, two in answers:
        assert np.array_equal(one[before], two[before])
        assert not np.array_equal(one[~before], two[~before], equal_nan=True)


def test_every_method_answers_and_the_numbers_are_plain(model: wf.Model) -> None:
    tracks, shares = river(1, 10, 1e6), []
    found = wf.score(model, tracks, **TERMS, levels=[100.0, 1000.0], progress=shares.append)
    told = found.to_dict()
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    assert set(told["methods"]) == set(NAMES)
    assert set(told["classes"]) == {*NAMES, "prior"} - {"constant velocity", "Kalman", "BL2"}
    asked = ask(tracks, [300.0, 600.0], 120.0, 120.0)
    assert told["questions"]["horizons"] == {"300": asked.asked[0], "600": asked.asked[1]}
    for name, rows in told["methods"].items():
        assert list(rows) == ["300", "600"]
        for row, n in zip(rows.values(), asked.asked.tolist(), strict=True):
            assert (row["n"], row["unanswered"]) == (n, 0), name
            assert row["interval"][0] <= row["mean"] <= row["interval"][1]
            assert 0 <= row["cover50"] <= row["cover90"] <= 1
    for rows in told["classes"].values():
        for level in rows.values():
            assert list(level) == ["25", "50", "75"]
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)
    table = found.table()
    assert table.splitlines()[0].startswith("Best in 5 min, 10 min: ")
    assert all(name in table for name in NAMES)
    again = wf.score(model, tracks, **TERMS, levels=[100.0, 1000.0], methods=["nearest windows"]).to_dict()
    assert again["methods"]["nearest windows"]["300"]["mean"] == told["methods"]["nearest windows"]["300"]["mean"]


class Silent:
    """A filter that knows where the agent was last, and forecasts no farther than five minutes."""

    def start(self, *, fix: Any = None, time: Any = None, agent: Any = None) -> Any:
        return self.step(None, [fix], time=time)

    def step(self, belief: Any, evidence: Any = (), dt: Any = None, *, time: Any = None) -> Any:
        class Belief:
            points, weights = np.array([evidence[0].position]), np.ones(1)

        return Belief

    def forecast(self, belief: Any, horizon: Any) -> Any:
        if max(horizon) > 300.0:
            raise ValueError("too far ahead")
        return [belief for _ in horizon]


def test_constant_velocity_stands_for_what_is_not_answered(model: wf.Model) -> None:
    tracks = river(1, 6, 1e6)
    found = wf.score(model, tracks, horizons=[300, 600], every=120, after=120, levels=[], methods={"silent": Silent()})
    told = found.to_dict()
    silent, plain = (told["methods"][name]["600"] for name in ("silent", "constant velocity"))
    late = np.isfinite(found.asked.truth[:, 1, 0])
    assert silent["unanswered"] == silent["n"] == late.sum()
    assert (silent["mean"], silent["energy"]) == (plain["mean"], plain["energy"])
    near = told["methods"]["silent"]["300"]
    assert near["unanswered"] == late.sum()  # a filter that refuses one horizon of a question refuses all


def test_weights_and_gaussians_become_samples(model: wf.Model) -> None:
    asked = ask(river(2, 3, 1e6), [300.0], 120.0, 120.0)
    f = wf.Calibrated(model)
    drawn = of_filter("Calibrated", f).answer(asked, None)
    belief = f.start(fix=wf.Fix(asked.fixes[0][0]), time=asked.fixes.times[0], agent=str(asked.fixes.ids[0]))
    belief = f.step(belief, [wf.Fix(asked.fixes[0][1])], time=asked.fixes.times[1])
    later = f.forecast(belief, 300.0)
    assert np.allclose(drawn[0, 0].mean(axis=0), later.mean(), atol=0.3 * np.sqrt(np.trace(later.cov())))
    assert np.trace(np.cov(drawn[0, 0].T)) == pytest.approx(np.trace(later.cov()), rel=0.35)


def test_slow_filters_are_asked_a_part_and_compared_on_it(model: wf.Model, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wakefold.forecast.score.SLOW_MOMENTS", 10)
    tracks = river(3, 6, 1e6)
    some = wf.score(model, tracks, **TERMS, levels=[500.0], methods=["Calibrated"])
    every = wf.score(model, tracks, **TERMS, levels=[500.0], methods=["Calibrated"], whole=True)
    kept = np.isfinite(some.judged["Calibrated"].error)
    assert 5 < kept[:, 0].sum() <= 10 < np.isfinite(every.judged["Calibrated"].error)[:, 0].sum()
    assert np.array_equal(some.judged["Calibrated"].energy[kept], every.judged["Calibrated"].energy[kept])
    off = some.judged["Calibrated"].energy - some.judged["constant velocity"].energy
    assert some.mean("Calibrated", "energy", "constant velocity")[0] == pytest.approx(np.nanmean(off[:, 0]))


def test_intervals_are_over_tracks(model: wf.Model) -> None:
    """Every question of a track is wrong by the same: the interval is that of a mean over 40 tracks."""
    found = wf.score(model, river(4, 40, 1e6), **TERMS, levels=[], methods=[])
    rng = np.random.default_rng(0)
    error = rng.normal(100, 20, 40)[found.asked.track][:, None] * np.ones(2)
    error[np.isnan(found.asked.truth[:, :, 0])] = np.nan
    mine = replace(found, judged={"made up": found.judged["constant velocity"]._replace(error=error)})
    low, high = mine.interval("made up")[0]
    assert high - low == pytest.approx(2 * 1.645 * 20 / np.sqrt(40), rel=0.35)


def test_what_cannot_be_scored_is_said(model: wf.Model) -> None:
    tracks = river(1, 3, 1e6)
    with pytest.raises(ValueError, match="there is no method 'oracle': there are constant velocity"):
        wf.score(model, tracks, **TERMS, methods=["oracle"])
    with pytest.raises(ValueError, match="nothing can be asked: none of 3 tracks goes on for 1,440 min"):
        wf.score(model, tracks, horizons=["1d"], every=120)
    lonlat = wf.Tracks.from_columns(agent=["a"] * 3, time=[0, 60, 120], lon=[1, 1.1, 1.2], lat=[50, 50, 50])
    with pytest.raises(ValueError, match="the model was learned from planar tracks, these are geodetic"):
        wf.score(model, lonlat)
    again = wf.score(model, river(0, 4), **TERMS, levels=[], methods=[])
    assert any("are in the model too" in note for note in again.notes)
    assert not wf.score(model, tracks, **TERMS, levels=[], methods=[]).notes


def test_classes_are_told_in_intervals_of_the_tree(model: wf.Model) -> None:
    """Shares of tracks become those of the classes above them, with a floor of the prior."""
    tree = model.filtration
    truth, level = np.array([3]), float(tree.levels(2)[-1])
    ledger = classes.Ledger(tree, truth, [0.0, level])
    ledger.tracks(np.array([[3, 3, 5, 8], [5, 5, 5, 5], [3, 3, 3, 3]]), prior=0.2)
    of = [tree.class_at(t, level) for t in range(40)]
    for moment, named in enumerate(([3, 3, 5, 8], [5] * 4, [3] * 4)):
        share = [0.8 * named.count(t) / 4 + 0.2 / 40 for t in range(40)]
        for k, true in ((0, [3]), (1, [t for t in range(40) if of[t] == of[3]])):
            kept = [t in true for t in range(40)]
            expected = (1 - classes.FLOOR) * sum(np.array(share)[kept]) + classes.FLOOR * len(true) / 40
            assert ledger.found[0, moment, k, classes.TRUE] == pytest.approx(expected)
    assert ledger.found[0, :, 0, classes.HIT].tolist() == [1.0, 0.0, 1.0]
    told = classes.summary(ledger.found[:, :, 0])
    assert told["25"]["nll"] == pytest.approx(-np.log(ledger.found[0, 0, 0, classes.TRUE]))
    assert [told[share]["accuracy"] for share in ("25", "50", "75")] == [1.0, 0.0, 1.0]


def test_the_true_class_is_that_of_the_nearest_past_track(model: wf.Model) -> None:
    tracks = river(9, 5, 1e6)
    found = classes.nearest_past(model, tracks)
    away = wf.frechet_matrix(tracks.resample(spacing=model.tracks.median_spacing), model.tracks)
    assert found.tolist() == np.argmin(away, axis=1).tolist()
