"""The command line: every example of the help and of docs/cli.md runs; streams, refusals and exit codes."""

import csv
import io
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import wakefold as wf
from wakefold import cli
from wakefold.service import album as pictures
from wakefold.service import fleet
from wakefold.service.feed import Observation

DOCS = Path(__file__).resolve().parents[2] / "docs"
COMMANDS = ("learn", "track", "show", "info", "demo", "relations", "reproduce")
WAKEFOLD = [sys.executable, "-m", "wakefold"]


def harbour(shift: float = 0.0) -> str:
    """Two ferry lines in a harbour, ten crossings, as CSV."""
    rows = ["agent,time,lon,lat"]
    for k in range(10):
        for i in range(21):
            lon = -74.0 + 0.002 * i + shift
            lat = 40.60 + 0.0004 * k + (0.0015 * i if k % 2 else 0.0)
            rows.append(f"ship{k},2020-12-0{1 + k % 7}T06:{i:02d}:00Z,{lon:.6f},{lat:.6f}")
    return "\n".join(rows) + "\n"


def fixes() -> str:
    """A ferry with an observed class, and a tug."""
    rows = ["agent,time,lon,lat,sd,class,level"]
    for i in range(8):
        rows.append(f"ferry,2020-12-08T06:{i:02d}:00Z,{-74.0 + 0.002 * i:.6f},40.6002,20,,")
        if i == 3:
            rows.append("ferry,2020-12-08T06:03:30Z,,,,track:ship0#0,300")
        rows.append(f"tug,2020-12-08T06:{i:02d}:00Z,{-74.0 + 0.002 * i:.6f},{40.6 + 0.0015 * i:.6f},20,,")
    return "\n".join(rows) + "\n"


def people() -> str:
    rows = ["who,t,px,py"]
    rows += [f"{k},{i},{i + 0.1 * k},{0.5 * k}" for k in range(6) for i in range(12)]
    return "\n".join(rows) + "\n"


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A directory with the files that the examples name, as the current one."""
    path = tmp_path_factory.mktemp("room")
    for name, text in {
        "harbour.csv": harbour(),
        "monday.csv": harbour(),
        "tuesday.csv": harbour(0.0001).replace("ship", "boat"),
        "people.csv": people(),
        "fixes.csv": fixes(),
    }.items():
        (path / name).write_text(text)
    before = Path.cwd()
    os.chdir(path)
    try:
        assert run("learn harbour.csv -o harbour.model")[0] == 0
        yield path
    finally:
        os.chdir(before)


def run(line: str, given: str | None = None) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command."""
    done = CliRunner().invoke(cli.app, shlex.split(line), input=given)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, done.stdout, done.stderr


def examples() -> list[str]:
    """The examples of every help text and of docs/cli.md: what follows a $ at the start of a line."""
    helps = [CliRunner().invoke(cli.app, [*command, "--help"]).stdout for command in ([], *([c] for c in COMMANDS))]
    page = (DOCS / "cli.md").read_text()
    found = [match for text in (*helps, page) for match in re.findall(r"^\s*\$ (.*wakefold.*)$", text, re.MULTILINE)]
    return list(dict.fromkeys(found))


def test_every_command_has_a_help_with_an_example() -> None:
    for command in COMMANDS:
        code, out, _ = run(f"{command} --help")
        assert code == 0
        assert f"$ wakefold {command}" in out


@pytest.mark.parametrize("example", [e for e in examples() if "demo" not in e and "reproduce" not in e])
def test_example_runs(example: str, room: Path) -> None:  # tests of their own run the demo and the experiments
    if "|" in example or ">" in example:
        bin_ = Path(sys.executable).parent
        environ = {**os.environ, "PATH": f"{bin_}{os.pathsep}{os.environ['PATH']}"}
        done = subprocess.run(["bash", "-c", example], capture_output=True, env=environ, timeout=120, check=False)
        assert done.returncode == 0, done.stderr.decode()
        assert done.stdout
        return
    assert example.startswith("wakefold ")
    code, out, err = run(example.removeprefix("wakefold "))
    assert code == 0, err
    assert out or err


def test_the_reference_names_every_option() -> None:
    page = (DOCS / "cli.md").read_text()
    for command in COMMANDS:
        for option in re.findall(r"--[a-z][a-z-]+", run(f"{command} --help")[1]):
            assert option == "--help" or f"`{option}" in page, f"{command} {option}"


