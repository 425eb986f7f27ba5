"""Events of ships: what is there is found, what is not is not, and it is written as the command says."""

import csv
import json

import numpy as np
import pytest
from typer.testing import CliRunner

import wakefold as wf
from wakefold import cli, plot
from wakefold.io.places import read_places
from wakefold.plot import events as plot_events
from wakefold.relations.events import events
from wakefold.relations.events.stops import Stop, berths, moments, runs, stops
from wakefold.tracks.projection import Projection

PLACE = Projection(-74.0, 40.0)
MINUTES = np.arange(0, 300.0)  # of five hours


def path(legs: list[tuple[float, float, float]], start: tuple[float, float], seed: int) -> np.ndarray:
    """Positions each minute of a ship that goes at (vx, vy) m/s for so many minutes, one leg after the other."""
    velocity = np.concatenate([np.tile([vx, vy], (int(n), 1)) for n, vx, vy in legs])[: len(MINUTES) - 1]
    points = np.vstack([start, start + np.cumsum(velocity * 60.0, axis=0)])
    return points + np.random.default_rng(seed).normal(0, 5, points.shape)


def fleet() -> wf.Tracks:
    """Two ships that meet at sea, two in convoy, one at anchor alone, two moored one after the other at one berth."""
    meet = [(100, 3, 0), (80, 0.1, 0.2), (119, 0, 4)], [(100, -3, 0), (80, 0.1, 0.2), (119, 0, -4)]
    ships = {
        "left": path(meet[0], (-18000, 0), 1),
        "right": path(meet[1], (18100, 0), 2),
        "lead": path([(299, 4, 1)], (0, 40000), 3),
        "follow": path([(299, 4, 1)], (-600, 40000), 4),
        "alone": path([(60, 5, 0), (180, 0.1, 0), (59, 5, 0)], (0, -30000), 5),
        "early": path([(30, 5, 0), (60, 0, 0), (209, -5, 0)], (-9000, -60000), 6),
        "late": path([(150, 5, 0), (90, 0, 0), (59, -5, 0)], (-45000, -60000), 7),
    }
    return wf.Tracks.from_arrays(list(ships.values()), [MINUTES * 60] * len(ships), list(ships), PLACE)


@pytest.fixture(scope="module")
def found() -> events.Found:
    return events.find(fleet())


def of(found: events.Found, kind: str) -> list[events.Event]:
    return [e for e in found.events if e.kind == kind]


def test_the_ships_that_meet_are_the_rendezvous(found):
    (meeting,) = of(found, "rendezvous")
    assert meeting.agents == ("left", "right")
    assert meeting.probability > 0.8
    assert meeting.begin == pytest.approx(100 * 60, abs=600)
    assert meeting.end == pytest.approx(180 * 60, abs=600)
    assert meeting.distance == pytest.approx(100, abs=30)
    assert meeting.speed < 0.5
    assert np.linalg.norm(meeting.place - [300, 500]) < 600
    assert not of(found, "encounter")


def test_the_ships_under_way_together_are_the_convoy(found):
    (convoy,) = of(found, "convoy")
    assert convoy.agents == ("follow", "lead")
    assert convoy.distance == pytest.approx(600, abs=20)
    assert convoy.end - convoy.begin > 240 * 60


def test_who_is_slow_alone_loiters_and_a_berth_is_a_port(found):
    (loitering,) = of(found, "loitering")
    assert loitering.agents == ("alone",)
    assert np.isnan(loitering.distance)
    assert sorted(e.agents[0] for e in of(found, "port visit")) == ["early", "late"]


def test_a_place_is_a_berth_if_it_is_used_again_or_somebody_is_tied_up():
    def stop(agent: int, first: int, last: int, x: float, radius: float = 60.0) -> Stop:
        return Stop(agent, first, last, np.array([x, 0.0]), radius)

    # (0) two that overlap: an encounter, not a berth; (1000) one after the other; (2000) tied up; (3000) at anchor.
    given = [
        stop(0, 0, 100, 0.0),
        stop(1, 50, 120, 50.0),
        stop(2, 0, 60, 1000.0),
        stop(3, 200, 260, 1020.0),
        stop(4, 0, 400, 2000.0, radius=5.0),
        stop(5, 0, 400, 3000.0, radius=90.0),
    ]
    assert sorted(berths(given, 60.0)[:, 0]) == [1000.0, 1020.0, 2000.0]
    assert berths([], 60.0).shape == (0, 2)


