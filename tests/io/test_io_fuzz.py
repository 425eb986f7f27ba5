"""Whatever the bytes: tracks and a report that adds up, or a ReadError; no other exception and no wrong count."""

from __future__ import annotations

import gzip
import io
import json
import sqlite3
import struct

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pyais.encode import encode_dict

import wakefold.io as wio
from wakefold.io.sniff import FORMATS

MARINECADASTRE = b"""MMSI,BaseDateTime,LAT,LON,SOG,COG,Heading,VesselName,IMO,CallSign,VesselType,Status,Length,Width
367000140,2020-06-30T00:00:00,40.64409,-74.07157,0.0,-60.6,246.0,"SAMUEL, I",IMO7702774,WYR3371,60.0,0.0,94.0,21.0
367000141,2020-06-30T00:00:05,40.5,-74.1,19.0,61.8,511,CG,,NPBG,90,0,26,5
"""
DMA = b"""# Timestamp,Type of mobile,MMSI,Latitude,Longitude,SOG,COG,Heading,Callsign,Name,Ship type,Destination
01/11/2024 00:00:01,Class A,219000001,57.1,11.2,12.3,102.3,511,Unknown,S\xc3\x98REN,Cargo,GOTEBORG
01/11/2024 00:00:11,Base Station,219000001,57.1,11.2,,,,,,,
"""
NMEA = b"".join(
    rb"\c:1609459200*5E\%s" % b"\n".join(line.encode() for line in encode_dict(fields, talker_id="AI"))
    + b",1609459201\n"
    for fields in (
        {"mmsi": 366000001, "msg_type": 1, "lon": -74.0, "lat": 40.6, "speed": 10.2, "course": 90.5, "second": 1},
        {"mmsi": 366000001, "msg_type": 5, "shipname": "AEGIR", "destination": "NEW YORK", "to_bow": 60},
        {"mmsi": 3660001, "msg_type": 4, "year": 2021, "month": 1, "day": 1},
        {"mmsi": 366000002, "msg_type": 18, "lon": -74.0, "lat": 40.6, "speed": 10.2, "course": 90.5, "second": 1},
    )
)
TRAJ = (
    b"*T*,u-1,terrestrial,2,0,*P*,terrestrial,2,1,1,0,7,2020-12-01 00:00:00,-74,40,7,2020-12-01 00:01:00,-74,40.001\n"
)
EDINBURGH = b"% 1\n TRACK.R1=[[593 42 95];[588 48 96]];\n TRACK.R2=[[593 42 95];[588 48 96]];\n"
GPX = (
    b'<?xml version="1.0"?><gpx><trk><name>a</name><trkseg><trkpt lat="1" lon="2"><time>2021-01-01T00:00:00Z</time>'
    b'</trkpt><trkpt lat="1" lon="2.1"><time>2021-01-01T01:00:00Z</time></trkpt></trkseg></trk></gpx>'
)
LINE = {"type": "LineString", "coordinates": [[1, 2], [1, 2.1]]}
FEATURES = [
    {"type": "Feature", "geometry": LINE, "properties": {"id": "a", "times": [1.6e9, "2021-01-01T00:00:00Z"]}},
    {"type": "Feature", "geometry": {"type": "Point", "coordinates": [1, 2]}, "properties": {"id": 7, "time": 5}},
]
GEOJSON = json.dumps({"type": "FeatureCollection", "features": FEATURES}, indent=1).encode()
MFJSON = json.dumps({"type": "MovingPoint", "coordinates": [[1, 2], [1, 3]], "datetimes": [1.6e12, 1.7e12]}).encode()
JSONL = b"".join(
    json.dumps({"class": "AIS", "mmsi": 7, "time": f"2021-01-01T00:0{i}:00Z", "lon": 1.5, "lat": 2 + i / 1e3}).encode()
    + b"\n"
    for i in range(3)
)
KML = (
    b'<?xml version="1.0"?><kml xmlns:gx="g"><Document><name>d</name><Placemark><name>a</name><gx:Track>'
    b"<when>2021-01-01T00:00:00Z</when><when>2021-01-01T00:01:00Z</when><gx:coord>1 2 0</gx:coord>"
    b"<gx:coord>1 2.001 0</gx:coord></gx:Track></Placemark><Placemark><TimeStamp><when>2021-01-01T00:00:00Z</when>"
    b"</TimeStamp><Point><coordinates>1,2,0</coordinates></Point></Placemark></Document></kml>"
)
PLT = b"Geolife trajectory\nWGS 84\nAltitude is in Feet\nReserved 3\n0,2,255,My Track,0,0,2,8421376\n0\n" + b"".join(
    b"39.9%d,116.3,0,492,39744.1,2008-10-23,02:53:0%d\n" % (i, i) for i in range(3)
)
TABLE = b"id;time;x;y;name\na;0;1;2;A\na;1;2;3;A\nb;2;2;3;\n"


def parquet():
    sink = io.BytesIO()
    table = {"id": ["a", "a", None], "t": [0.0, 1.0, 2.0], "x": [0.0, 1.0, 2.0], "y": [0.0, 1.0, 2.0]}
    pq.write_table(pa.table(table), sink)
    return sink.getvalue()