def test_learn_says_what_it_read_and_writes_json(room: Path) -> None:
    (room / "spoilt.csv").write_text(harbour() + "ship0,never,1,2\n")
    code, out, _ = run("learn spoilt.csv -o spoilt.model --spacing 150m")
    assert code == 0
    assert "211 rows read, 210 kept" in out
    assert "1 rejected: no time" in out
    code, out, err = run("learn spoilt.csv -o spoilt.model --spacing 150m --json")
    said = json.loads(out)
    assert (code, said["tracks"], said["spacing"], said["report"]["kept"]) == (0, 10, 150.0, 210)
    assert "rejected" in err
    assert len(wf.load("spoilt.model").tracks) == 10


def test_planar_tracks_choose_their_own_spacing(room: Path) -> None:
    code, out, _ = run("learn people.csv --columns agent=who,time=t,x=px,y=py -o own.model --json")
    assert code == 0
    assert json.loads(out)["spacing"] == pytest.approx(11.0 / 50)


def test_track_answers_every_observation_of_every_agent(room: Path) -> None:
    code, out, err = run("track harbour.model fixes.csv --levels 300,1000 --forecast 5min --particles 50")
    rows = list(csv.DictReader(io.StringIO(out)))
    assert code == 0
    assert "17 observations of 2 agents" in err
    assert [r["agent"] for r in rows] == [line.split(",")[0] for line in fixes().splitlines()[1:]]
    assert [r["event"] for r in rows if r["agent"] == "ferry"][:2] == ["start", "step"]
    last = [r for r in rows if r["agent"] == "tug"][-1]
    assert abs(float(last["lat"]) - 40.6105) < 0.001
    assert 0 < float(last["probability@300"]) <= 1
    assert float(last["lon+300s"]) > float(last["lon"])


def test_json_lines_in_json_lines_out_with_the_same_beliefs(room: Path) -> None:
    given = list(csv.DictReader(io.StringIO(fixes())))
    lines = "".join(json.dumps({k: v for k, v in row.items() if v}) + "\n" for row in given)
    _, out, _ = run("track harbour.model - --particles 50", lines)
    _, table, _ = run("track harbour.model fixes.csv --particles 50")
    answers = [json.loads(line) for line in out.splitlines()]
    for answer, row in zip(answers, csv.DictReader(io.StringIO(table)), strict=True):
        assert answer["estimate"]["lon"] == float(row["lon"])
        assert answer["levels"][0]["probability"] == float(row[f"probability@{answer['levels'][0]['level']:.6g}"])


def test_an_agent_s_answers_do_not_depend_on_the_others(room: Path) -> None:
    _, together, _ = run("track harbour.model fixes.csv")
    _, alone, _ = run("track harbour.model fixes.csv --agent tug")
    assert [line for line in together.splitlines() if line.startswith("tug")] == alone.splitlines()[1:]


@pytest.mark.parametrize("name", ["bl1", "bl1+coarse", "bl2", "mhpf --rule gsi2017 --likelihood student"])
def test_every_filter_follows(name: str, room: Path) -> None:
    code, out, err = run(f"track harbour.model fixes.csv --particles 50 --filter {name}")
    assert code == 0, err
    assert len(out.splitlines()) == 18
    assert ("class@" in out) == (name != "bl2")


def test_a_share_that_draws_no_class_anew_is_pointed_out_once(room: Path) -> None:
    _, plain, err = run("track harbour.model fixes.csv")
    assert "--depletion" not in err
    _, given, err = run("track harbour.model fixes.csv --depletion 0.001")
    assert given == plain  # it is the default
    assert err.count("--depletion 0.001 of 200 particles is none") == err.count("--depletion") == 1
    for more in ("--depletion 0", "--depletion 0.0026", "--depletion 0.001 --particles 600"):
        assert "--depletion" not in run(f"track harbour.model fixes.csv {more}")[2]


