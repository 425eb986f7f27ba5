"""``wakefold track``: answers, streams, and what is said on the way."""

import csv
import io
import json
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from room import WAKEFOLD, fixes, harbour, run

import wakefold as wf
from wakefold.cli import followers
from wakefold.service import agents, feed, fleet
from wakefold.service import album as pictures
from wakefold.service.answers import csv_line
from wakefold.service.feed import Observation, Refused
from wakefold.service.remarks import Remarks


def test_track_answers_every_observation_of_every_agent(room: Path) -> None:
    code, out, err = run("track harbour.model fixes.csv --levels 300,1000 --forecast 5min")
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
    _, out, _ = run("track harbour.model -", lines)
    _, table, _ = run("track harbour.model fixes.csv")
    answers = [json.loads(line) for line in out.splitlines()]
    for answer, row in zip(answers, csv.DictReader(io.StringIO(table)), strict=True):
        assert answer["estimate"]["lon"] == float(row["lon"])
        assert answer["levels"][0]["probability"] == float(row[f"probability@{answer['levels'][0]['level']:.6g}"])


def test_an_agent_s_answers_do_not_depend_on_the_others(room: Path) -> None:
    _, together, _ = run("track harbour.model fixes.csv")
    _, alone, _ = run("track harbour.model fixes.csv --agent tug")
    assert [line for line in together.splitlines() if line.startswith("tug")] == alone.splitlines()[1:]


FOLLOWERS = ["bl1", "bl1+coarse", "bl2", "calibrated", "trail", "mhpf --rule gsi2017 --likelihood student"]


@pytest.mark.parametrize("name", FOLLOWERS)
def test_every_filter_follows(name: str, room: Path) -> None:
    few = "" if name == "trail" else "--particles 50"
    code, out, err = run(f"track harbour.model fixes.csv {few} --filter {name}")
    assert code == 0, err
    assert len(out.splitlines()) == 18
    assert ("class@" in out) == (name != "bl2")


def test_options_that_a_filter_does_not_read_are_refused(room: Path) -> None:
    for name, option, readers in (
        ("bl1", "--rule gsi2017", "mhpf do"),
        ("bl2", "--levels 2", "trail, mhpf, bl1, bl1+coarse, calibrated do"),
        ("bl2", "--depletion 0.01", "mhpf, bl1, bl1+coarse do"),
        ("calibrated", "--rule arxiv2016", "mhpf do"),
        ("calibrated", "--likelihood gaussian", "mhpf, bl1, bl1+coarse, bl2 do"),  # its default, but given
        ("calibrated", "--depletion 0.01", "mhpf, bl1, bl1+coarse do"),
    ):
        code, _, err = run(f"track harbour.model fixes.csv --filter {name} {option}")
        assert code == 2
        assert f"{option.split()[0]}: --filter {name} does not read it; {readers}" in " ".join(err.split())
    every = {filter: kind.reads for filter, kind in followers.FILTERS.items()}
    assert every.keys() == set(followers.FilterName)
    assert all({"sd", "seed"} <= reads for reads in every.values())


def test_the_calibrated_filter_answers_as_in_the_library(room: Path) -> None:
    _, out, _ = run("track harbour.model fixes.csv --filter calibrated --sd 30m --seed 5 --agent tug --levels 1000m")
    filter = wf.Calibrated(wf.load("harbour.model"), 200, sd=30.0, seed=5)
    belief = None
    for row in csv.DictReader(io.StringIO(fixes())):
        if row["agent"] == "tug":
            fix = wf.Fix(lon=float(row["lon"]), lat=float(row["lat"]), sd=20.0)
            if belief is None:
                belief = filter.start(fix=fix, time=row["time"], agent="tug")
            else:
                belief = filter.step(belief, [fix], time=row["time"])
    last = list(csv.DictReader(io.StringIO(out)))[-1]
    assert belief is not None
    assert float(last["probability@1000"]) == pytest.approx(belief.level(1000.0).probability[0], abs=1e-6)
    assert float(last["ess"]) == pytest.approx(belief.ess, abs=0.1)


def test_a_share_that_draws_no_class_anew_is_pointed_out_once(room: Path) -> None:
    _, plain, err = run("track harbour.model fixes.csv --filter mhpf")
    assert "--depletion" not in err
    _, given, err = run("track harbour.model fixes.csv --filter mhpf --depletion 0.001")
    assert given == plain  # it is the default
    assert err.count("--depletion 0.001 of 200 particles is none") == err.count("--depletion") == 1
    for more in ("--depletion 0", "--depletion 0.0026", "--depletion 0.001 --particles 600"):
        assert "--depletion" not in run(f"track harbour.model fixes.csv --filter mhpf {more}")[2]


