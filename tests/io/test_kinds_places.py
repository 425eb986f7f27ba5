"""Positions and formats that were refused or read wrongly: each kind, with variations."""

from __future__ import annotations

import json
import sqlite3
import struct
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_io_fuzz import SAMPLES, geopackage
from test_io_source import archive
from test_kinds_time import MAY, notes, read

import wakefold.io as wio
from wakefold import Tracks
from wakefold.io.coordinates import degrees
from wakefold.tracks.projection import Projection, cut_at_seam

relaxed = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
TIME = "2024-05-01T10:00:00Z"


def place(tracks):
    return tracks.projection.to_geodetic(tracks.points)


@pytest.mark.parametrize(
    ("text", "axis", "value"),
    [
        ("46.519850N", "lat", 46.51985),
        ("46.519850 S", "lat", -46.51985),
        ("W 7.5", "lon", -7.5),
        ("46 31.191 N", "lat", 46.51985),
        ("46°31.191'N", "lat", 46.51985),
        ("46°31'11.46\"N", "lat", 46.51985),
        ("-46 31 11.46", "lat", -46.51985),
        ("4631.191N", "lat", 46.51985),
        ("00731.191E", "lon", 7.51985),
        ("46,51985", "lat", 46.51985),
        ("46.519850E", "lat", None),
        ("46 61 N", "lat", None),
        ("N 46 S", "lat", None),
        ("-46 N", "lat", None),
        ("46.5 31 N", "lat", None),
        ("north", "lat", None),
        ("", "lat", None),
    ],
)
def test_degrees_as_people_write_them(text, axis, value):
    found = degrees(text, axis)
    assert np.isnan(found) if value is None else found == pytest.approx(value, abs=1e-9)


def test_columns_of_degrees_as_text(tmp_path):
    text = (
        f"id;time;lat;lon\na;{TIME};46°31.191'N;7°30'E\na;2024-05-01T10:01:00Z;46.52 N;7.501 E\nb;{TIME};46 N;91 91\n"
    )
    tracks, report = read(tmp_path, text)
    np.testing.assert_allclose(place(tracks), [[7.5, 46.51985], [7.501, 46.52]], atol=1e-9)
    assert report.rejected == {"no position": 1}


@pytest.mark.parametrize("delimiter", [";", "\t", "|"])
def test_decimal_commas(tmp_path, delimiter):
    rows = [f"a;{TIME};10,5;55,25;3,5", "a;2024-05-01T10:01:00Z;10,501;55,25;4"]
    tracks, _ = read(tmp_path, "\n".join(["id;time;lon;lat;sog", *rows]).replace(";", delimiter))
    np.testing.assert_allclose(place(tracks), [[10.5, 55.25], [10.501, 55.25]], atol=1e-9)
    assert tracks.columns["sog"].tolist() == [3.5, 4.0]
    quoted = 'id,time,x,y\na,0,"10,5","55,25"\na,1,"10,75",56\n'
    assert read(tmp_path, quoted)[0].points.tolist() == [[10.5, 55.25], [10.75, 56.0]]


@pytest.mark.parametrize(("lon", "turned"), [(190, -170), (-190, 170), (359.5, -0.5), (180.3, -179.7)])
def test_longitudes_a_turn_away(tmp_path, lon, turned):
    tracks, report = read(tmp_path, f"id,time,lon,lat\na,{TIME},{lon},10\na,2024-05-01T10:01:00Z,{lon},10.001\n")
    np.testing.assert_allclose(place(tracks)[:, 0], turned, atol=1e-9)
    assert "2 longitudes beyond 180 degrees were taken as those a turn away" in notes(report)


def test_the_longitude_of_ais_that_is_none_stays_none(tmp_path):
    for header in ("mmsi,time,lon,lat", "MMSI,BaseDateTime,LON,LAT"):
        _, report = read(tmp_path, f"{header}\n7,{TIME},181,55\n7,{TIME},10,55\n")
        assert report.rejected == {"no position": 1}
    _, report = read(tmp_path, f"MMSI,BaseDateTime,LON,LAT\n7,{TIME},190,55\n7,{TIME},10,55\n")
    assert report.rejected == {"no position": 1}


def test_degrees_called_x_and_y_are_pointed_out(tmp_path):
    text = "id;X;Y;t\n1;116.391;39.898;2008-12-11 04:42:10+00\n1;116.3911;39.898;2008-12-11 04:42:12+00\n"
    assert "may be longitude and latitude" in notes(read(tmp_path, text)[1])
    assert "may be" not in notes(read(tmp_path, text.replace("116.39", "516.39"))[1])
    assert "may be" not in notes(read(tmp_path, "id;X;Y;t\n1;1;2;0\n1;1;3;1\n")[1])


EVERYWHERE = st.builds(
    lambda lon, lat, steps: (lon, lat, steps),
    st.floats(-180, 180),
    st.floats(-89.9, 89.9),
    st.lists(st.tuples(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01)), min_size=1, max_size=6),
)