def test_a_file_of_tracks_serves_as_observations(room: Path) -> None:
    wf.write_tracks(wf.read_tracks("harbour.csv")[0].select([0, 1]), "some.geojson")
    code, out, err = run("track harbour.model some.geojson --particles 50")
    rows = list(csv.DictReader(io.StringIO(out)))
    assert code == 0
    assert "GeoJSON" in err
    assert len(rows) == 42
    assert rows[0]["time"] == "2020-12-01T06:00:00.000Z"


def test_bad_lines_are_told_and_cost_the_exit_code_not_the_rest(room: Path) -> None:
    bad = "agent,time,lon,lat\na,2020-12-08T06:00:00Z,-74,40.6\na,then,-74,40.6\na,2020-12-08T05:00:00Z,-74,40.6\n"
    code, out, err = run("track harbour.model -", bad + "a,2020-12-08T06:01:00Z,-73.999,40.6\n")
    assert code == 1
    assert len(out.splitlines()) == 3
    assert "line 3 refused: time: 'then'" in err
    assert "line 4 refused: time runs backwards" in err
    assert "2 lines refused" in err


def test_one_wrong_time_does_not_silence_an_agent(room: Path) -> None:
    def follow(*times: str) -> tuple[list[str], str]:
        given = "agent,time,lon,lat\n" + "".join(f"a,{time},-74,40.6\n" for time in times)
        _, out, err = run("track harbour.model - --particles 5", given)
        return [row["event"] for row in csv.DictReader(io.StringIO(out))], err

    right = [f"2020-12-08T06:0{i}:00Z" for i in range(6)]
    events, err = follow(right[0], "1e300", right[1])
    assert events == ["start", "step"]
    assert "line 3 refused: time: '1e300'" in err
    events, err = follow(right[0], "2999-01-01T00:00:00Z", *right[1:])
    assert (events[:3], len(events)) == (["start", "restart", "restart"], 5)  # two right lines are lost
    assert err.count("time runs backwards") == 2
    assert follow("2999-01-01T00:00:00Z", *reversed(right))[0] == ["start"]  # they do not agree with each other
    back = ["2020-12-08T05:00:00Z", "2020-12-08T05:01:00Z"]
    events, _ = follow(right[0], *back, right[1], *back, right[2])  # never three in a row
    assert (len(events), "restart" in events) == (3, False)


def test_agents_are_bounded_and_a_long_silence_starts_anew(room: Path) -> None:
    line = "{},2020-12-08T{}:00Z,-74,40.6\n"
    given = "agent,time,lon,lat\n" + "".join(line.format(*x) for x in [("a", "06:00"), ("b", "06:01"), ("a", "06:02")])
    _, out, err = run("track harbour.model - --max-agents 1", given)
    assert [row["event"] for row in csv.DictReader(io.StringIO(out))] == ["start", "start", "start"]
    assert err.count("dropped") == 2
    assert "3 observations of 2 agents answered" in err
    _, out, _ = run("track harbour.model - --max-gap 90s", given)
    assert [row["event"] for row in csv.DictReader(io.StringIO(out))] == ["start", "start", "restart"]


def test_what_is_kept_of_agents_met_is_bounded(room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fleet, "REMEMBERED", 3)
    crowd = fleet.Crowd(wf.BL2(wf.load("harbour.model"), 5), [], [], 2, 1e9, lambda line: None)
    for i in range(50):
        crowd(Observation(i, f"agent {i}", float(i), float(i)))
        crowd(Observation(i, f"agent {i - i % 2}", float(i), float(i)))  # some come back
    assert crowd.met == 50
    kept = sum(len(value) for value in vars(crowd).values() if hasattr(value, "__len__"))
    assert kept <= 2 + 3


def test_learning_says_who_compares_the_tracks(room: Path) -> None:
    code, _, err = run("learn harbour.csv -o c.model --linkage complete --executor ray")
    assert (code, "--executor" in err) == (2, True)


def test_an_album_keeps_a_handful_of_moments_however_long_the_feed(room: Path) -> None:
    model = wf.load("harbour.model")
    follower = wf.BL1(model, 20)
    crowd = fleet.Crowd(follower, [300.0], [], 10, 1e9, print)
    album = pictures.Album([300.0])
    for i in range(100):
        seen = Observation(i, "a", float(i), float(i), wf.Fix(model.tracks[0][0]))
        album.add(seen, crowd(seen)[1], crowd)
    times = [moment.time for moment in album.moments()]
    assert len(times) == pictures.ROWS
    assert times[0] == 0.0
    assert times[-1] > 80
    assert np.ptp(np.diff(times)) <= 16


