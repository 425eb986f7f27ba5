"""Tracks of the Edinburgh forum."""

from __future__ import annotations

import numpy as np

import wakefold.io as wio

TEXT = """% Total number of trajectories in file are  2

Properties.R1=[59 95 164 568.49 ];
 TRACK.R1=[[593 42 95];[588 48 96];[583 56 97]];
Properties.R2=[59 95 164 568.49 ];
 TRACK.R2=[[1 2 9];[3 x 18]];
"""


def test_pixels_and_frames(tmp_path):
    path = tmp_path / "file"
    path.write_text(TEXT)
    tracks, report = wio.read_tracks(path)
    assert (report.format, report.rows, report.kept) == ("Edinburgh forum tracks", 5, 4)
    assert report.rejected == {"bad line": 1}
    assert list(tracks.ids) == ["1", "2"]
    assert tracks.projection is None
    np.testing.assert_allclose(tracks[1], [[0.0247, 0.0494]])
    np.testing.assert_allclose(tracks.times_of(0), np.array([95, 96, 97]) / 9)


def test_real_july(shared_data):
    tracks, report = wio.read_tracks(shared_data("edinburgh_forum/tracks.01Jul.txt"))
    assert (len(tracks), report.rows) == (1262, 111_230)
    assert tracks.points.max() < 640 * 0.0247
