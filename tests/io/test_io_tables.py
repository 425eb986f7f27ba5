"""Any table: delimited text, Parquet, GeoParquet."""

from __future__ import annotations

import json
import struct

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import wakefold.io as wio

START = 1_609_459_200.0


def text(tmp_path, content, **options):
    path = tmp_path / "file"
    path.write_text(content)
    return wio.read_tracks(path, **options)


def parquet(tmp_path, table, **options):
    path = tmp_path / "file"
    pq.write_table(table if isinstance(table, pa.Table) else pa.table(table), path)
    return wio.read_tracks(path, **options)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " "])
def test_obvious_names_and_delimiters(tmp_path, delimiter):
    rows = ["id,t,x,y", "a,0,1,2", "a,0.5,1.5,2", "b,0,5,6"]
    tracks, report = text(tmp_path, "\n".join(rows).replace(",", delimiter))
    assert list(tracks.ids) == ["a", "b"]
    assert tracks.projection is None
    np.testing.assert_array_equal(tracks.points, [[1, 2], [1.5, 2], [5, 6]])
    np.testing.assert_array_equal(tracks.times, [0, 0.5, 0])
    assert (report.format, report.kept) == ("CSV", 3)


@pytest.mark.parametrize(
    ("moment", "form"),
    [
        ("2021-01-01T00:00:00", None),
        ("2021-01-01 00:00:00.000", None),
        ("2021-01-01T00:00:00Z", None),
        ("2021-01-01T02:00:00+02:00", None),
        ("1609459200", None),
        ("1609459200000", "ms"),
        ("01/01/2021 00:00", "%d/%m/%Y %H:%M"),
        ("01/01/2021 01:00 +0100", "%d/%m/%Y %H:%M %z"),
    ],
)
def test_times(tmp_path, moment, form):
    tracks, _ = text(tmp_path, f"mmsi,timestamp,longitude,latitude\n1,{moment},-74,40\n", time_format=form)
    assert tracks.times[0] == START
    again, _ = parquet(tmp_path, {"mmsi": [1], "t": [moment], "lon": [-74.0], "lat": [40.0]}, time_format=form)
    assert again.times[0] == START


def test_mapping(tmp_path):
    content = "who;when;east;north;boat\nA;0;1;2;tug\nA;1;2;3;tug\n"
    mapping = {"agent": "who", "time": "when", "x": "east", "y": "north", "type": "boat"}
    tracks, _ = text(tmp_path, content, columns=mapping)
    assert tracks.attributes["type"][0] == "tug"
    with pytest.raises(
        wio.ReadError, match=r"no column 'wer' \(for agent\); there are who, when, east, north and boat"
    ):
        text(tmp_path, content, columns=mapping | {"agent": "wer"})
    with pytest.raises(wio.ReadError, match=r"which column is lon and lat \(or x and y\)\?"):
        text(tmp_path, content, columns={"agent": "who"})


def test_positions_instead_of_names_mean_no_header(tmp_path):
    content = "  7.8e+02  1.0e+00  8.45  0.0  3.58\n  7.9e+02  1.0e+00  8.55  0.0  3.59\n"
    tracks, _ = text(tmp_path, content, columns={"time": 0, "agent": 1, "x": 2, "y": 4})
    assert list(tracks.ids) == ["1"]
    np.testing.assert_array_equal(tracks.points, [[8.45, 3.58], [8.55, 3.59]])


def test_three_dimensions_no_times_and_leading_zeros(tmp_path):
    tracks, report = text(tmp_path, "id,x,y,z\n007,1,2,3\n007,1,2,4\n")
    assert tracks.dim == 3
    assert list(tracks.ids) == ["007"]
    assert report.notes == ("no times: 2 points taken 1 s apart",)


def test_track_and_agent(tmp_path):
    table = {
        "track_id": ["a1", "a2"],
        "mmsi": pa.array(["a", "a"]).dictionary_encode(),
        "t": [0, 0],
        "x": [0, 1],
        "y": [0, 1],
    }
    tracks, _ = parquet(tmp_path, table)
    assert list(tracks.ids) == ["a1", "a2"]
    assert list(tracks.attributes["agent"]) == ["a", "a"]


def test_nulls_and_types_of_parquet(tmp_path):
    table = {
        "id": [1.0, None, 2.0, 2.0],
        "time": pa.array([0, 1, None, 10**6], pa.timestamp("us", tz="Europe/Copenhagen")),
        "x": pa.array([1, 2, 3, 4], pa.int8()),
        "y": ["1", "2", "3", "4"],
        "sog": [1.0, 2.0, 3.0, None],
    }
    tracks, report = parquet(tmp_path, table)
    assert report.rejected == {"no agent": 1, "no time": 1}
    assert report.offences["no agent"][0].line == 2
    assert list(tracks.ids) == ["1", "2"]
    np.testing.assert_array_equal(tracks.points, [[1, 1], [4, 4]])
    np.testing.assert_array_equal(tracks.columns["sog"], [1, np.nan])


