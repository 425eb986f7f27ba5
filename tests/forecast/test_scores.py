"""Questions about held-out tracks hold the truth back, rivals are right, and no method looks ahead."""

import numpy as np

import wakefold as wf
from wakefold.forecast import rivals, scores


def straight(speed: float = 5.0, minutes: int = 40, y: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A position a minute along a line."""
    times = 60.0 * np.arange(minutes + 1)
    return np.stack([speed * times, np.full(len(times), y)], axis=1), times


def test_fixes_are_two_minutes_apart_and_the_rest_is_asked_for() -> None:
    points, times = straight()
    asked = scores.questions(points, times)
    given = [ask.row for ask in asked]
    assert given == list(range(0, 41, 2))
    assert len(asked[0].ahead) == 0
    assert asked[1].ahead.tolist() == [60.0, 300.0, 900.0]
    assert asked[1].kind.tolist() == [0.0, 300.0, 900.0]
    hidden = [ask.row + 1 for ask in asked for kind in ask.kind if kind == 0.0]
    assert not set(hidden) & set(given)
    for ask in asked:
        assert np.allclose(ask.truth[:, 0], 5.0 * (times[ask.row] + ask.ahead))
        assert (times[ask.row] + ask.ahead <= times[-1]).all()


def test_constant_velocity_is_exact_on_a_straight_line_and_nearest_track_on_a_known_one() -> None:
    points, times = straight()
    voyages = wf.Tracks.from_arrays([points], [times])
    for off in scores.errors(rivals.constant_velocity, voyages).values():
        assert off.max() < 1e-9
    back = wf.Tracks.from_arrays([points, points[::-1] + np.array([0.0, 1.0])], [times, times], ids=["there", "back"])
    for off in scores.errors(rivals.nearest_track(back), voyages).values():
        assert off.max() < 1e-6


def test_methods_do_not_look_ahead() -> None:
    rng = np.random.default_rng(0)
    points, times = straight()
    past = wf.Tracks.from_arrays([points + rng.normal(0, 20, points.shape) for _ in range(4)], [times] * 4)
    model = wf.learn(past, epsilon=300.0, scale=5.0)
    asked = scores.questions(points, times)
    other = points.copy()
    other[21:] += 5000.0  # what comes after the fix of row 20
    for method in (
        rivals.constant_velocity,
        rivals.nearest_track(past),
        rivals.particle(wf.MHPF(model, 50, levels=[]), 20.0),
    ):
        one = list(method("a", points, times, asked))
        two = list(method("a", other, times, asked))
        for k in range(11):
            assert np.array_equal(one[k], two[k])
        assert not np.array_equal(one[11], two[11])


def test_the_levels_of_mhpf_do_not_change_its_base_estimate() -> None:
    """All voyages are scored without coarse sets, which saves time; the estimate must be that of the filter shown."""
    rng = np.random.default_rng(1)
    points, times = straight()
    past = wf.Tracks.from_arrays([points + rng.normal(0, 200, 2) for _ in range(12)], [times] * 12)
    model = wf.learn(past, epsilon=300.0, scale=5.0)
    asked = scores.questions(points, times)
    answers = [list(rivals.particle(wf.MHPF(model, 60, levels=n), 30.0)("a", points, times, asked)) for n in ([], 4)]
    for one, other in zip(*answers, strict=True):
        assert np.array_equal(one, other)
