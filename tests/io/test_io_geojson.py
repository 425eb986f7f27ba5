"""GeoJSON and MF-JSON."""

from __future__ import annotations

import json

import numpy as np
import pytest

import wakefold.io as wio

LINE = {"type": "LineString", "coordinates": [[-74.0, 40.0], [-74.0, 40.001, 5.0], [-74.0, 40.002]]}
ISO = ["2021-01-01T00:00:00Z", "2021-01-01T00:01:00Z", "2021-01-01T00:02:00Z"]
START = 1_609_459_200.0


def feature(geometry=LINE, **properties):
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def collection(*features, **more):
    return {"type": "FeatureCollection", **more, "features": list(features)}


def read(tmp_path, value):
    path = tmp_path / "file"
    path.write_text(value if isinstance(value, str) else json.dumps(value))
    return wio.read_tracks(path)


@pytest.mark.parametrize(
    "value",
    [
        collection(feature(coordTimes=ISO, id="a", name="A")),
        feature(times=[START, START + 60, START + 120], id="a", name="A"),
        collection({**feature(coordinateProperties={"times": ISO}, name="A"), "id": "a"}, metadata={"features": 1}),
        {"type": "Feature", "properties": {"id": "a", "name": "A"},
         "temporalGeometry": {"type": "MovingPoint", "coordinates": LINE["coordinates"], "datetimes": ISO}},
        {"type": "Feature", "properties": {"id": "a", "name": "A"},
         "temporalGeometry": {"type": "MovingGeometryCollection", "prisms": [
                    {"type": "MovingPoint", "coordinates": LINE["coordinates"],
                     "datetimes": [START * 1000, START * 1000 + 60e3, START * 1000 + 120e3]}]}},
        collection(*(feature({"type": "Point", "coordinates": c}, id="a", name="A", time=t)
                     for c, t in zip(LINE["coordinates"], ISO, strict=True))),
        "\n".join(json.dumps(feature({"type": "Point", "coordinates": c}, mmsi="a", name="A", timestamp=t))
                  for c, t in zip(LINE["coordinates"], ISO, strict=True)),
    ],
)  # fmt: skip
def test_lines_points_and_moving_points(tmp_path, value):
    tracks, report = read(tmp_path, value)
    assert report.format in ("GeoJSON", "MF-JSON")
    assert list(tracks.ids) == ["a"]
    assert tracks.attributes["name"][0] == "A"
    assert (report.rows, report.kept) == (3, 3)
    np.testing.assert_array_equal(tracks.times, START + np.array([0.0, 60.0, 120.0]))
    np.testing.assert_allclose(
        tracks.projection.to_geodetic(tracks.points), [c[:2] for c in LINE["coordinates"]], atol=1e-9
    )


def test_sequences_of_mobilitydb(tmp_path):
    value = {
        "type": "MovingPoint",
        "crs": {"type": "Name", "properties": {"name": "EPSG:4326"}},
        "sequences": [
            {"coordinates": [[1, 2], [1, 2.001]], "datetimes": ISO[:2]},
            {"coordinates": [[1, 2.002]], "datetimes": ISO[2:]},
        ],
    }
    tracks, _ = read(tmp_path, value)
    assert list(tracks.lengths) == [2, 1]
    assert list(tracks.ids) == ["track", "track#2"]


def test_without_times(tmp_path):
    tracks, report = read(tmp_path, feature())
    np.testing.assert_array_equal(tracks.times, [0, 1, 2])
    assert report.notes == ("no times: 3 points taken 1 s apart",)


def test_several_parts_keep_apart(tmp_path):
    parts = {"type": "MultiLineString", "coordinates": [[[0, 0], [0, 0.001]], [[0, 1], [0, 1.001]]]}
    tracks, _ = read(tmp_path, feature(parts, coordTimes=[ISO[:2], ISO[:2]], id="a"))
    assert list(tracks.ids) == ["a", "a#2"]
    assert tracks.times[2] == START


def test_what_is_no_track_is_counted(tmp_path):
    polygon = feature({"type": "Polygon", "coordinates": [[[0, 0], [1, 1], [1, 0], [0, 0]]]})
    _, report = read(tmp_path, collection(polygon, feature(coordTimes=ISO[:2]), feature(None), 7))
    assert report.rejected == {"not a track": 3, "no time": 1}
    assert (report.rows, report.kept) == (6, 2)


def test_one_damaged_feature(tmp_path):
    features = [json.dumps(feature(coordTimes=ISO, id=name)) for name in "abc"]
    features[1] = features[1].replace("[[", "[![")
    tracks, report = read(tmp_path, '{"type": "FeatureCollection", "features": [\n' + ",\n".join(features) + "\n]}")
    assert list(tracks.ids) == ["a", "c"]
    assert report.rejected == {"bad line": 1}
    assert report.offences["bad line"][0].line == 3


def test_other_reference_systems_are_refused(tmp_path):
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
    with pytest.raises(wio.ReadError, match="25832"):
        read(tmp_path, {"type": "FeatureCollection", "crs": crs, "features": [feature()]})


@pytest.mark.parametrize("text", ['{"a": ' * 100_000, "{" + "[" * 100_000, '{"type": "Feature", "geometry": 1e999}'])
def test_hostile_text_is_refused(tmp_path, text):
    with pytest.raises(wio.ReadError):
        read(tmp_path, text)
