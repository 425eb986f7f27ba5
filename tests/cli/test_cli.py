"""The command line: every example of the help and of docs/cli.md runs; streams, refusals and exit codes."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from room import WAKEFOLD, harbour, run
from typer.testing import CliRunner

import wakefold as wf
from wakefold import cli

DOCS = Path(__file__).resolve().parents[2] / "docs"
COMMANDS = ("learn", "track", "score", "show", "info", "demo", "relations", "reproduce")


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


def test_a_model_tells_how_its_tracks_were_cut(room: Path) -> None:
    asked = "--stop 150m,10min --min-length 1km --max-speed 40 --spacing 200m"
    assert run(f"learn harbour.csv -o cut.model {asked}")[0] == 0
    assert wf.load(room / "cut.model").shaping == {
        "max_gap": 1800.0,
        "max_speed": 40.0,
        "stop_radius": 150.0,
        "stop_time": 600.0,
        "min_length": 1000.0,
        "spacing": 200.0,
    }
    assert wf.load(room / "harbour.model").shaping["stop_time"] is None


def test_a_model_grows_where_it_is(room: Path) -> None:
    assert run("learn harbour.csv -o growing.model")[0] == 0
    before = wf.load(room / "growing.model")
    code, out, _ = run("learn growing.model --extend wednesday.csv tuesday.csv")
    assert code == 0
    assert "20 tracks added to 10 tracks" in out
    after = wf.load(room / "growing.model")
    assert after.tracks.ids.tolist()[:10] == before.tracks.ids.tolist()
    assert {"ship9#0", "ship9#1", "boat9#0"} <= set(after.tracks.ids.tolist())
    assert (after.shaping, after.sd) == (before.shaping, before.sd)
    assert after.filtration.same_as(wf.learn(after.tracks).filtration)
    code, out, err = run("learn growing.model --extend wednesday.csv")  # once more
    assert code == 1
    assert "10 tracks left out, of agents and times that the model has" in err
    code, out, err = run("learn growing.model --forget 8d --json -o young.model")
    assert code == 0
    said = json.loads(out)
    young = wf.load(room / "young.model").tracks
    assert said["tracks"] == len(young) == 30 - said["forgotten"]
    assert young.times.min() > after.tracks.times.max() - 8.1 * 86_400
    assert len(wf.load(room / "growing.model").tracks) == 30


def test_what_a_model_cannot_take_is_refused(room: Path) -> None:
    assert run("learn people.csv --columns agent=who,time=t,x=px,y=py -o crowd.model")[0] == 0
    for line, code, why in (
        ("learn harbour.csv --extend tuesday.csv", 1, "harbour.csv is not a stored model"),
        ("learn harbour.model --extend nowhere.csv", 1, "nowhere.csv"),
        ("learn harbour.model --extend -", 2, "standard input"),
        ("learn harbour.model --extend tuesday.csv --max-gap 1h", 2, "--max-gap"),
        ("learn harbour.model --extend tuesday.csv --linkage complete", 2, "--linkage"),
        ("learn harbour.model --forget never", 2, "--forget"),
        ("learn harbour.model --extend tuesday.csv -o people.csv", 2, "--output"),
        (
            "learn crowd.model --extend tuesday.csv",
            1,
            "the new tracks are 2-D, with lon and lat, those of the model 2-D",
        ),
        ("learn crowd.model --forget 90d", 1, "no dates"),
    ):
        got, _, err = run(line)
        assert (got, why in err) == (code, True), (line, err)


def test_planar_tracks_choose_their_own_spacing(room: Path) -> None:
    code, out, _ = run("learn people.csv --columns agent=who,time=t,x=px,y=py -o own.model --json")
    assert code == 0
    assert json.loads(out)["spacing"] == pytest.approx(11.0 / 50)


def test_learning_says_who_compares_the_tracks(room: Path) -> None:
    code, _, err = run("learn harbour.csv -o c.model --linkage complete --executor ray")
    assert (code, "--executor" in err) == (2, True)


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
    west, east = feature["geometry"]["coordinates"]
    assert np.allclose([x for x, _ in west], [179.8, 179.9, 180.0, 180.0], atol=1e-5)
    assert np.allclose([x for x, _ in east], [-180.0, -179.9], atol=1e-5)


def test_exports_go_to_standard_output(room: Path) -> None:
    model = wf.load("harbour.model")
    code, out, err = run("show harbour.model --newick -")
    assert (code, out) == (0, model.filtration.newick() + "\n")
    assert "largest" in err
    assert run("show harbour.model --linkage -")[1].startswith("left,right,height,tracks\n")
    assert json.loads(run("show harbour.model --geojson - --level 300m")[1])["type"] == "FeatureCollection"
    assert not Path("-").exists()


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
    said = run("learn twins.csv -o t.model")[1]
    assert "1 agent is in two places at once, such as twin" in said
    assert "12 tracks cut into 12 pieces" in said
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
    (room / "clock.csv").write_text("agent,time,lon,lat\na,0,-123.1,-10\na,600000,-75.7,10\n")
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


def test_help_is_quick_because_it_imports_nothing_heavy() -> None:
    heavy = ("numpy", "numba", "scipy", "pyarrow", "pyproj", "matplotlib", "rich")
    code = f"import sys, wakefold.cli; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
