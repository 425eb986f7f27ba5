"""The scenes of the rendezvous experiment hold what their names say."""

import numpy as np
import pytest

from wakefold.experiments.rendezvous.scenes import DT, EASY, HARD, KINDS, STEPS, TOGETHER, scenes


@pytest.fixture(scope="module")
def made():
    return scenes(280, EASY + HARD, 200.0, np.random.default_rng(5), missing=0.6, share=1 / 7)


def test_half_are_positive_and_the_negatives_are_even():
    some = scenes(60, HARD, 50.0, np.random.default_rng(0))
    assert some.positive.sum() == 30
    assert [(some.kind == KINDS.index(name)).sum() for name in KINDS] == [30, 0, 0, 0, 10, 10, 10]


def test_one_seed_gives_the_same_scenes():
    first, again, other = (scenes(6, EASY, 50.0, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(first.seen, again.seen)
    assert not np.array_equal(first.seen, other.seen)


def test_noise_and_losses_are_those_asked_for(made):
    off = (made.seen - made.truth)[np.isfinite(made.seen)]
    assert np.std(off) == pytest.approx(200.0, rel=0.02)
    assert np.isnan(made.seen[..., 0]).mean() == pytest.approx(0.6, abs=0.01)
    assert np.array_equal(np.isnan(made.seen[..., 0]), np.isnan(made.seen[..., 1]))


def test_ships_that_meet_are_near_and_slow_and_then_part(made):
    """How long and how near is fixed; that they come from afar or go far is missed by one in 1,000 or so.

    So it is by five of 40 with probability 1e-9; of ships that stay, by all.
    """
    afar = 0
    for i in np.flatnonzero(made.positive):
        together = made.phase[i] == TOGETHER
        assert 5 <= together.sum() <= 41
        distance = np.linalg.norm(made.truth[i, 0] - made.truth[i, 1], axis=-1)
        speed = np.linalg.norm(np.diff(made.truth[i], axis=1), axis=-1)[:, together[1:]] / DT
        assert distance[together].max() <= 305.0
        assert speed.max() < 2.0
        afar += distance[0] > 2000 or distance[-1] > 2000
        assert (np.diff(made.phase[i]) >= 0).all()
    assert made.positive.sum() == 40
    assert afar > 35


def test_other_ships_do_what_their_kind_says(made):
    distance = np.linalg.norm(made.truth[:, 0] - made.truth[:, 1], axis=-1)
    speed = np.linalg.norm(np.diff(made.truth, axis=2), axis=-1).max(axis=1) / DT
    both_slow = (speed < 2.5).sum(axis=1)
    near = distance.min(axis=1)
    of = {name: made.kind == k for k, name in enumerate(KINDS)}
    resting = np.where((speed < 0.6), distance[:, 1:], np.nan)[of["anchored apart"]]
    assert np.nanmin(np.nanmedian(resting, axis=1)) > 350
    assert (both_slow[of["anchored apart"]] >= 11).all()
    assert near[of["slow pass"]].max() < 350
    assert (both_slow[of["slow pass"]] >= 11).all()
    for name in ("near pass", *EASY):
        assert (both_slow[of[name]] == 0).all()
    # At cruising speed nobody stays near for long, but for those who follow.
    for name in ("near pass", "crossing"):
        assert (distance[of[name]] < 500).sum(axis=1).max() < 12
    assert (made.phase[~made.positive] == -1).all()


def test_an_unknown_kind_is_named():
    with pytest.raises(ValueError, match="'pass'"):
        scenes(4, ("pass",), 50.0, np.random.default_rng(0))


def test_scenes_last_two_and_a_half_hours(made):
    assert made.truth.shape == (280, 2, STEPS, 2)
    assert DT * STEPS == 9000.0
