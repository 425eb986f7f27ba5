"""Questions about held-out tracks hold the truth back; they are those of the definition."""

import naive_scores as naive
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import wakefold as wf
from wakefold.forecast.questions import ask


def straight(speed: float = 5.0, minutes: int = 40, y: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A position a minute along a line."""
    times = 60.0 * np.arange(minutes + 1)
    return np.stack([speed * times, np.full(len(times), y)], axis=1), times


def test_fixes_are_two_minutes_apart_and_truth_is_on_the_line() -> None:
    points, times = straight()
    asked = ask(wf.Tracks.from_arrays([points], [times]), [300.0, 900.0, 2100.0], 120.0, 240.0)
    assert asked.fixes.times.tolist() == list(range(0, 2401, 120))
    assert asked.fixes.times[asked.row].tolist() == list(range(240, 2101, 120))
    assert asked.asked.tolist() == [16, 11, 1]
    known = np.isfinite(asked.truth[:, :, 0])
    when = asked.fixes.times[asked.row][:, None] + asked.horizons
    assert np.array_equal(known, when <= times[-1])
    assert np.allclose(asked.truth[known][:, 0], 5.0 * when[known])
    assert asked.fixes.times[asked.class_row[0]].tolist() == [600.0, 1200.0, 1800.0]


@given(st.integers(0, 10_000), st.floats(1.0, 50.0), st.floats(0.0, 60.0))
def test_questions_are_those_of_the_definition(seed: int, every: float, after: float) -> None:
    rng = np.random.default_rng(seed)
    tracks = [rng.normal(0, 10, (n, 2)).cumsum(axis=0) for n in rng.integers(1, 30, 4)]
    clocks = [rng.integers(0, 100) + rng.exponential(8.0, len(t)).cumsum() for t in tracks]
    whole = wf.Tracks.from_arrays(tracks, clocks)
    asked, first = (ask(whole, [20.0, 45.0], every, after, which) for which in ("all", "first"))
    seen = []
    for t, (points, times) in enumerate(zip(tracks, clocks, strict=True)):
        given_rows = naive.given_fixes(times, every * (1 - 1e-3))
        assert np.array_equal(asked.fixes.times_of(t), times[given_rows])
        for row in given_rows[1:]:
            known = [times[row] + h <= times[-1] for h in asked.horizons]
            if times[row] - times[0] >= after and any(known):
                truth = [[np.interp(times[row] + h, times, points[:, a]) for a in (0, 1)] for h in asked.horizons]
                seen.append((t, times[row], np.where(np.array(known)[:, None], truth, np.nan)))
    assert len(seen) == len(asked)
    for q, (t, time, truth) in enumerate(seen):
        assert asked.track[q] == t
        assert asked.fixes.times[asked.row[q]] == time
        assert np.allclose(asked.truth[q], truth, equal_nan=True)
    alone = {t: time for t, time, _ in reversed(seen)}
    assert set(first.track.tolist()) <= set(alone)
    for t, row in zip(first.track.tolist(), first.row, strict=True):
        assert first.fixes.times[row] == alone[t]
    some = asked.of([1, 3])
    kept = np.isin(asked.track, [1, 3])
    assert np.array_equal(some.here, asked.here[kept])
    assert np.array_equal(some.back([5.0, 30.0]), asked.back([5.0, 30.0])[kept])
    assert np.array_equal(some.fixes.points[some.class_row], asked.fixes.points[asked.class_row[[1, 3]]])


def test_the_past_is_read_between_fixes_and_no_further_back_than_the_start() -> None:
    points, times = straight()
    asked = ask(wf.Tracks.from_arrays([points], [times]), [300.0], 120.0, 120.0)
    back = asked.back([0.0, 30.0, 600.0])
    now = asked.fixes.times[asked.row]
    assert np.allclose(back[:, :, 0], 5.0 * np.maximum(now[:, None] - [0.0, 30.0, 600.0], 0.0))
    assert np.allclose(asked.velocity(600.0), [5.0, 0.0])


def test_what_cannot_be_asked_is_refused() -> None:
    points, times = straight()
    with pytest.raises(ValueError, match="questions must be 'all' or 'first', got 'some'"):
        ask(wf.Tracks.from_arrays([points], [times]), [300.0], 120.0, 120.0, "some")  # pyright: ignore[reportArgumentType]


def test_new_york_has_the_questions_of_the_definition() -> None:
    pytest.importorskip("tracktable_data", reason="the extra `demo` is not installed")
    from wakefold.experiments.harbour import demo

    held_out = demo.day_after(demo.week())
    assert len(held_out) == 79
    assert ask(held_out, [300.0, 900.0, 1800.0, 3600.0], 120.0, 120.0).asked.tolist() == [2690, 2394, 2025, 1529]
