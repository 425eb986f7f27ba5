"""The demo: its data are a week and the day after, and a small one runs to the end."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

import wakefold as wf
from wakefold.experiments.harbour import demo
from wakefold.experiments.harbour.report import report_page
from wakefold.forecast.methods import NAMES


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
    scores = results["scores"]
    assert json.loads((tmp_path / "out" / "scores.json").read_text()) == scores
    assert set(scores["methods"]) == set(NAMES)
    for rows in scores["methods"].values():
        assert all(math.isfinite(rows[h]["energy"]) for h in ("300", "900", "1800"))
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
    row = {"mean": 1.0, "median": 1.0, "energy": 1.0, "cover50": 0.5, "cover90": 0.9, "n": 2}
    results = {
        "learned": {"voyages": 1, "points": 2, "classes": 3},
        "settings": {"epsilon": 1.0, "scale": 1.0, "sd": 1.0, "particles": 1, "confidence": 0.9, "seed": 0},
        "held_out": {"voyages": 1, "fixes": 2},
        "levels": [500.0],
        "followed": {"voyage": "<script>", "steps": [step | {"evidence": "fix"}, step]},
        "forecast_at": "06:00:00",
        "scores": {
            "questions": {"horizons": {"300": 2}, "asks": "now"},
            "methods": {"MHPF": {"300": row}, "<b>": {"300": row | {"n": 1}}},
        },
        "verdict": ["best in 5 min by energy score: <b>"],
        "seconds": 1.0,
    }
    page = report_page(results, dict.fromkeys(("tree", "belief", "forecast"), picture))
    assert "<script>" not in page
    assert "&lt;script&gt;" in page
    assert "<b>:" not in page
    assert "&lt;b&gt; are slow" in page


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