def test_show_exports_what_the_tree_says(room: Path) -> None:
    code, out, _ = run("show harbour.model --newick t.nwk --linkage z.npy --geojson c.geojson --level 300m --json")
    tree = wf.load("harbour.model").filtration
    assert code == 0
    assert json.loads(out)["tracks"] == 10
    assert Path("t.nwk").read_text() == tree.newick() + "\n"
    assert np.array_equal(np.load("z.npy"), tree.linkage_matrix())
    features = json.loads(Path("c.geojson").read_text())["features"]
    assert [f["properties"]["class"] for f in features] != []
    assert {f["properties"]["class"] for f in features} == set(tree.alive(300.0).tolist())
    assert sum(len(f["geometry"]["coordinates"]) for f in features) == 10


def test_a_coordinate_across_the_antimeridian_does_not_jump(tmp_path: Path) -> None:
    from wakefold.model.export import write_classes

    lon = np.array([179.8, 179.9, -180.0, -179.9])
    tracks = wf.Tracks.from_columns(agent=["a"] * 4, time=np.arange(4.0), lon=lon, lat=np.full(4, 10.0))
    write_classes(tracks, wf.Filtration.fit(tracks), 0.0, tmp_path / "c.geojson")
    (feature,) = json.loads((tmp_path / "c.geojson").read_text())["features"]
    assert np.allclose(np.diff(np.array(feature["geometry"]["coordinates"][0])[:, 0]), 0.1, atol=1e-5)


def test_exports_go_to_standard_output(room: Path) -> None:
    model = wf.load("harbour.model")
    code, out, err = run("show harbour.model --newick -")
    assert (code, out) == (0, model.filtration.newick() + "\n")
    assert "largest" in err
    assert run("show harbour.model --linkage -")[1].startswith("left,right,height,tracks\n")
    assert json.loads(run("show harbour.model --geojson - --level 300m")[1])["type"] == "FeatureCollection"
    assert not Path("-").exists()


def test_the_name_of_the_answers_says_their_form(room: Path) -> None:
    line = "agent,time,lon,lat\na,2020-12-08T06:00:00Z,-74,40.6\n"
    for name, options, is_json in (("a.jsonl", "", True), ("a.ndjson", "", True), ("a.jsonl", "--format csv", False)):
        assert run(f"track harbour.model - --particles 5 -o {name} {options}", line)[0] == 0
        assert Path(name).read_text().startswith("{") == is_json
    given = '{"agent": "a", "time": 1, "lon": -74, "lat": 40.6}\n'
    for name, is_json in (("b.csv", False), ("b.txt", True)):
        assert run(f"track harbour.model - --particles 5 -o {name}", given)[0] == 0
        assert Path(name).read_text().startswith("{") == is_json


def test_milliseconds_are_pointed_out_and_read(room: Path) -> None:
    rows = [
        f"{'ab'[k]},{1_607_407_200_000 + 60_000 * i},{-74 + 0.002 * i},{40.6 + 0.01 * k}"
        for k in (0, 1)
        for i in range(9)
    ]
    (room / "ms.csv").write_text("\n".join(["agent,time,lon,lat", *rows]) + "\n")
    code, _, err = run("info ms.csv")
    assert code == 1
    assert "18 times lie beyond the year 2100" in err
    assert "--time-format" in err
    assert "2020-12-08 06:00:00" in run("info ms.csv --time-format ms")[1]
    assert "18 kept" in run("learn ms.csv --time-format ms -o ms.model")[1]
    assert "18 kept" in run("relations ms.csv --time-format ms")[1]
    assert "18 observations of 2 agents" in run("track harbour.model ms.csv --time-format ms --particles 5")[2]
    code, _, err = run("track harbour.model fixes.csv --time-format ms --particles 5")
    assert code == 1
    assert "is not like ms" in err
    assert "see --time-format" in run("track harbour.model ms.csv --particles 5")[2]


