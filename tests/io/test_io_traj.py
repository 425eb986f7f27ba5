"""Tracktable .traj files."""

from __future__ import annotations

import numpy as np
import pytest

import wakefold.io as wio

HEAD = "*T*,{uuid},terrestrial,{n},0,*P*,terrestrial,2,1,1,0,"
ONE = HEAD.format(uuid="u-1", n=2) + "7,2020-12-01 00:00:00,-74.0,40.0,7,2020-12-01 00:01:00,-74.0,40.001"
TWO = HEAD.format(uuid="u-2", n=1) + "7,2020-12-02 00:00:00,-74.1,40.1"
RICH = (
    "*T*,u-3,terrestrial,2,1,note,2,hello,*P*,terrestrial,2,1,1,2,altitude,1,dest,2,"
    "A,2013-07-10 00:20:03,-105.2,39.8,12.5,KASE,A,2013-07-10 00:23:07,-105.21,39.81,,KASE"
)


def read(tmp_path, text):
    path = tmp_path / "file"
    path.write_text(text)
    return wio.read_tracks(path)


def test_own_segmentation_is_kept(tmp_path):
    tracks, report = read(tmp_path, f"{ONE}\n{TWO}\n")
    assert list(tracks.ids) == ["7#1", "7#2"]
    assert list(tracks.attributes["agent"]) == ["7", "7"]
    assert list(tracks.attributes["uuid"]) == ["u-1", "u-2"]
    assert (report.format, report.rows, report.kept) == ("Tracktable .traj", 3, 3)
    assert tracks.times[0] == 1606780800
    np.testing.assert_allclose(
        tracks.projection.to_geodetic(tracks.points), [[-74, 40], [-74, 40.001], [-74.1, 40.1]], atol=1e-9
    )


def test_properties(tmp_path):
    tracks, _ = read(tmp_path, RICH)
    np.testing.assert_array_equal(tracks.columns["altitude"], [12.5, np.nan])


def test_older_header_without_uuid(tmp_path):
    text = "*T*,generic,2,0,*P*,generic,2,1,1,0,T1,2014-07-01 15:45:43,-71.0,42.3,T1,2014-07-01 15:46:48,-71.1,42.2"
    tracks, _ = read(tmp_path, text)
    assert list(tracks.ids) == ["T1#1"]
    assert tracks.projection is not None


def test_bad_line_and_cut_line(tmp_path):
    tracks, report = read(tmp_path, f"{ONE}\n*T*,what\n{ONE[:-30]}")
    assert (report.rows, report.kept, report.rejected) == (5, 3, {"bad line": 2})
    assert [o.line for o in report.offences["bad line"]] == [2, 3]
    assert list(tracks.lengths) == [2, 1]


@pytest.mark.parametrize("cut", range(len(ONE)))
def test_cut_anywhere_never_invents_a_point(tmp_path, cut):
    whole, _ = read(tmp_path, ONE)
    try:
        tracks, report = read(tmp_path, ONE[:cut])
    except wio.ReadError:
        return
    assert report.rows == report.kept + sum(report.rejected.values())
    np.testing.assert_array_equal(tracks.times, whole.times[: len(tracks.times)])
    seen = len(tracks.points) - (not report.rejected)  # a cut inside the very last number cannot be seen
    np.testing.assert_allclose(
        tracks.projection.to_geodetic(tracks.points)[:seen],
        whole.projection.to_geodetic(whole.points)[:seen],
        atol=1e-9,
    )


def test_real_week_of_new_york(shared_data):
    tracks, report = wio.read_tracks(shared_data("nyharbor_ais/NYHarbor_2020_12_first_week.traj"))
    assert (len(tracks), report.rows, report.kept, report.rejected) == (513, 172_679, 172_677, {"jump": 2})
    assert len(set(tracks.attributes["agent"])) == 140