def test_silence_is_nowhere():
    times = np.array([0.0, 60.0, 120.0, 4000.0, 4060.0])
    tracks = wf.Tracks.from_arrays([np.column_stack([times, times])], [times], ["a"])
    m = moments(tracks, 60.0, 900.0)
    assert m.time(m.frame).tolist() == [0.0, 60.0, 120.0, 4020.0]
    assert np.allclose(m.position[:, 0], m.time(m.frame))
    assert not stops(m)
    assert runs(np.array([0, 0, 0, 1]), np.array([0, 1, 5, 6]), np.array([True] * 4), 1) == [(0, 2), (2, 3), (3, 4)]


def test_the_order_of_the_tracks_does_not_matter(found):
    tracks = fleet()
    again = events.find(tracks.select(np.arange(len(tracks))[::-1]))
    assert [e[:5] for e in again.events] == [e[:5] for e in found.events]


def test_an_event_is_drawn(found, tmp_path):
    for kind in ("rendezvous", "loitering"):
        path = tmp_path / f"{kind}.png"
        plot.save(plot_events.event(found, of(found, kind)[0], PLACE), path)
        assert path.stat().st_size > 20_000


def test_the_command_writes_what_was_found(found, tmp_path):
    file = tmp_path / "fleet.csv"
    wf.write_tracks(fleet(), file)
    for out in ("events.csv", "events.geojson"):
        done = CliRunner().invoke(cli.app, ["relations", str(file), "-o", str(tmp_path / out), "--json"])
        assert done.exit_code == 0, done.stderr
        told = json.loads(done.stdout)["events"]
        assert [row["kind"] for row in told] == [e.kind for e in found.events]
    with (tmp_path / "events.csv").open() as rows:
        read = list(csv.DictReader(rows))
    assert [row["kind"] for row in read] == [row["kind"] for row in told]
    meeting = next(row for row in read if row["kind"] == "rendezvous")
    assert float(meeting["lon"]) == pytest.approx(-74.0, abs=0.01)
    features = json.loads((tmp_path / "events.geojson").read_text())["features"]
    assert len(features) == len(told)
    assert features[0]["geometry"]["type"] == "Point"


def test_wrong_usage_is_said_before_the_work(tmp_path):
    for args, text in (
        (["--slow", "fast"], "is not a speed"),
        (["-o", str(tmp_path / "events.xls")], "ends in .csv"),
        (["--together", "0"], "above 0"),
    ):
        done = CliRunner().invoke(cli.app, ["relations", "none.csv", *args])
        assert done.exit_code == 2
        assert text in " ".join(done.stderr.split())
    assert CliRunner().invoke(cli.app, ["relations", "none.csv"]).exit_code == 1


def beside(x: float) -> wf.Tracks:
    """Two ships that lie alongside each other for four hours, then sail away in turn, ``x`` metres east."""
    out = [path([(240, 0, 0), (59, 4, dy)], (x, 12.0 * k), k) for k, dy in enumerate((1.0, -1.0))]
    return wf.Tracks.from_arrays(out, [MINUTES * 60] * 2, ["a", "b"], PLACE)


def test_two_at_a_berth_are_neither_a_convoy_nor_an_encounter():
    found = events.find(beside(0.0))
    assert {e.kind for e in found.events} == {"port visit"}  # tied up: a berth found from the tracks
    assert found.at_berths == 1


def swinging() -> wf.Tracks:
    """Two that swing 60 m about each other for two hours: no berth by their tracks."""
    t = MINUTES[:120] / 60 * 2 * np.pi
    around = 60.0 * np.column_stack([np.cos(t), np.sin(t)])
    away = np.column_stack([300.0 * np.arange(1, 61), np.zeros(60)])
    ships = [np.vstack([-away[::-1] + s * around[0], s * around, away + s * around[-1]]) for s in (1.0, -1.0)]
    return wf.Tracks.from_arrays(ships, [60.0 * np.arange(len(s)) for s in ships], ["a", "b"], PLACE)


