"""Beliefs that go on when their model has grown or forgotten."""

import math

import numpy as np
import pytest
from made import walks

import wakefold as wf

MAY = 1.6e9  # seconds since 1970: a date
MAKERS = {
    "BL1": lambda m: wf.BL1(m, 60, depletion=0.0, seed=1),
    "BL2": lambda m: wf.BL2(m, 60, seed=1),
    "MHPF": lambda m: wf.MHPF(m, 60, depletion=0.0, seed=1),
    "Calibrated": lambda m: wf.Calibrated(m, seed=1),
}


def tracks(first, last, begin=0.0):
    arrays = walks(np.random.default_rng(0), 30, 2)[first:last]
    times = [MAY + begin + 10.0 * np.arange(len(track)) for track in arrays]
    return wf.Tracks.from_arrays(arrays, times, [f"t{k}" for k in range(first, last)])


@pytest.fixture(scope="module")
def models():
    """A model of ten tracks, with ten more, and without the first ten."""
    small = wf.learn(tracks(0, 10))
    large = small.extend(tracks(10, 20, 86_400.0))
    return small, large, large.forget("1h")


def followed(filter, track, steps):
    belief = filter.start(time=MAY)
    for k in range(steps):
        belief = filter.step(belief, [wf.Fix(track[k], sd=3.0)], time=MAY + 10.0 * k)
    return belief


def masses(belief):
    """Of the single tracks, by name."""
    tree = belief.tree
    return {str(tree.ids[k]): belief.probability(k) for k in range(len(tree))}


@pytest.mark.parametrize("name", MAKERS)
def test_a_belief_goes_on_with_a_model_that_grew(models, name):
    small, large, _ = models
    before, after = (MAKERS[name](m) for m in (small, large))
    belief = followed(before, small.tracks[3], 3)
    moved = belief.on(large)
    assert type(moved) is type(belief)
    assert moved.tree is large.filtration
    np.testing.assert_allclose(moved.mean(), belief.mean(), rtol=1e-12)
    np.testing.assert_allclose(moved.cov(), belief.cov(), rtol=1e-9, atol=1e-9)
    told = ("step", "time", "log_evidence", "recoveries")
    assert [getattr(moved, t) for t in told] == [getattr(belief, t) for t in told]
    if name == "BL2":
        assert (moved.classes == large.filtration.root).all()
    else:
        old, new = masses(belief), masses(moved)
        assert {k: new[k] for k in old} == pytest.approx(old)
        assert sum(new[k] for k in new if k not in old) == 0.0
    later = followed_on(after, moved, small.tracks[3], 3)
    assert later.recoveries == belief.recoveries
    assert math.isfinite(later.log_evidence)
    with pytest.raises(ValueError, match="another filtration"):
        after.step(belief, [], dt=1.0)


def followed_on(filter, belief, track, first):
    for k in range(first, min(first + 3, len(track))):
        belief = filter.step(belief, [wf.Fix(track[k], sd=3.0)], time=MAY + 10.0 * k)
    return belief


@pytest.mark.parametrize("name", ["BL1", "MHPF", "Calibrated"])
def test_the_mass_of_forgotten_tracks_goes_to_those_that_are_left(models, name):
    _, large, left = models
    belief = followed(MAKERS[name](large), large.tracks[13], 1)  # a fix from which several tracks may go on
    old = masses(belief)
    kept = {k: p for k, p in old.items() if k in left.tracks.ids}
    assert 0.0 < sum(kept.values()) < 1.0
    moved = belief.on(left)
    total = sum(kept.values())
    assert masses(moved) == pytest.approx({k: p / total for k, p in kept.items()}, abs=1e-12)
    assert moved.weights.sum() == pytest.approx(1.0)
    filter = MAKERS[name](left)
    later = filter.step(moved, [wf.Fix(large.tracks[13][1], sd=3.0)], time=MAY + 10.0)
    assert np.isfinite(later.mean()).all()
    assert np.isfinite(filter.forecast(moved, 10.0).mean()).all()


@pytest.mark.parametrize("name", ["BL1", "MHPF", "Calibrated"])
def test_a_belief_of_which_nothing_is_left_is_refused(models, name):
    small, _, left = models
    belief = followed(MAKERS[name](small), small.tracks[3], 2)
    with pytest.raises(ValueError, match="no track that the agent may be on is left"):
        belief.on(left)
    with pytest.raises(ValueError, match="the belief is 2-D, the model 1-D"):
        belief.on(wf.learn(wf.Tracks.from_arrays([[0.0, 1.0]])))


@pytest.mark.parametrize("name", ["MHPF", "Calibrated"])
def test_new_tracks_are_reached_by_what_switches(name):
    """An agent goes off on a way that came new while it was followed."""
    x = 10.0 * np.arange(40.0)[:, None]
    east = [x * [1.0, 0.0] + [0.0, y] for y in (-20.0, 0.0, 20.0)]
    north = [x * [0.8, 0.6] + [0.0, y] for y in (-20.0, 0.0, 20.0)]
    times = [MAY + np.arange(40.0)] * 3
    small = wf.learn(wf.Tracks.from_arrays(east, times, ["e0", "e1", "e2"]))
    large = small.extend(wf.Tracks.from_arrays(north, times, ["n0", "n1", "n2"]))
    make = {
        "MHPF": lambda m: wf.MHPF(m, 200, depletion=0.05, seed=1),
        "Calibrated": lambda m: wf.Calibrated(m, switching=0.01, seed=1),
    }[name]
    before, after = make(small), make(large)
    belief = before.start(time=MAY, at="begin")
    for k in range(1, 4):
        belief = before.step(belief, [wf.Fix(north[1][k], sd=10.0)], time=MAY + k)
    belief = belief.on(large)
    assert sum(masses(belief)[f"n{k}"] for k in range(3)) == 0.0
    for k in range(4, 30):
        belief = after.step(belief, [wf.Fix(north[1][k], sd=10.0)], time=MAY + k)
    assert sum(masses(belief)[f"n{k}"] for k in range(3)) > 0.9


def test_a_belief_that_was_carried_is_stored_and_read(models, tmp_path):
    small, large, _ = models
    belief = followed(MAKERS["MHPF"](small), small.tracks[3], 3).on(large)
    belief.save(tmp_path / "belief")
    again = wf.Belief.load(tmp_path / "belief", large.filtration)
    assert masses(again) == masses(belief)