def test_a_file_of_tracks_serves_as_observations(room: Path) -> None:
    wf.write_tracks(wf.read_tracks("harbour.csv")[0].select([0, 1]), "some.geojson")
    code, out, err = run("track harbour.model some.geojson")
    rows = list(csv.DictReader(io.StringIO(out)))
    assert code == 0
    assert "GeoJSON" in err
    assert len(rows) == 42
    assert rows[0]["time"] == "2020-12-01T06:00:00.000Z"


def test_bad_lines_are_told_and_cost_the_exit_code_not_the_rest(room: Path) -> None:
    bad = "agent,time,lon,lat\na,2020-12-08T06:00:00Z,-74,40.6\na,then,-74,40.6\na,2020-12-08T05:00:00Z,-74,40.6\n"
    code, out, err = run("track harbour.model - --filter mhpf", bad + "a,2020-12-08T06:01:00Z,-73.999,40.6\n")
    assert code == 1
    assert len(out.splitlines()) == 3
    assert "line 3 refused: time: 'then'" in err
    assert "line 4 refused: time runs backwards" in err
    assert "2 lines refused" in err


def test_one_wrong_time_does_not_silence_an_agent(room: Path) -> None:
    def follow(*times: str) -> tuple[list[str], str]:
        given = "agent,time,lon,lat\n" + "".join(f"a,{time},-74,40.6\n" for time in times)
        _, out, err = run("track harbour.model - --filter mhpf --particles 5", given)
        return [row["event"] for row in csv.DictReader(io.StringIO(out))], err

    right = [f"2020-12-08T06:0{i}:00Z" for i in range(6)]
    events, err = follow(right[0], "1e300", right[1])
    assert events == ["start", "step"]
    assert "line 3 refused: time: '1e300'" in err
    events, err = follow(right[0], "2999-01-01T00:00:00Z", *right[1:])
    assert (events[:3], len(events)) == (["start", "restart", "restart"], 5)  # two right lines are lost
    assert err.count("time runs backwards: evidence of") == 1
    assert "2 lines refused (time runs backwards) in all" in err
    assert follow("2999-01-01T00:00:00Z", *reversed(right))[0] == ["start"]  # they do not agree with each other
    back = ["2020-12-08T05:00:00Z", "2020-12-08T05:01:00Z"]
    events, _ = follow(right[0], *back, right[1], *back, right[2])  # never three in a row
    assert (len(events), "restart" in events) == (3, False)


def test_agents_are_bounded_and_a_long_silence_starts_anew(room: Path) -> None:
    line = "{},2020-12-08T{}:00Z,-74,40.6\n"
    given = "agent,time,lon,lat\n" + "".join(line.format(*x) for x in [("a", "06:00"), ("b", "06:01"), ("a", "06:02")])
    _, out, err = run("track harbour.model - --max-agents 1", given)
    assert [row["event"] for row in csv.DictReader(io.StringIO(out))] == ["start", "start", "start"]
    assert err.count("dropped: over 1 live agents") == 1
    assert "2 agents dropped in all" in err
    assert "3 observations of 2 agents answered" in err
    _, out, _ = run("track harbour.model - --max-gap 90s", given)
    assert [row["event"] for row in csv.DictReader(io.StringIO(out))] == ["start", "start", "restart"]


