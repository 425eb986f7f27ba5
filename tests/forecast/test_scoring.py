"""``wakefold.score`` on odd data: few tracks, tracks at rest, horizons longer than all learned; and its defaults."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import wakefold as wf
from wakefold.forecast.methods import NAMES


def walkers(seed: int, count: int, points: int = 60, start: float = 0.0) -> wf.Tracks:
    """People across a hall, a position every 0.4 s; the plane's own units."""
    rng = np.random.default_rng(seed)
    times = 0.4 * np.arange(points)
    velocity = rng.normal(0, 1.0, (count, 1, 2))
    places = rng.uniform(0, 20, (count, 1, 2)) + velocity * times[:, None] + rng.normal(0, 0.02, (count, points, 2))
    clocks = [start + 5.0 * k + times for k in range(count)]
    return wf.Tracks.from_arrays(list(places), clocks, ids=[f"w{seed}p{k}" for k in range(count)])


def finite(found: wf.Scores) -> dict:
    told = found.to_dict()
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    assert found.table()
    return told


def test_defaults_of_planar_tracks_come_from_the_tracks() -> None:
    model = wf.learn(walkers(0, 30))
    told = finite(wf.score(model, walkers(1, 10, start=1e4), methods=["nearest windows"]))
    about = told["questions"]
    assert about["every"] == pytest.approx(0.8)  # 23.6 s / 25 in steps of 0.4 s
    assert about["from"] == pytest.approx(3.2)
    assert list(about["horizons"]) == ["3", "5.9", "12", "24"]  # eighth, quarter, half, all of 23.6 s
    assert about["horizons"]["24"] == 0
    assert "24" not in told["methods"]["nearest windows"]


@pytest.mark.parametrize("count", [1, 2, 6])
def test_few_past_tracks_are_enough(count: int) -> None:
    model = wf.learn(walkers(0, count))
    found = wf.score(model, walkers(1, 3, start=1e4), horizons=[2.0, 9.0])
    told = finite(found)
    assert set(told["methods"]) == set(NAMES)
    assert ("too few past tracks" in " ".join(found.notes)) == (count < 5)


def test_agents_at_rest_and_horizons_longer_than_any_past_track() -> None:
    model = wf.learn(walkers(0, 12, points=20))
    still = wf.Tracks.from_arrays([np.full((100, 2), 3.0)] * 2, [1e4 + 0.4 * np.arange(100)] * 2, ids=["a", "b"])
    told = finite(wf.score(model, still, horizons=[2.0, 30.0], every=0.4))
    for rows in told["methods"].values():
        assert rows["30"]["n"] == 2 * (99 - 75 - 3)
    rest = wf.Tracks.from_arrays([np.full((30, 2), float(k)) for k in range(6)], [0.4 * np.arange(30)] * 6)
    finite(wf.score(wf.learn(rest, sd=1.0), still, horizons=[2.0], every=0.4))


@settings(max_examples=15)
@given(st.integers(0, 1000))
def test_plain_methods_turn_and_shift_with_the_plane(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle, shift = rng.uniform(0, 2 * np.pi), rng.normal(0, 100, 2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def moved(tracks: wf.Tracks) -> wf.Tracks:
        clocks = [tracks.times_of(i) for i in range(len(tracks))]
        return wf.Tracks.from_arrays([p @ turn.T + shift for p in tracks], clocks, ids=tracks.ids.tolist())

    past, later = walkers(seed, 12), walkers(seed + 1, 4, start=1e4)
    one, two = (
        wf.score(
            wf.learn(move(past), epsilon=2.0, scale=0.1, sd=0.1), move(later), horizons=[2.0, 6.0], levels=[],
            methods=["constant velocity", "nearest track", "nearest windows"],
        )
        for move in (lambda tracks: tracks, moved)
    )  # fmt: skip
    assert one.settings == two.settings
    for name in one.judged:
        assert np.allclose(one.judged[name].error, two.judged[name].error, rtol=1e-3, atol=1e-4, equal_nan=True)
        assert np.allclose(one.judged[name].energy, two.judged[name].energy, rtol=1e-3, atol=1e-4, equal_nan=True)


def test_horizons_shorter_than_the_time_between_positions_are_noted() -> None:
    model, later = wf.learn(walkers(0, 12)), walkers(1, 3, start=1e4)
    (note,) = wf.score(model, later, horizons=[0.2, 2.0], levels=[], methods=[]).notes
    assert note.startswith("positions are 0.4 s apart")
    assert not wf.score(model, later, horizons=[2.0], levels=[], methods=[]).notes