def test_learn_tells_of_ships_that_lie_still(room: Path) -> None:
    rows = [f"moored{k},2020-12-01T06:{i:02d}:00Z,-74.000{i % 2},40.6" for k in range(11) for i in range(3)]
    (room / "moored.csv").write_text(harbour() + "\n".join(rows) + "\n")
    assert "11 of 21 tracks stay within 100 m; see --stop, --min-length" in run("learn moored.csv -o moored.model")[1]
    (room / "moored.csv").write_text(harbour() + "\n".join(rows[3:]) + "\n")
    assert "stay within" not in run("learn moored.csv -o moored.model")[1]


def test_info_of_files_and_models(room: Path) -> None:
    code, out, _ = run("info harbour.csv harbour.model --json")
    file, model = json.loads(out)
    assert code == 0
    assert (file["kind"], file["agents"], file["points"]) == ("tracks", 10, 210)
    assert file["area"]["west"] == pytest.approx(-74.0)
    assert (model["kind"], model["tracks"]) == ("model", 10)
    assert "2020-12-01 06:00:00 to 2020-12-07" in run("info harbour.csv")[1]


@pytest.mark.parametrize(
    ("line", "code", "said"),
    [
        ("learn nowhere.csv -o m", 1, "error: nowhere.csv"),
        ("learn harbour.csv -o m --min-length 900km", 1, "no track is left"),
        ("learn harbour.csv -o m --spacing 0.001m", 1, "give a larger --spacing"),
        ("learn harbour.csv -o m --columns agent=who", 1, "no column 'who'"),
        ("learn harbour.csv", 2, "--output"),
        ("track people.csv fixes.csv", 1, "not a stored model"),
        ("track harbour.model people.csv", 1, "--columns"),
        ("track harbour.model fixes.csv --filter bl1 --rule gsi2017", 2, "--rule"),
        ("track harbour.model fixes.csv --filter bl2 --levels 2", 2, "--levels"),
        ("track harbour.model fixes.csv --forecast 99999d", 2, "--forecast"),
        ("track harbour.model fixes.csv -o fixes.csv", 2, "--output"),
        ("show harbour.model --geojson c.json", 2, "--level"),
        ("show harbour.model --newick - --json", 2, "standard output"),
        ("show harbour.model --newick - --linkage -", 2, "standard output"),
        ("learn - -o m", 2, "standard input is read by"),
        ("info -", 2, "standard input is read by"),
        ("relations -", 2, "standard input is read by"),
        ("relations harbour.csv --pictures /proc/p", 2, "--pictures"),
        ("frobnicate", 2, "No such command"),
    ],
)
def test_failures_are_one_line_and_an_exit_code(line: str, code: int, said: str, room: Path) -> None:
    got, _, err = run(line)
    assert got == code
    assert said in err
    assert "Traceback" not in err
    if code == 1:
        assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    "options",
    [
        "learn --spacing wide",
        "learn --spacing 0",
        "learn --epsilon 0",
        "learn --threads 0",
        "learn --stop 100m",
        "learn --stop 0,10min",
        "learn --max-gap 0",
        "learn --min-length long",
        "learn --columns agent",
        "learn --output people.csv",
        "learn --output people.csv/m",
        "learn --output harbour.model/m",
        "learn --output .",
        "learn --output -",
        "learn --output /proc/m/n",
        "track --levels high",
        "track --levels 500",
        "track --levels 0",
        "track --forecast soon",
        "track --particles 0",
        "track --depletion nan",
        "track --sd 0",
        "track --seed -1",
        "track --max-gap 0",
        "track --columns where=lon",
        "track --output .",
        "track --output harbour.model/a.csv",
        "track --output no/where.csv",
        "track --output /proc/a.csv",
        "track --picture a.xyz",
        "show --level -1",
        "show --output a.xyz",
        "show --newick no/where.nwk",
        "show --output /proc/a.png",
        "demo --out people.csv",
        "demo --out /proc/demo",
    ],
)
def test_a_wrong_option_is_named_before_anything_is_read(options: str, room: Path) -> None:
    command, option, value = options.split()
    names = {"learn": "no.csv", "track": "no.model no.csv", "show": "no.model", "demo": ""}[command]
    rest = "-o m" if command == "learn" and option != "--output" else ""
    code, out, err = run(f"{command} {names} {option} {value} {rest}")
    assert (code, out) == (2, "")
    assert option in err