def wkb(x, y, order="<", kind=1, more=b""):
    return struct.pack(f"{order}BIdd", order == "<", kind, x, y) + more


def geo(**column):
    meta = {"version": "1.1.0", "primary_column": "shape", "columns": {"shape": {"encoding": "WKB", **column}}}
    return {"geo": json.dumps(meta)}


def test_geoparquet(tmp_path):
    shapes = [
        wkb(-74, 40),
        wkb(-74, 41, order=">"),
        wkb(-74, 42, kind=1001, more=bytes(8)),
        None,
        b"\1\2",
        wkb(1, 2, kind=2),
    ]
    table = pa.table({"id": ["a"] * 6, "t": np.arange(6.0) * 1e4, "shape": pa.array(shapes, pa.binary())})
    tracks, report = parquet(tmp_path, table.replace_schema_metadata(geo()))
    np.testing.assert_allclose(
        tracks.projection.to_geodetic(tracks.points), [[-74, 40], [-74, 41], [-74, 42]], atol=1e-9
    )
    assert report.rejected == {"no position": 3}


def test_geoparquet_in_metres_of_a_stated_system(tmp_path):
    from pyproj import CRS, Transformer

    x, y = Transformer.from_crs("EPSG:4326", "EPSG:25832", always_xy=True).transform(11.0, 57.0)
    points = pa.array([{"x": x, "y": y}])
    table = pa.table({"id": ["a"], "t": [0.0], "shape": points})
    tracks, _ = parquet(tmp_path, table.replace_schema_metadata(geo(encoding="point", crs=CRS(25832).to_json_dict())))
    np.testing.assert_allclose(tracks.projection.to_geodetic(tracks.points), [[11, 57]], atol=1e-8)
    plane, _ = parquet(tmp_path, table.replace_schema_metadata(geo(encoding="point", crs=None)))
    assert plane.projection is None


def test_several_files_continue_tracks(tmp_path):
    paths = [tmp_path / "1.csv", tmp_path / "2.csv"]
    paths[0].write_text("id,t,x,y,sog\na,0,0,0,5\nb,0,1,1,5\n")
    paths[1].write_text("id,t,x,y\na,1,0,1\na,0,0,0\n")
    tracks, report = wio.read_tracks(paths)
    assert list(tracks.lengths) == [2, 1]
    assert report.files == ("1.csv", "2.csv")
    assert report.offences["duplicate"][0][:2] == ("2.csv", 3)
    np.testing.assert_array_equal(tracks.columns["sog"], [5, np.nan, 5])
    paths[1].write_text("id,t,lon,lat\na,1,0,1\n")
    with pytest.raises(wio.ReadError, match=r"2\.csv: has longitude and latitude, what was read before has 2 plane"):
        wio.read_tracks(paths)


@pytest.mark.parametrize(
    ("name", "options", "tracks", "points"),
    [
        (
            "kattegat_dma/kattegat_2025-11-01_02.parquet",
            {"columns": {"agent": "MMSI", "type": "ShipTypeID"}},
            250,
            28_996,
        ),
        ("grand_central/grand_central.parquet", {}, 11_787, 324_513),
        ("gulfcoast_atd2025/dataset1_truth.csv.gz", {"max_speed": None}, 5620, 102_861),
        (
            "pedestrian_groups/ETH/seq_eth/obsmat.txt",
            {"columns": {"time": 0, "agent": 1, "x": 2, "y": 4}},
            360,
            8908,
        ),
    ],
)
def test_real_tables(shared_data, name, options, tracks, points):
    found, report = wio.read_tracks(shared_data(name), **options)
    assert (len(found), report.rows, report.kept) == (tracks, points, points)


def test_positions_out_of_this_world_are_rejected(tmp_path):
    path = tmp_path / "far.csv"
    path.write_text("agent,time,x,y\na,0,1,1\na,1,1e200,1\na,2,2,-1e13\na,3,2,2\n")
    tracks, report = wio.read_tracks(path)
    assert tracks.points.tolist() == [[1.0, 1.0], [2.0, 2.0]]
    assert report.rejected == {"no position": 2}


def test_times_outside_the_years_1_to_9999_are_none_and_far_ones_are_pointed_out(tmp_path):
    tracks, report = text(
        tmp_path, "mmsi,t,longitude,latitude\n1,1607407200,-74,40\n1,1607407200000,-74,40\n1,5e9,-74,40\n"
    )
    assert tracks.times.tolist() == [1607407200.0, 5e9]
    assert report.rejected == {"no time": 1}
    assert [note for note in report.notes if note.startswith("2 times lie beyond the year 2100")]


def test_a_line_of_nul_bytes_is_a_bad_line(tmp_path):
    for quote in ("", '"'):  # lines taken apart at once, or one by one
        _, report = text(tmp_path, f"id,t,x,y\na,0,1,2\n\0\0\0\n  \n{quote}a{quote},1,1,2\n")
        assert (report.rows, report.kept, report.rejected) == (3, 2, {"bad line": 1})
        assert report.offences["bad line"][0].line == 3