def test_berths_that_are_told_are_left_out(tmp_path):
    tracks = swinging()
    assert [e.kind for e in events.find(tracks).events if len(e.agents) == 2 and e.kind != "convoy"] == ["encounter"]
    assert not [e for e in events.find(tracks, known=[[-74.0, 40.0]]).events if e.kind in ("encounter", "rendezvous")]
    far = events.find(tracks, known=[[-73.9, 40.0]])
    assert [e.kind for e in far.events if e.kind == "encounter"] == ["encounter"]
    with pytest.raises(ValueError, match="berth 1 is no longitude and latitude"):
        events.find(tracks, known=[[500000.0, 4000000.0]])

    file = tmp_path / "two.csv"
    wf.write_tracks(tracks, file)
    csv_, geo = tmp_path / "berths.csv", tmp_path / "berths.geojson"
    csv_.write_text("name,LAT,LON\nquay,40.0,-74.0\n")
    point = {"type": "Point", "coordinates": [-74.0, 40.0]}
    geo.write_text(json.dumps({"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": point}]}))
    for berths_file in (csv_, geo):
        done = CliRunner().invoke(cli.app, ["relations", str(file), "--berths", str(berths_file), "--json"])
        assert done.exit_code == 0, done.stderr
        told = json.loads(done.stdout)
        assert told["left_out_at_berths"] == 1
        assert "encounter" not in [row["kind"] for row in told["events"]]


def test_a_damaged_list_of_berths_is_named(tmp_path):
    file = tmp_path / "berths"
    for text, message in [
        ("lon,lat\n1,2\n3,north\n", "line 3: not two numbers"),
        ("lon,lat\n1\n", "line 2: not two numbers"),
        ("a,b\n1,2\n", "header with lon and lat"),
        ("", "header with lon and lat"),
        ('{"type": "Point"', "damaged GeoJSON"),
        ('{"type": "Polygon", "coordinates": []}', "feature 1: places are points, not Polygon"),
        ('{"type": "Point", "coordinates": [1]}', "feature 1: not two numbers"),
        ("[3]", "feature 1: places are points, not int"),
    ]:
        file.write_text(text)
        with pytest.raises(ValueError, match=message):
            read_places(file)
    done = CliRunner().invoke(cli.app, ["relations", "none.csv", "--berths", str(tmp_path / "none")])
    assert done.exit_code == 1
    assert "none" in done.stderr


def test_the_place_of_a_planar_event_is_not_called_degrees(tmp_path):
    made = swinging()
    tracks = wf.Tracks.from_arrays(list(made), [made.times_of(i) for i in range(len(made))], made.ids.tolist())
    file, out = tmp_path / "planar.csv", tmp_path / "events.csv"
    wf.write_tracks(tracks, file)
    done = CliRunner().invoke(cli.app, ["relations", str(file), "-o", str(out), "--json"])
    assert done.exit_code == 0, done.stderr
    with out.open() as rows:
        read = list(csv.DictReader(rows))
    assert read
    told = json.loads(done.stdout)["events"]
    for row in (*read, *told):
        assert {"x", "y"} <= row.keys()
        assert not {"lon", "lat"} & row.keys()
    assert float(read[0]["begin"]) == told[0]["begin"] < 86400  # seconds on the data's own clock, and no date of 1970
    refused = CliRunner().invoke(cli.app, ["relations", str(file), "-o", str(tmp_path / "events.geojson")])
    assert refused.exit_code == 2
    assert "planar" in refused.stderr


def test_degrees_are_no_berths_of_planar_tracks(tmp_path):
    made = swinging()
    tracks = wf.Tracks.from_arrays(list(made), [made.times_of(i) for i in range(len(made))], made.ids.tolist())
    file, berths_file = tmp_path / "planar.csv", tmp_path / "berths"
    wf.write_tracks(tracks, file)
    for text in ("lon,lat\n0,0\n", "longitude,latitude\n0,0\n", '{"type": "Point", "coordinates": [0, 0]}'):
        berths_file.write_text(text)
        done = CliRunner().invoke(cli.app, ["relations", str(file), "--berths", str(berths_file)])
        assert done.exit_code == 1
        assert "the tracks are planar" in done.stderr
    berths_file.write_text("lon,lat,x,y\n-74,40,0,0\n")
    done = CliRunner().invoke(cli.app, ["relations", str(file), "--berths", str(berths_file), "--json"])
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["left_out_at_berths"] == 1


@pytest.mark.parametrize(("place", "begin", "date"), [(PLACE, 1.6e9, True), (PLACE, 0.0, False), (None, 1.6e9, True)])
def test_an_event_is_drawn_from_a_date_where_there_is_one(place, begin, date):
    made = swinging()
    times = [begin + made.times_of(i) for i in range(len(made))]
    found = events.find(wf.Tracks.from_arrays(list(made), times, made.ids.tolist(), place))
    labels = [ax.get_xlabel() for part in plot_events.event(found, found.events[0], place).subfigs for ax in part.axes]
    assert [label.endswith("UTC") for label in labels if label.startswith("minutes from")] == [date]