def test_what_is_kept_of_agents_met_is_bounded(room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(agents, "REMEMBERED", 3)
    crowd = fleet.Fleet(wf.BL2(wf.load("harbour.model"), 5), [], [], 2, 1e9, Remarks(lambda line: None))
    for i in range(50):
        names = f"agent {i}", f"agent {i - i % 2}"  # some come back
        assert sum(map(len, crowd([Observation(i, name, float(i), float(i)) for name in names]))) == 2
    assert crowd.met == 50
    kept = sum(len(value) for value in vars(crowd).values() if hasattr(value, "__len__"))
    assert kept <= 2 + 3


@pytest.mark.parametrize("filter", ["bl1", "mhpf", "calibrated"])
def test_a_block_is_answered_as_its_lines_one_by_one(filter: str, room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines of several agents, some of them wrong: errors cost only themselves, whatever comes together."""
    header, *good = fixes().splitlines()
    half, back = "ferry,2020-12-08T06:01:10Z,-73.99,,20,,", "ferry,2020-12-08T06:03:10Z,-74,40.6,20,,"
    last = ["tug,2020-12-08T06:09:00Z,-73.98,40.61,20,99999,300", "tug,2020-12-08T06:10:00Z,-73.98,40.612,20,,"]
    spoilt = [*good[:3], half, *good[3:], back, *last]
    model = wf.load("harbour.model")
    outs = []
    for size, wait in ((1, 1e9), (5, 1e9), (99, 1e9), (99, -1.0)):
        monkeypatch.setattr(fleet, "WAIT", wait)
        follower = followers.follower(followers.FilterName(filter), model, {"particles": 30, "levels": [300.0]})
        crowd = fleet.Fleet(follower, [300.0, 1000.0], [60.0, 300.0], 10, 1e9, Remarks(print))
        lines = [(n, line.encode()) for n, line in enumerate(spoilt, 2)]
        blocks = [[(1, header.encode())], *(lines[k : k + size] for k in range(0, len(lines), size))]
        parts = [part for block in feed.read(blocks) for part in crowd(block)]
        assert max(map(len, parts)) == (2 if wait < 0 else min(size, len(spoilt)))  # what is refused costs no time
        outs.append([one if isinstance(one, Refused) else csv_line(one.answer) for part in parts for one in part])
    assert outs[0] == outs[1] == outs[2] == outs[3]
    refused = [one for one in outs[0] if isinstance(one, Refused)]
    assert [one.why.split(":")[0] for one in refused] == ["lat", "time runs backwards", "class"]
    assert len(outs[0]) == len(spoilt)


def test_an_album_keeps_a_handful_of_moments_however_long_the_feed(room: Path) -> None:
    model = wf.load("harbour.model")
    follower = wf.BL1(model, 20)
    crowd = fleet.Fleet(follower, [300.0], [], 10, 1e9, Remarks(print))
    album = pictures.Album([300.0])
    for i in range(100):
        seen = Observation(i, "a", float(i), float(i), wf.Fix(model.tracks[0][0]))
        ((one,),) = crowd([seen])
        assert isinstance(one, fleet.Answered)
        album.add(one.seen, one.belief, crowd)
    times = [moment.time for moment in album.moments()]
    assert len(times) == pictures.ROWS
    assert times[0] == 0.0
    assert times[-1] > 80
    assert np.ptp(np.diff(times)) <= 16


def test_the_name_of_the_answers_says_their_form(room: Path) -> None:
    line = "agent,time,lon,lat\na,2020-12-08T06:00:00Z,-74,40.6\n"
    for name, options, is_json in (("a.jsonl", "", True), ("a.ndjson", "", True), ("a.jsonl", "--format csv", False)):
        assert run(f"track harbour.model - -o {name} {options}", line)[0] == 0
        assert Path(name).read_text().startswith("{") == is_json
    given = '{"agent": "a", "time": 1, "lon": -74, "lat": 40.6}\n'
    for name, is_json in (("b.csv", False), ("b.txt", True)):
        assert run(f"track harbour.model - -o {name}", given)[0] == 0
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
    assert "18 observations of 2 agents" in run("track harbour.model ms.csv --time-format ms")[2]
    code, _, err = run("track harbour.model fixes.csv --time-format ms")
    assert code == 1
    assert "is not like ms" in err
    assert "see --time-format" in run("track harbour.model ms.csv")[2]


def test_heights_need_a_unit_or_a_comma(room: Path) -> None:
    assert "heights are written 500m or 500,2000" in run("track harbour.model fixes.csv --levels 500")[2]
    for levels in ("500m", "500,2000"):
        assert "class@500," in run(f"track harbour.model fixes.csv --levels {levels}")[1]


def test_equal_horizons_are_forecast_once(room: Path) -> None:
    header = run("track harbour.model fixes.csv --forecast 5min,300s")[1].splitlines()[0]
    assert header.count("lon+300s") == 1


def test_a_fix_far_from_every_track_is_off_the_map(room: Path) -> None:
    place = {"near": (-73.99, 40.6002), "far": (-73.99, 40.9)}
    given = "agent,time,lon,lat,sd\n"
    for minute, where in enumerate(("near", "far", "near", "far")):
        given += "a,2020-12-08T06:{:02d}:00Z,{},{},30\n".format(minute, *place[where])
    given += "b,2020-12-08T06:00:00Z,-73.99,40.9,30\n"
    _, out, _ = run("track harbour.model - --filter mhpf", given)
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


@pytest.fixture
def stream(room: Path) -> Iterator[subprocess.Popen[bytes]]:
    command = [*WAKEFOLD, "track", "harbour.model", "-"]
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