def test_heights_need_a_unit_or_a_comma(room: Path) -> None:
    assert "heights are written 500m or 500,2000" in run("track harbour.model fixes.csv --levels 500")[2]
    for levels in ("500m", "500,2000"):
        assert "class@500," in run(f"track harbour.model fixes.csv --levels {levels} --particles 5")[1]


def test_equal_horizons_are_forecast_once(room: Path) -> None:
    header = run("track harbour.model fixes.csv --forecast 5min,300s --particles 5")[1].splitlines()[0]
    assert header.count("lon+300s") == 1


def test_a_fix_far_from_every_track_is_off_the_map(room: Path) -> None:
    place = {"near": (-73.99, 40.6002), "far": (-73.99, 40.9)}
    given = "agent,time,lon,lat,sd\n"
    for minute, where in enumerate(("near", "far", "near", "far")):
        given += "a,2020-12-08T06:{:02d}:00Z,{},{},30\n".format(minute, *place[where])
    given += "b,2020-12-08T06:00:00Z,-73.99,40.9,30\n"
    _, out, _ = run("track harbour.model -", given)
    events = [row["event"] for row in csv.DictReader(io.StringIO(out))]
    assert events == ["start", "off-map", "recovery", "off-map", "off-map"]


def test_no_observation_is_an_error(room: Path) -> None:
    code, _, err = run("track harbour.model fixes.csv --agent nobody")
    assert code == 1
    assert "no observation of agent nobody" in err
    for given in ("", "agent,time,lon,lat\n"):
        code, _, err = run("track harbour.model -", given)
        assert code == 1
        assert "no observation" in err
    code, _, err = run("track harbour.model fixes.csv --agent tug --agent nobody")
    assert code == 0
    assert "no observation of agent nobody" in err


def test_plane_coordinates_for_a_geodetic_model_are_pointed_out_once(room: Path) -> None:
    code, out, err = run("track harbour.model -", "agent,time,x,y\na,1,0,0\na,61,100,0\n")
    assert code == 0
    assert len(out.splitlines()) == 3
    assert err.count("metres about 40.6") == 1
    code, _, err = run("track harbour.model -", "agent,time,x\na,1,0\n")
    assert code == 1
    assert "refused: x: the model is 2-D" in err


def test_columns_by_position_in_a_table_without_a_header(room: Path) -> None:
    (room / "bare.csv").write_text("".join(harbour().splitlines(keepends=True)[1:]))
    code, out, _ = run("info bare.csv --columns agent=0,time=1,lon=2,lat=3 --json")
    assert (code, json.loads(out)["points"]) == (0, 210)


def test_learning_goes_on_from_a_checkpoint_of_the_same_tracks_only(room: Path) -> None:
    import wakefold as wf

    for _ in range(2):  # from nothing, then from all that is known
        assert run("learn harbour.csv -o kept.model --checkpoint kept")[0] == 0
        assert wf.load("kept.model").filtration.gaps.tolist() == wf.load("harbour.model").filtration.gaps.tolist()
    (room / "other.csv").write_text("".join(harbour().splitlines(keepends=True)[:-1]))
    code, _, problem = run("learn other.csv -o other.model --checkpoint kept")
    assert code == 1
    assert "kept is a checkpoint of other tracks" in problem
    assert not (room / "other.model").exists()


def test_two_ships_of_one_name_are_told_apart_by_their_speed(room: Path) -> None:
    rows = [f"twin,2020-12-01T06:{i:02d}:00Z,-{74 + 2 * (i // 10)}.{i:03d},40.6\n" for i in range(20)]
    (room / "twins.csv").write_text(harbour() + "".join(rows))
    remark = "1 leg from point to point would take more than 60 m/s; see --max-speed"
    assert remark in run("learn twins.csv -o t.model")[1]
    said = run("learn twins.csv --max-speed 60 -o t.model")[1]
    assert "m/s" not in said
    assert "11 tracks cut into 12 pieces" in said
    code, _, problem = run("learn twins.csv --max-speed 0 -o t.model")
    assert code == 2
    assert "must be above 0" in problem


