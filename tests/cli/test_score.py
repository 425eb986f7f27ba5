"""``wakefold score``: what it prints and writes, how it cuts tracks, what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import wakefold as wf
from wakefold.cli.app import app

QUICK = ["--methods", "constant-velocity,nearest-windows", "--horizons", "5min,10min", "--levels", "500m,2000m"]


def voyages(seed: int, day: int, count: int = 12) -> wf.Tracks:
    """Ships up one of two arms of a river, a position a minute, with a rest of 20 minutes on the way."""
    rng = np.random.default_rng(seed)
    agent, time, lon, lat = [], [], [], []
    for k in range(count):
        t = np.arange(60)
        x = 330.0 * (t - np.clip(t - 30, 0, 20)) + rng.normal(0, 5, 60)
        y = (1 if k % 2 else -1) * 0.5 * np.maximum(x - 4000, 0) + rng.normal(0, 50)
        agent += [f"ship{k % 4}"] * 60
        time += (86400.0 * day + 5400.0 * (k // 4) + 300.0 * k + 60.0 * t).tolist()
        lon += (-74.0 + x / 85_000).tolist()
        lat += (40.6 + y / 111_000).tolist()
    return wf.Tracks.from_columns(agent=agent, time=time, lon=lon, lat=lat)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("score")
    wf.write_tracks(voyages(0, 1), out / "past.csv")
    wf.write_tracks(voyages(1, 2), out / "later.csv")
    call("learn", out / "past.csv", "--stop", "150m,10min", "--max-gap", "20min", "-o", out / "model")
    return out


def call(*args: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, [str(a) for a in args])
    assert result.exit_code == code, result.output
    return result.output


def test_it_prints_a_table_and_writes_numbers_and_a_page(folder: Path) -> None:
    said = call(
        "score", folder / "model", folder / "later.csv", *QUICK, "--json", folder / "s.json", "--out", folder / "r"
    )
    lines = said.splitlines()
    assert any(line.startswith("Best in 5 min") for line in lines)
    assert any(line.startswith("nearest windows") for line in lines)
    told = json.loads((folder / "s.json").read_text())
    assert list(told["methods"]) in (["nearest windows", "constant velocity"], ["constant velocity", "nearest windows"])
    row = told["methods"]["constant velocity"]["300"]
    assert {"mean", "median", "energy", "cover50", "cover90", "n"} <= set(row)
    assert set(told["classes"]) == {"nearest windows", "prior"}
    assert set(told["classes"]["prior"]) == {"500", "2000"}
    page = (folder / "r/report.html").read_text()
    assert page.count("data:image/png;base64,") == 3
    assert "nearest windows" in page
    assert {p.name for p in (folder / "r").iterdir()} == {
        "report.html",
        "horizons.png",
        "calibration.png",
        "answers.png",
    }


def test_tracks_are_cut_as_those_of_the_model_were(folder: Path) -> None:
    shaping = dict(wf.load(folder / "model").shaping)
    assert shaping.pop("spacing") > 0
    assert shaping == {
        "max_gap": 1200.0,
        "max_speed": None,
        "stop_radius": 150.0,
        "stop_time": 600.0,
        "min_length": 0.0,
    }
    cut = wf.read_tracks(folder / "later.csv")[0].segment("20min", stop_radius=150, stop_time=600)
    assert f"Tracks({len(cut)} tracks" in call("score", folder / "model", folder / "later.csv", *QUICK)
    whole = wf.read_tracks(folder / "later.csv")[0].segment("20min", stop_radius=1, stop_time=3600)
    assert len(whole) < len(cut)
    said = call("score", folder / "model", folder / "later.csv", *QUICK, "--stop", "1m,1h")
    assert f"Tracks({len(whole)} tracks" in said


def test_a_model_that_keeps_no_cuts_takes_the_defaults_of_learn(folder: Path, tmp_path: Path) -> None:
    from dataclasses import replace

    replace(wf.load(folder / "model"), shaping={}).save(tmp_path / "old")
    assert wf.load(tmp_path / "old").shaping == {}
    cut = wf.read_tracks(folder / "later.csv")[0].segment("30min")
    assert f"Tracks({len(cut)} tracks" in call("score", tmp_path / "old", folder / "later.csv", *QUICK)


def test_what_was_learned_is_told(folder: Path) -> None:
    assert "note: 4 agents of these tracks" in call("score", folder / "model", folder / "past.csv", *QUICK)


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--methods", "oracle"], 2, "'oracle' is none of all, constant-velocity"),
        (["--horizons", "soon"], 2, "'soon' is not a duration"),
        (["--horizons", "9h"], 1, "nothing can be asked: none of"),
        (["--min-length", "900km"], 1, "no track is left to ask about"),
        (["--questions", "some"], 2, "some"),
    ],
)
def test_what_cannot_be_asked_is_an_error(folder: Path, options: list[str], code: int, message: str) -> None:
    assert message in " ".join(call("score", folder / "model", folder / "later.csv", *options, code=code).split())


def test_planar_tracks_do_not_fit_a_model_of_longitudes(folder: Path, tmp_path: Path) -> None:
    rows = "\n".join(f"a,{60 * k},{300 * k},0" for k in range(20))
    (tmp_path / "plane.csv").write_text(f"agent,time,x,y\n{rows}\n")
    said = call("score", folder / "model", tmp_path / "plane.csv", code=1)
    assert "the model was learned from geodetic tracks, these are planar" in said