def geopackage():
    """Two points of a table of features; a page of a database is 512 bytes at least."""
    base = sqlite3.connect(":memory:")
    base.executescript(
        """PRAGMA page_size = 512;
        CREATE TABLE gpkg_contents (table_name TEXT, data_type TEXT);
        CREATE TABLE gpkg_geometry_columns (table_name TEXT, column_name TEXT, srs_id INTEGER);
        CREATE TABLE gpkg_spatial_ref_sys (srs_id INTEGER, organization TEXT, organization_coordsys_id INTEGER);
        INSERT INTO gpkg_geometry_columns VALUES ('fixes', 'geom', 4326);
        CREATE TABLE fixes (fid INTEGER PRIMARY KEY, geom BLOB, mmsi INTEGER, time TEXT);"""
    )
    for i in range(2):
        blob = b"GP\0\1" + struct.pack("<I", 4326) + struct.pack("<BIdd", 1, 1, 10.5, 55 + i / 1e3)
        base.execute("INSERT INTO fixes VALUES (?, ?, 7, ?)", (i, blob, f"2021-01-01T00:0{i}:00Z"))
    base.commit()
    return base.serialize()


SAMPLES = {
    "marinecadastre": MARINECADASTRE,
    "dma": DMA,
    "nmea": NMEA,
    "table": TABLE,
    "parquet": parquet(),
    "jsonl": JSONL,
    "geojson": GEOJSON,
    "mfjson": MFJSON,
    "gpx": GPX,
    "kml": KML,
    "geopackage": geopackage(),
    "plt": PLT,
    "traj": TRAJ,
    "edinburgh": EDINBURGH,
}
relaxed = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


def check(tmp_path, data, **options):
    """Read; what comes back must add up."""
    path = tmp_path / "file"
    path.write_bytes(data)
    try:
        tracks, report = wio.read_tracks(path, **options)
    except wio.ReadError:
        return None
    assert report.rows == report.kept + sum(report.rejected.values())
    assert report.kept == len(tracks.points)
    assert all(len(report.offences[reason]) == min(count, 5) for reason, count in report.rejected.items())
    assert np.isfinite(tracks.points).all()
    json.dumps(report.to_dict())
    assert str(report)
    return report


def test_samples_cover_all_formats(tmp_path):
    assert SAMPLES.keys() == FORMATS.keys()
    for name, data in SAMPLES.items():
        report = check(tmp_path, data)
        assert report is not None
        assert report.format == FORMATS[name]


@pytest.mark.parametrize("name", SAMPLES)
def test_cut_at_every_length(tmp_path, name):
    rows = check(tmp_path, SAMPLES[name]).rows
    for size in range(0, len(SAMPLES[name]), 1 + len(SAMPLES[name]) // 1500):
        report = check(tmp_path, SAMPLES[name][:size])
        assert report is None or report.rows <= rows + 1


@pytest.mark.parametrize("name", SAMPLES)
@given(data=st.data())
@relaxed
def test_spoilt_bytes(tmp_path, name, data):
    sample = bytearray(SAMPLES[name])
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(sample) - 1))
        kind = data.draw(st.sampled_from(["replace", "insert", "delete", "repeat"]))
        if kind == "replace":
            sample[at] = data.draw(st.integers(0, 255))
        elif kind == "insert":
            sample[at:at] = data.draw(
                st.sampled_from([b"\n", b'"', b",", b"\0", b"\r", b"\xff", b"9" * 400, b"{", b"-1e999"])
            )
        elif kind == "delete":
            del sample[at : at + data.draw(st.integers(1, 20))]
        else:
            sample[at:at] = sample[at : at + data.draw(st.integers(1, 200))]
        if not sample:
            return
    check(tmp_path, bytes(sample))


@pytest.mark.parametrize("name", [*FORMATS, None])
@given(data=st.binary(max_size=300))
@example(data=b'"')
@example(data=b"\n\n\n,\n")
@relaxed
def test_random_bytes(tmp_path, name, data):
    check(tmp_path, data, format=name)
    check(tmp_path, SAMPLES[name or "table"][:60] + data, format=name)


@given(data=st.binary(max_size=200))
@relaxed
def test_random_bytes_behind_magic(tmp_path, data):
    for magic in (b"\x1f\x8b\x08", b"\x28\xb5\x2f\xfd", b"PK\x03\x04", b"PAR1", gzip.compress(b"PK\x03\x04" + data)):
        check(tmp_path, magic + data)


CELLS = st.one_of(
    st.sampled_from(
        [
            "",
            "1",
            "2",
            "40.5",
            "-74",
            "91",
            "2020-06-30T00:00:00",
            "2020-06-30T00:00:01",
            "x",
            '"',
            '"a,b"',
            "NaN",
            '5" x',
            '"a""',
            '"a"b',
        ]
    ),
    st.floats().map(repr),
    st.text(st.characters(codec="latin-1"), max_size=5),
)


@given(
    lines=st.lists(st.lists(CELLS, min_size=3, max_size=8).map(",".join), max_size=12),
    end=st.sampled_from(["\n", "\r\n"]),
)
@relaxed
def test_random_tables_count_every_line(tmp_path, lines, end):
    header = b"MMSI,BaseDateTime,LAT,LON,SOG,VesselName\n"
    body = end.join(lines).encode("latin-1")
    report = check(tmp_path, header + b"1,2020-06-30T00:00:00,1,1,1,A\n" + body)
    assert report is not None
    counted = [line for line in body.split(b"\n") if line.strip() and not line.startswith(b"#")]
    assert report.rows == 1 + len(counted)
