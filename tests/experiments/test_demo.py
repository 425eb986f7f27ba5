"""The demo: its questions hold the truth back, its baselines are right, and a small one runs to the end."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

import wakefold as wf
from wakefold.experiments.harbour import demo
from wakefold.experiments.harbour.report import report_page
from wakefold.forecast import rivals
from wakefold.forecast import scores as demo_scores


def straight(speed: float = 5.0, minutes: int = 40, y: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A position a minute along a line."""
    times = 60.0 * np.arange(minutes + 1)
    return np.stack([speed * times, np.full(len(times), y)], axis=1), times


def test_fixes_are_two_minutes_apart_and_the_rest_is_asked_for() -> None:
    points, times = straight()
    asked = demo_scores.questions(points, times)
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
    for off in demo_scores.errors(rivals.constant_velocity, voyages).values():
        assert off.max() < 1e-9
    back = wf.Tracks.from_arrays([points, points[::-1] + np.array([0.0, 1.0])], [times, times], ids=["there", "back"])
    for off in demo_scores.errors(rivals.nearest_track(back), voyages).values():
        assert off.max() < 1e-6


def test_methods_do_not_look_ahead() -> None:
    rng = np.random.default_rng(0)
    points, times = straight()
    past = wf.Tracks.from_arrays([points + rng.normal(0, 20, points.shape) for _ in range(4)], [times] * 4)
    model = wf.learn(past, epsilon=300.0, scale=5.0)
    asked = demo_scores.questions(points, times)
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
    asked = demo_scores.questions(points, times)
    answers = [list(rivals.particle(wf.MHPF(model, 60, levels=n), 30.0)("a", points, times, asked)) for n in ([], 4)]
    for one, other in zip(*answers, strict=True):
        assert np.array_equal(one, other)


def harbour(seed: int, count: int, day: float) -> wf.Tracks:
    """Voyages of 70 minutes up one of two arms of a river, a position every 70 s."""
    rng = np.random.default_rng(seed)
    times = 70.0 * np.arange(61)
    lon, lat = [], []
    for k in range(count):
        x = 6.0 * times + rng.normal(0, 5, 61)
        y = (1 if k % 2 else -1) * 0.4 * np.maximum(x - 10_000, 0) + rng.normal(0, 60)
        lon.append(-74.0 + x / 85_000)
        lat.append(40.6 + y / 111_000)
    start = day * 86400.0 + 8000.0 * np.arange(count) % 76_000
    return wf.Tracks.from_columns(
        agent=np.repeat([f"s{seed}v{k}" for k in range(count)], 61),
        time=(start[:, None] + times).ravel(),
        lon=np.ravel(lon),
        lat=np.ravel(lat),
    )


def test_a_small_demo_runs_to_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, tracks in ((demo.WEEK, harbour(0, 24, 1.0)), (demo.DAY, harbour(1, 3, 3.0))):
        wf.write_tracks(tracks, tmp_path / name, "csv")
    monkeypatch.setattr(demo, "data", lambda name: tmp_path / name)
    monkeypatch.setattr(demo, "PARTICLES", 60)
    lines: list[str] = []
    shares: list[float] = []
    results = demo.run(tmp_path / "out", shares.append, lines.append)
    assert json.loads(json.dumps(results, allow_nan=False)) == results
    assert (results["learned"]["voyages"], results["held_out"]["voyages"]) == (24, 3)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    evidence = [step["evidence"] for step in results["followed"]["steps"]]
    assert evidence[:2] == ["nothing yet", "fix"]
    assert evidence[2].startswith("bound for class")
    assert set(evidence[3:]) == {"fix"}
    assert [row["method"] for row in results["errors"]] == ["MHPF", "BL1", "constant velocity", "nearest track"]
    for row in results["errors"]:
        assert all(math.isfinite(row[name]["mean"]) for name in row if name != "method")
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 3
    assert "http" not in page.replace("http-equiv", "")
    assert any("bound for class" in line for line in lines)
    monkeypatch.setattr(demo, "data", lambda name: tmp_path / demo.WEEK)  # the same day again
    with pytest.raises(ValueError, match="begins within the training week"):
        demo.run(tmp_path / "out", shares.append, lines.append)


def test_the_report_escapes_names(tmp_path: Path) -> None:
    picture = tmp_path / "p.png"
    picture.write_bytes(b"x")
    best = [{"class": 3, "probability": 0.5, "tracks": 2}]
    step = {
        "time": "2020-12-08T06:00:00+00:00",
        "evidence": "bound for class 3",
        "best": best,
        "position_error": 1.0,
        "forecast_error": {"5 min": {"MHPF": 1.0, "constant velocity": 2.0}},
    }
    row = {"method": "MHPF", "in 5 min": {"mean": 1.0, "median": 1.0, "answers": 2}}
    results = {
        "learned": {"voyages": 1, "points": 2, "classes": 3},
        "settings": {"epsilon": 1.0, "scale": 1.0, "sd": 1.0, "particles": 1, "confidence": 0.9, "seed": 0},
        "held_out": {"voyages": 1, "fixes": 2},
        "levels": [500.0],
        "followed": {"voyage": "<script>", "steps": [step | {"evidence": "fix"}, step]},
        "forecast_at": "06:00:00",
        "errors": [row],
        "seconds": 1.0,
    }
    page = report_page(results, dict.fromkeys(("tree", "belief", "forecast"), picture))
    assert "<script>" not in page
    assert "&lt;script&gt;" in page


def test_missing_sample_data_are_said_plainly(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(demo.resources, "files", missing)
    with pytest.raises(ImportError, match=r"pip install \"wakefold\[demo\]\""):
        demo.data(demo.WEEK)


def test_the_real_data_are_a_week_and_the_day_after() -> None:
    pytest.importorskip("tracktable_data", reason="the extra `demo` is not installed")
    past = demo.week()
    held_out = demo.day_after(past)
    assert len(past) > 1000
    assert len(held_out) > 50
    day = held_out.times / 86400
    assert np.unique(np.floor(day)).tolist() == [18604.0]  # 8 December 2020
    assert past.times.max() < held_out.times.min()
    assert (past.times.max() / 86400) < 18604.0
