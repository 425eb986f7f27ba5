"""Recognisers of a rendezvous: thresholds, the rule, and that a split is a function of its numbers."""

import numpy as np
import pytest

from wakefold.experiments import rendezvous
from wakefold.experiments.rendezvous_rivals import Motion, Rule, f1, near_and_slow, threshold
from wakefold.experiments.rendezvous_scenes import DT, HARD, STEPS, scenes


@pytest.mark.parametrize("seed", range(5))
def test_no_threshold_is_better_than_the_one_chosen(seed):
    rng = np.random.default_rng(seed)
    positive = rng.random(40) < 0.5
    scores = np.round(rng.normal(size=40) + positive, 1)
    at = threshold(scores, positive)
    assert at.f1 == pytest.approx(f1(scores > at.score, positive))
    assert at.f1 == pytest.approx(max(f1(scores > cut, positive) for cut in np.arange(-5, 5, 0.05)))


def test_near_and_slow_counts_the_longest_time_without_a_break():
    position, velocity = np.zeros((1, 2, STEPS, 2)), np.zeros((1, 2, STEPS, 2))
    position[0, 1, :, 0] = 1000.0
    position[0, 1, 10:50, 0] = 100.0
    velocity[0, 0, 20, 0] = 9.0
    assert near_and_slow(Motion(position, velocity), Rule(500.0, 2.0)).tolist() == [29 * DT]


def test_ships_that_meet_score_above_those_that_do_not():
    some = scenes(24, HARD, 50.0, np.random.default_rng(3))
    scores, position = rendezvous.together(some, 50.0, 0.0)
    assert threshold(scores, some.positive).f1 > 0.9
    assert np.isfinite(position).all()
    # Side by side or alone, a scene is followed alike.
    alone = some._replace(**{name: getattr(some, name)[:1] for name in some._fields})
    assert rendezvous.together(alone, 50.0, 0.0)[0] == pytest.approx(scores[:1], rel=1e-6)