@pytest.mark.parametrize("ending", ["csv", "parquet", "geojson"])
@given(walks=st.lists(EVERYWHERE, min_size=1, max_size=3))
@relaxed
def test_what_is_written_is_read_back_anywhere_on_the_globe(tmp_path, ending, walks):
    tracks = around(walks)
    path = tmp_path / f"t.{ending}"
    wio.write_tracks(tracks, path)
    again, report = wio.read_tracks(path, max_speed=None)
    assert report.kept == report.rows == len(tracks.points)
    order = [list(again.ids).index(name) for name in tracks.ids]
    for i, k in enumerate(order):
        assert again.times_of(k).tolist() == tracks.times_of(i).tolist()
        there, here = again.projection.to_geodetic(again[k]), tracks.projection.to_geodetic(tracks[i])
        turned = (there[:, 0] - here[:, 0] + 180) % 360 - 180
        assert np.abs(turned * np.cos(np.radians(here[:, 1]))).max() < 1e-7
        assert np.abs(there[:, 1] - here[:, 1]).max() < 1e-7


def around(walks):
    rows = []
    for k, (lon, lat, steps) in enumerate(walks):
        at = np.cumsum([(0.0, 0.0), *steps], axis=0)
        for i, (dx, dy) in enumerate(at.tolist()):
            rows.append((f"w{k}", MAY + 60 * i, (lon + dx + 180) % 360 - 180, min(max(lat + dy, -89.95), 89.95)))
    agent, time, lon, lat = zip(*rows, strict=True)
    return Tracks.from_columns(agent=list(agent), time=np.array(time), lon=np.array(lon), lat=np.array(lat))


@given(lon=st.lists(st.floats(-180, 180), min_size=1, max_size=12))
def test_no_part_crosses_the_antimeridian(lon):
    line = np.column_stack([lon, np.linspace(-10, 10, len(lon))])
    parts = cut_at_seam(line)
    rows = np.concatenate([rows for _, rows in parts])
    assert rows[rows >= 0].tolist() == list(range(len(lon)))
    for places, _ in parts:
        assert (np.abs(np.diff(places[:, 0])) <= 180).all()
        assert (np.abs(places[:, 0]) <= 180).all()
        assert (np.abs(np.diff(places[:, 1])) <= 20 / max(len(lon) - 1, 1) + 1e-9).all()


def test_a_cut_line_of_others_is_one_track(tmp_path):
    parts = [[[179.9, 10], [180, 10]], [[-180, 10], [-179.9, 10]]]
    feature = {
        "type": "Feature",
        "properties": {"id": "a"},
        "geometry": {"type": "MultiLineString", "coordinates": parts},
    }
    tracks, _ = read(tmp_path, json.dumps(feature))
    assert list(tracks.lengths) == [2]
    assert Projection.of(*place(tracks).T).lon in (180.0, -180.0)


# Formats


@pytest.mark.parametrize("kind", ["MovingGeomPoint", "MovingGeogPoint", "MovingPoint"])
def test_names_of_meos(tmp_path, kind):
    crs = {"type": "Name", "properties": {"name": "EPSG:4326"}}
    moments = ["2024-05-01T10:00:00+02", "2024-05-01T10:01:00+02"]
    value = {"type": kind, "crs": crs, "coordinates": [[10, 55], [10.001, 55]], "datetimes": moments}
    tracks, report = read(tmp_path, json.dumps(value))
    assert report.format == "MF-JSON"
    assert tracks.times.tolist() == [MAY - 7200, MAY - 7140]
    single = {"type": kind, "coordinates": [10, 55], "datetimes": moments[0]}
    assert read(tmp_path, json.dumps(single))[1].kept == 1


TABLE = f"id,time,lon,lat\na,{TIME},10.5,55\na,2024-05-01T10:01:00Z,10.501,55\n"
SHAPES = {
    "carriage returns": TABLE.replace("\n", "\r").encode(),
    "both": TABLE.replace("\n", "\r\n").encode(),
    "utf-16": TABLE.encode("utf-16"),
    "utf-16-be": b"\xfe\xff" + TABLE.encode("utf-16-be"),
    "utf-16 without a mark": TABLE.encode("utf-16-le"),
    "utf-8 mark": TABLE.encode("utf-8-sig"),
    "comments": b"# made by hand\n# in May\n" + TABLE.encode(),
    "other comments": b"// made by hand\n" + TABLE.encode(),
    "a title": b"Track export\n\n" + TABLE.encode(),
    "sep": b"sep=;\n" + TABLE.replace(",", ";").encode(),
    "quoted sep": b'"sep=,"\r\n' + TABLE.encode(),
    "comments within": TABLE.replace("a,2024-05-01T10:01", "# pause\na,2024-05-01T10:01").encode(),
    "zip of utf-16": archive(a=TABLE.encode("utf-16")),
    "json": json.dumps([{"id": "a", "time": TIME, "lon": 10.5, "lat": 55},
                        {"id": "a", "time": "2024-05-01T10:01:00Z", "lon": 10.501, "lat": 55}]).encode(),
}  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_of_text(tmp_path, shape):
    tracks, report = read(tmp_path, SHAPES[shape])
    assert (report.rows, report.kept, report.rejected) == (2, 2, {})
    assert list(tracks.ids) == ["a"]
    assert tracks.times.tolist() == [MAY, MAY + 60]


