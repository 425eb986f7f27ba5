"""Recognisers of a rendezvous: thresholds, the rule, and that a split is a function of its numbers."""

import numpy as np
import pytest

from wakefold.experiments.rendezvous import report as rendezvous_report
from wakefold.experiments.rendezvous import trials as rendezvous
from wakefold.experiments.rendezvous.relational import phases, together
from wakefold.experiments.rendezvous.rivals import (
    Motion,
    Nearness,
    Rule,
    kalman,
    near_and_slow,
    position_error,
    threshold,
)
from wakefold.experiments.rendezvous.scenes import DT, HARD, STEPS, scenes
from wakefold.experiments.stats import f1


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
    assert near_and_slow(Nearness.of(Motion(position, velocity)), [Rule(500.0, 2.0)]).tolist() == [[29 * DT]]


@pytest.mark.parametrize(("missing", "least"), [(0.0, 0.95), (0.6, 0.9)])
def test_ships_that_meet_are_told_in_phases(missing, least):
    """F1 over seeds of 60 scenes: .986 (sd .016) and .979 (.018), so of 240 the bounds are 4.6 and 9 sd away.

    The ratio of the errors is .90 and .91 (sd .013 or less).
    """
    some = scenes(240, HARD, 200.0, np.random.default_rng(3), missing=missing)
    p, odds, place = phases(some, 200.0)
    assert f1(odds > 0.0, some.positive) > least
    np.testing.assert_allclose(p.sum(axis=2), 1.0)
    known = np.isfinite(place)
    plain = kalman(some, 200.0, rendezvous.Q, smooth=False).position
    assert position_error(place, some) < position_error(np.where(known, plain, np.nan), some)
    # Side by side or alone, a scene is followed alike.
    alone = some._replace(**{name: getattr(some, name)[:1] for name in some._fields})
    assert phases(alone, 200.0)[1] == pytest.approx(odds[:1], rel=1e-9)


def test_ships_that_meet_are_told_by_the_collapsed_engine():
    some = scenes(24, HARD, 50.0, np.random.default_rng(3))
    scores = together(some, 50.0, 0.0)
    assert threshold(scores, some.positive).f1 > 0.9
    alone = some._replace(**{name: getattr(some, name)[:1] for name in some._fields})
    assert together(alone, 50.0, 0.0) == pytest.approx(scores[:1], rel=1e-6)


def test_a_split_depends_on_its_numbers_alone():
    spec = {"condition": "hard 0.2, 60 % missing", "split": 3, "seed": 1, "models": []}
    assert rendezvous.split(spec) == rendezvous.split(spec)


def test_the_report_has_a_row_for_each_recogniser_and_a_picture(tmp_path):
    rng = np.random.default_rng(0)
    found = [{"f1": {n: rng.random() for n in rendezvous_report.NAMES}, "error": {"a": rng.random()}} for _ in range(3)]
    section = rendezvous_report.section("", {"hard 0.2": found}, tmp_path, seed=0)
    assert [row[0] for row in section.tables[0].rows] == list(rendezvous_report.NAMES)
    assert section.pictures[0].path.stat().st_size > 20_000