def test_a_gap_near_the_sampling_interval_is_pointed_out(room: Path) -> None:
    rows = [
        f"far{k},{1_607_000_000 + 1500 * i + 900 * (i % 3)},{-74 + 0.1 * i},{40.6 + k}"
        for k in (0, 1)
        for i in range(40)
    ]
    (room / "rare.csv").write_text("\n".join(["agent,time,lon,lat", *rows]) + "\n")
    assert "near the 30 min that cut a track; see --max-gap" in run("learn rare.csv -o rare.model")[1]
    assert "--max-gap" not in run("learn rare.csv --max-gap 3h -o rare.model")[1]
    assert "--max-gap" not in run("learn harbour.csv -o rare.model")[1]


def test_ships_at_rest_do_not_choose_the_spacing(room: Path) -> None:
    rows = [f"moored{k},2020-12-01T06:{i:02d}:00Z,-74.0{i % 2},40.6\n" for k in range(30) for i in range(3)]
    rows = [row.replace("-74.01", "-74.0001").replace("-74.00,", "-74.0000,") for row in rows]
    (room / "berths.csv").write_text(harbour() + "".join(rows))
    spacing = [
        json.loads(run(f"learn {name} -o s.model --json")[1])["spacing"] for name in ("harbour.csv", "berths.csv")
    ]
    assert spacing[0] == pytest.approx(spacing[1], rel=1e-3)
    (room / "berths.csv").write_text("agent,time,lon,lat\n" + "".join(rows))
    assert json.loads(run("learn berths.csv -o s.model --json")[1])["spacing"] == 20.0


def test_info_names_the_side_and_no_invented_date(room: Path) -> None:
    (room / "clock.csv").write_text("agent,time,lon,lat\na,0,-123.1,-10\na,60,-75.7,10\n")
    said = run("info clock.csv")[1]
    assert "10.0000°S..10.0000°N, 123.1000°W..75.7000°W" in said
    assert "1970" not in said


def test_any_locale_shows_any_text(room: Path) -> None:
    environ = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([*WAKEFOLD, "info", "harbour.csv"], capture_output=True, env=environ, check=True)
    assert "74.0000°W" in done.stdout.decode("utf-8")


def test_debug_shows_the_traceback(room: Path) -> None:
    code, _, err = run("--debug learn nowhere.csv -o m")
    assert code == 1
    assert "Traceback" in err


def test_version() -> None:
    assert run("--version")[1].strip() == f"wakefold {wf.__version__}"


@pytest.fixture
def stream(room: Path) -> Iterator[subprocess.Popen[bytes]]:
    command = [*WAKEFOLD, "track", "harbour.model", "-", "--particles", "20"]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    yield process
    process.kill()
    process.communicate()


def send(process: subprocess.Popen[bytes], text: str) -> None:
    assert process.stdin is not None
    process.stdin.write(text.encode())
    process.stdin.flush()


def test_a_feed_is_answered_line_by_line_and_ctrl_c_ends_it(stream: subprocess.Popen[bytes]) -> None:
    assert stream.stdout is not None
    assert stream.stderr is not None
    header, *lines = harbour().splitlines(keepends=True)
    send(stream, header)
    for line in lines[:3]:  # each answer comes while the feed stays open
        send(stream, line)
        if line is lines[0]:
            assert stream.stdout.readline().startswith(b"agent,")
        assert stream.stdout.readline().startswith(b"ship0,")
    stream.send_signal(signal.SIGINT)
    assert stream.wait(timeout=30) == 130
    said = stream.stderr.read().decode()
    assert "3 observations of 1 agent answered" in said
    assert "Traceback" not in said


def test_a_closed_output_ends_it(stream: subprocess.Popen[bytes]) -> None:
    assert stream.stdout is not None
    assert stream.stderr is not None
    header, *lines = harbour().splitlines(keepends=True)
    send(stream, header + lines[0])
    stream.stdout.readline()
    stream.stdout.close()
    deadline = time.monotonic() + 30
    try:
        while stream.poll() is None and time.monotonic() < deadline:
            send(stream, lines[1])
            time.sleep(0.05)
    except BrokenPipeError:
        pass
    assert stream.wait(timeout=30) == 141
    assert b"Traceback" not in stream.stderr.read()


def test_help_is_quick_because_it_imports_nothing_heavy() -> None:
    heavy = ("numpy", "numba", "scipy", "pyarrow", "pyproj", "matplotlib", "rich")
    code = f"import sys, wakefold.cli; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
