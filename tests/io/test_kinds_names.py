"""Who is who, and options that did nothing: each kind, with variations."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_kinds_time import forms, notes, read

import wakefold.io as wio
from wakefold.io import rules

MINUTES = [f"2024-05-01T10:{k:02d}:00Z" for k in range(60)]


def fleet(agents, **more):
    """A table of fixes a minute and 100 m apart, by agent; ``more`` are columns."""
    names = [*more, "time", "lon", "lat"]
    rows = [
        [*(more[name][k] for name in more), MINUTES[k], 10.0, round(55 + k / 1000 + number, 4)]
        for k, number in enumerate(agents)
    ]
    return names, rows


@pytest.mark.parametrize(
    "courses", [[45.2, 45.3, 45.2, 45.9], [45.0, 46.0, 45.0, 46.0], [359, 0, 359, 1], [12.5, 12.5, 12.5, 12.5]]
)
def test_a_course_is_no_name(tmp_path, courses):
    for data in forms(*fleet([0] * 4, mmsi=[7] * 4, track=courses)):
        tracks, report = read(tmp_path, data)
        assert list(tracks.ids) == ["7"]
        np.testing.assert_allclose(tracks.columns["cog"], courses)
        assert "courses, not names" in notes(report)


@pytest.mark.parametrize("trips", [[1, 1, 2, 2], [0, 1, 2, 3], ["a1", "a1", "a2", "a2"], [100, 100, 300, 300]])
def test_a_track_of_its_own_groups(tmp_path, trips):
    for data in forms(*fleet([0] * 4, mmsi=[7] * 4, track=trips)):
        tracks, _ = read(tmp_path, data)
        assert list(tracks.ids) == list(dict.fromkeys(map(str, trips)))
        assert set(tracks.attributes["agent"]) == {"7"}


def test_tracks_of_each_agent_may_have_the_same_numbers(tmp_path):
    for data in forms(*fleet([0, 0, 1, 1], mmsi=[7, 7, 8, 8], track=[1, 2, 1, 3])):
        tracks, _ = read(tmp_path, data)
        assert list(tracks.ids) == ["7/1", "2", "8/1", "3"]
        assert list(tracks.attributes["agent"]) == ["7", "7", "8", "8"]


@pytest.mark.parametrize("name", ["user_id", "mmsi", "VesselID", "icao24", "person", "vehicle_id"])
def test_a_number_of_the_row_is_not_the_agent(tmp_path, name):
    for data in forms(*fleet([0] * 3 + [1] * 3, id=list(range(6)), **{name: [0] * 3 + [1] * 3})):
        tracks, _ = read(tmp_path, data)
        assert list(tracks.ids) == ["0", "1"]
        assert list(tracks.lengths) == [3, 3]


def test_rows_that_each_have_an_agent_of_their_own_are_pointed_out(tmp_path):
    for data in forms(*fleet([0] * 3 + [1] * 3, id=list(range(6)), walker=[0] * 3 + [1] * 3)):
        tracks, report = read(tmp_path, data)
        assert len(tracks) == 6
        assert "every row has an agent of its own: another column may name them, of walker" in notes(report)
        assert len(read(tmp_path, data, columns={"agent": "walker"})[0]) == 2


@pytest.mark.parametrize(
    "spelled",
    [
        ["9.99000006E+08", "9.99000006e+08", "999000006", "999000006.0"],
        ["000219", "219", "219.0", "0219"],
        ["2.19E+08", "219000000", "2.19e8", "219000000.00"],
    ],
)
def test_one_number_in_many_spellings_is_one_agent(tmp_path, spelled):
    names, rows = fleet([0] * 4, mmsi=spelled)
    for form in (names, ["MMSI", "BaseDateTime", "LON", "LAT"]):
        text = "\n".join([",".join(form), *(",".join(map(str, row)) for row in rows)])
        tracks, report = read(tmp_path, text)
        assert len(tracks) == 1
        assert list(tracks.lengths) == [4]
        assert ("may hide digits" in notes(report)) == spelled[0].startswith("2.19")


def test_names_that_only_look_like_numbers_stay(tmp_path):
    names = ["1234e5", "4e1234", "1e5", "E12", "0x10", "1.5"]
    tracks, _ = read(tmp_path, "".join(["icao24,time,lon,lat\n", *(f"{name},0,1,2\n" for name in names)]))
    assert list(tracks.ids) == names


def shared(steps=20, away=(4.0, 52.0)):
    rows = []
    for k in range(steps):
        rows.append(f"8,2024-05-01T10:{k:02d}:00,{10 + k * 0.003:.4f},55.0\n")
        rows.append(f"8,2024-05-01T10:{k:02d}:30,{away[0] + k * 0.003:.4f},{away[1]}\n")
    return "mmsi,time,lon,lat\n" + "".join(rows)


def test_one_number_in_two_places_is_two_tracks(tmp_path):
    tracks, report = read(tmp_path, shared())
    assert list(tracks.ids) == ["8", "8#2"]
    assert list(tracks.lengths) == [20, 20]
    assert tracks.speed.max() < 5
    assert "1 agent is in two places at once, such as 8: " in notes(report)


@pytest.mark.parametrize(("away", "bodies"), [(0.0, 1), (0.001, 1), (0.5, 2)])
def test_two_places_at_the_very_same_times(tmp_path, away, bodies):
    """Two receivers that hear one ship a little apart are one body; hundreds of metres make no second one."""
    rows = []
    for k in range(10):
        for lat in (55.0, 55.0 + away):
            rows.append(f"8,2024-05-01T10:{k:02d}:00,{10 + k * 0.001:.4f},{lat}\n")
    tracks, report = read(tmp_path, "mmsi,time,lon,lat\n" + "".join(rows))
    assert len(tracks) == bodies
    assert list(tracks.lengths) == [10] * bodies
    assert report.rejected == ({} if bodies == 2 else {"duplicate" if away == 0 else "same time": 10})


def test_a_leap_parts_a_track(tmp_path):
    rows = [(k, 10 + k / 1000) for k in range(10)] + [(k, 40 + k / 1000) for k in range(10, 20)]
    text = "mmsi,time,lon,lat\n" + "".join(f"8,2024-05-01T10:{k:02d}:00,{lon:.4f},55\n" for k, lon in rows)
    tracks, report = read(tmp_path, text)
    assert list(tracks.lengths) == [10, 10]
    assert report.rejected == {}


def test_fast_bodies_need_a_higher_limit_and_a_note_says_so(tmp_path):
    rows = "".join(f"3c0001,2017-02-05T16:00:{k:02d}Z,{1 + k * 0.0028:.4f},45\n" for k in range(20))
    _, report = read(tmp_path, "icao24,time,lon,lat\n" + rows)
    assert report.rejected == {"jump": 19}
    assert "--max-speed" in notes(report)
    for limit in (400.0, None):
        assert read(tmp_path, "icao24,time,lon,lat\n" + rows, max_speed=limit)[1].kept == 20


@given(
    steps=st.lists(st.tuples(st.integers(1, 50), st.floats(-180, 180), st.floats(-89, 89)), min_size=1, max_size=60),
    limit=st.floats(10, 1e6),
)
def test_no_two_neighbours_that_are_kept_are_too_far_apart(steps, limit):
    time = np.cumsum([step for step, _, _ in steps]).astype(float)
    position = [np.array([lon for _, lon, _ in steps]), np.array([lat for _, _, lat in steps])]
    codes = np.zeros(len(time), dtype=np.int32)
    body = rules.bodies(codes, time, position, geodetic=True, limit=limit)
    assert (body == 0).any()
    for number in set(body.tolist()) - {-1}:
        rows = body == number
        lon, lat = position[0][rows], position[1][rows]
        away = rules.great_circle(lon[:-1], lat[:-1], lon[1:], lat[1:])
        assert (away <= limit * np.diff(time[rows]) * (1 + 1e-9)).all()
        assert number == 0 or rows.sum() >= rules.LEAST


POINTS = "\n".join(
    json.dumps(
        {
            "type": "Feature",
            "properties": {"id": k, "user": k // 2, "time": MINUTES[k]},
            "geometry": {"type": "Point", "coordinates": [116.3, 39.98 + k / 1e4]},
        }
    )
    for k in range(4)
)
LINES = json.dumps(
    {
        "type": "Feature",
        "properties": {"id": 1, "user": "u", "moments": MINUTES[:2]},
        "geometry": {"type": "LineString", "coordinates": [[116.3, 39.98], [116.3, 39.981]]},
    }
)


def test_columns_of_geojson_are_its_properties(tmp_path):
    tracks, _ = read(tmp_path, POINTS, columns={"agent": "user"})
    assert list(tracks.lengths) == [2, 2]
    tracks, report = read(tmp_path, LINES, columns={"agent": "user", "time": "moments"})
    assert list(tracks.ids) == ["u"]
    assert report.untimed == 0
    for text, there in ((POINTS, "id, user and time"), (LINES, "id, user and moments")):
        for key in ("agent", "time"):
            with pytest.raises(wio.ReadError, match=rf"'nosuch' \(for {key}\); there are {there}"):
                read(tmp_path, text, columns={key: "nosuch"})
        with pytest.raises(wio.ReadError, match="positions of GeoJSON are its coordinates"):
            read(tmp_path, text, columns={"lon": "id", "lat": "id"})


@pytest.mark.parametrize(
    "text",
    [
        '<gpx><trk><trkseg><trkpt lat="1" lon="2"/></trkseg></trk></gpx>',
        "!AIVDM,1,1,,A,1>pf7hOP1TJv<C0HOHP3Q2miP000,0*42,1325394060\n",
        "*T*,u,terrestrial,1,0,*P*,terrestrial,2,1,1,0,7,2020-12-01 00:00:00,-74.0,40.0\n",
        "TRACK.R1=[[593 42 95];[588 48 96]];\n",
        "<kml><Placemark><LineString><coordinates>1,2</coordinates></LineString></Placemark></kml>",
    ],
)
def test_columns_of_formats_without_any_are_refused(tmp_path, text):
    with pytest.raises(wio.ReadError, match=r"columns \(--columns\) do not apply"):
        read(tmp_path, text, columns={"agent": "x"})


def test_names_that_are_nowhere_list_what_there_is(tmp_path):
    for data in forms(*fleet([0], mmsi=[7], speed=[1])):
        with pytest.raises(
            wio.ReadError, match=r"no .*'sped' \(for sog\); there are mmsi, speed.*did you mean 'speed'"
        ):
            read(tmp_path, data, columns={"sog": "sped"})
    wide = ",".join(f"c{k}" for k in range(1000))
    with pytest.raises(wio.ReadError, match="and 980 more") as caught:
        read(tmp_path, f"{wide}\n", columns={"agent": "nosuch", "x": "c1", "y": "c2"})
    assert len(str(caught.value)) < 500


def test_the_other_body_keeps_what_is_known_of_the_ship(tmp_path):
    text = "".join(line + (",AEGIR\n" if k else ",name\n") for k, line in enumerate(shared(4).splitlines()))
    tracks, _ = read(tmp_path, text)
    assert list(tracks.attributes["name"]) == ["AEGIR", "AEGIR"]
    assert list(tracks.attributes["agent"]) == ["8", "8#2"]


def test_agents_of_parquet_with_odd_types(tmp_path):
    table = {"id": pa.array([b"a", b"b"]), "t": [0.0, 1.0], "x": [0.0, 1.0], "y": [0.0, 1.0]}
    sink = pa.BufferOutputStream()
    pa.parquet.write_table(pa.table(table), sink)
    assert list(read(tmp_path, sink.getvalue().to_pybytes())[0].ids) == ["a", "b"]


def test_control_characters_of_names_are_escaped(tmp_path):
    names = ["a\nb", "c\x1b[2J", "d\u202ee", "\u0645\u200c"]  # the last is Persian, and stays
    fixes = ({"id": name, "time": k, "lon": 1, "lat": 2, "name": "x\ty"} for k, name in enumerate(names))
    rows = "".join(json.dumps(fix) + "\n" for fix in fixes)
    tracks, _ = read(tmp_path, rows)
    assert list(tracks.ids) == ["a\\nb", "c\\x1b[2J", "d\\u202ee", "\u0645\u200c"]
    assert list(tracks.attributes["name"]) == ["x\\ty"] * 4
    gpx = '<gpx><trk><name>a&#10;b</name><trkseg><trkpt lat="1" lon="2"/></trkseg></trk></gpx>'
    assert list(read(tmp_path, gpx)[0].ids) == ["a\\nb"]