@pytest.mark.parametrize("name", ["geom", "wkt", "the_geom", "Geometry"])
def test_points_as_text(tmp_path, name):
    ewkb = (struct.pack("<BII", 1, 0x20000001, 4326) + struct.pack("<dd", 10.5, 55)).hex()
    shapes = ["POINT (10.5 55)", "POINT Z (10.5 55 3)", "SRID=4326;POINT(10.5 55)", ewkb, ewkb.upper()]
    for shape in shapes:
        tracks, _ = read(tmp_path, f"id,time,{name}\na,{TIME},{shape}\n")
        np.testing.assert_allclose(place(tracks), [[10.5, 55]], atol=1e-9)
    with pytest.raises(wio.ReadError, match="EPSG:3857"):
        read(tmp_path, f"id,time,{name}\na,{TIME},SRID=3857;POINT(1 2)\n")
    with pytest.raises(wio.ReadError, match="which is no point"):
        read(tmp_path, f"id;time;{name}\na;{TIME};LINESTRING (1 2, 3 4)\n")


def test_kml(tmp_path):
    tracks, report = read(tmp_path, SAMPLES["kml"])
    assert list(tracks.ids) == ["a", "d"]
    assert tracks.times[:2].tolist() == [1_609_459_200.0, 1_609_459_260.0]
    kmz = tmp_path / "a.kmz"
    with zipfile.ZipFile(kmz, "w") as file:
        file.writestr("doc.kml", SAMPLES["kml"])
        file.writestr("files/a.png", b"\x89PNG")
    assert wio.read_tracks(kmz)[1].kept == report.kept == 3
    pins = "<kml><Placemark><Point><coordinates>1,2</coordinates></Point></Placemark></kml>"
    with pytest.raises(wio.ReadError, match="1 places without a time stamp are no tracks"):
        read(tmp_path, pins)


def test_geopackage_of_points_and_lines(tmp_path):
    tracks, report = read(tmp_path, geopackage())
    assert list(tracks.ids) == ["7"]
    assert report.kept == 2
    path = tmp_path / "lines.gpkg"
    path.write_bytes(geopackage())
    base = sqlite3.connect(path)
    flat = [v for k in range(3) for v in (10.5, 55 + k / 1e4, 0.0, MAY + 60 * k)]
    blob = b"GP\0\1" + struct.pack("<I", 4326) + struct.pack("<BII12d", 1, 3002, 3, *flat)
    base.execute("DELETE FROM fixes")
    base.execute("INSERT INTO fixes VALUES (1, ?, 9, NULL)", (blob,))
    base.commit()
    tracks, _ = wio.read_tracks(path)
    assert list(tracks.ids) == ["9"]
    assert tracks.times.tolist() == [MAY, MAY + 60, MAY + 120]
    base.execute("UPDATE gpkg_geometry_columns SET table_name = 'nowhere'")
    base.commit()
    with pytest.raises(wio.ReadError, match="without a table of features"):
        wio.read_tracks(path)


def test_views_of_a_geopackage_do_not_run(tmp_path):
    path = tmp_path / "bad.gpkg"
    path.write_bytes(geopackage())
    base = sqlite3.connect(path)
    base.execute("DROP TABLE fixes")
    base.execute(
        "CREATE VIEW fixes AS WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT x AS geom FROM n"
    )
    base.commit()
    with pytest.raises(wio.ReadError, match="without a table of features"):
        wio.read_tracks(path)


def test_geolife(tmp_path):
    path = tmp_path / "20081023.plt"
    path.write_bytes(SAMPLES["plt"])
    tracks, _ = wio.read_tracks(path)
    assert list(tracks.ids) == ["20081023"]
    assert tracks.times[0] == 1_224_730_380.0


def test_messages_that_a_person_can_act_on(tmp_path):
    waypoints = '<gpx><wpt lat="48.1" lon="11.5"/><wpt lat="48.2" lon="11.5"/></gpx>'
    with pytest.raises(wio.ReadError, match="the file holds 2 waypoints, which are no track or route"):
        read(tmp_path, waypoints)
    with pytest.raises(wio.ReadError, match="the first line is longer than 65,536 bytes"):
        read(tmp_path, ",".join(f"c{k}" for k in range(100_000)))
    with pytest.raises(wio.ReadError) as caught:
        read(tmp_path, b"id,time,x,y\na\x1b[2J,7,1,x\n")
    assert "\\x1b[2J" in str(caught.value)
    assert "\x1b" not in str(caught.value)
