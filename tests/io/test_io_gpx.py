"""GPX files."""

from __future__ import annotations

import numpy as np
import pytest

import wakefold.io as wio

POINTS = "".join(
    f'<trkpt lat="40.{i:03d}" lon="-74"><ele>1</ele><time>2021-01-01T00:0{i}:00Z</time></trkpt>' for i in range(3)
)
GPX = (
    '<?xml version="1.0"?>\n<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><metadata><name>no</name>'
    "</metadata><wpt lat='1' lon='1'><name>no</name></wpt><trk><name>walk</name><trkseg>{}</trkseg><trkseg>"
    '<trkpt lat="41" lon="-74"><time>2021-01-01T01:00:00Z</time></trkpt></trkseg></trk>\n</gpx>'
)


def read(tmp_path, text):
    path = tmp_path / "file"
    path.write_text(text)
    return wio.read_tracks(path)


def test_segments(tmp_path):
    tracks, report = read(tmp_path, GPX.format(POINTS))
    assert list(tracks.ids) == ["walk", "walk#2"]
    assert list(tracks.lengths) == [3, 1]
    assert (report.format, report.rows, report.kept) == ("GPX", 4, 4)
    np.testing.assert_array_equal(tracks.times_of(0), 1_609_459_200 + 60.0 * np.arange(3))
    np.testing.assert_allclose(tracks.projection.to_geodetic(tracks[0])[:, 1], [40, 40.001, 40.002], atol=1e-9)


def test_routes_and_no_times(tmp_path):
    text = "<gpx><rte><rtept lat='1' lon='2'/><rtept lat='1.1' lon='2'/></rte></gpx>"
    tracks, report = read(tmp_path, text)
    assert list(tracks.ids) == ["track 1"]
    assert report.notes == ("no times: 2 points taken 1 s apart",)


def test_bad_points(tmp_path):
    bad = '<trkpt lat="x" lon="-74"><time>2021-01-01T00:09:00Z</time></trkpt><trkpt lat="40" lon="-74"/>'
    _, report = read(tmp_path, GPX.format(POINTS + bad))
    assert report.rejected == {"no position": 1, "no time": 1}


def test_cut_off(tmp_path):
    text = GPX.format(POINTS)
    tracks, report = read(tmp_path, text[: text.index("40.002")])
    assert report.rejected == {"bad line": 1}
    assert list(tracks.lengths) == [2]


def test_entities_are_refused(tmp_path):
    bomb = '<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><gpx><trk><name>&b;</name></trk></gpx>'
    with pytest.raises(wio.ReadError, match="no usable positions"):
        read(tmp_path, bomb)
