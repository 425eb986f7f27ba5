"""What is written is read back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import wakefold.io as wio
from wakefold import Tracks
from wakefold.tracks.projection import Projection

NAMES = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=8)
relaxed = settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])


@st.composite
def some_tracks(draw, geodetic):
    """A few tracks; names with quotes, commas and foreign letters; odd times."""
    ids = draw(st.lists(NAMES.filter(lambda s: not s.replace(".", "").isdigit()), min_size=1, max_size=4, unique=True))
    lengths = draw(st.lists(st.integers(1, 5), min_size=len(ids), max_size=len(ids)))
    total = sum(lengths)
    dim = 2 if geodetic else draw(st.integers(2, 3))
    reach = st.floats(-50_000, 50_000, width=32)
    points = np.array(draw(st.lists(reach, min_size=total * dim, max_size=total * dim))).reshape(total, dim)
    steps = draw(st.lists(st.floats(1e-3, 1e6), min_size=total, max_size=total))
    projection = Projection(draw(st.floats(-180, 180)), draw(st.floats(-85, 85))) if geodetic else None
    return Tracks(
        points=points,
        times=draw(st.sampled_from([0.0, 1.6e9])) + np.cumsum(steps),
        offsets=np.concatenate([[0], np.cumsum(lengths)]),
        ids=np.array(ids),
        projection=projection,
        attributes={"agent": np.array(ids), "type": np.array([f"t{i}" for i in range(len(ids))])},
        columns={"sog": draw(st.sampled_from([np.arange(total) / 3, np.full(total, np.nan)]))},
    )


def read_back(tracks, path):
    wio.write_tracks(tracks, path)
    return wio.read_tracks(path, max_speed=None)


@pytest.mark.parametrize("ending", ["csv", "parquet", "geojson"])
@given(tracks=some_tracks(geodetic=True))
@relaxed
def test_geodetic(tmp_path, ending, tracks):
    again, report = read_back(tracks, tmp_path / f"tracks.{ending}")
    assert report.rows == report.kept == len(tracks.points)
    position = {str(name): i for i, name in enumerate(again.ids)}
    assert position.keys() == set(tracks.ids)
    for i, name in enumerate(tracks.ids):
        k = position[str(name)]
        np.testing.assert_array_equal(tracks.times_of(i), again.times_of(k))
        assert tracks.attributes["type"][i] == again.attributes["type"][k]
        old, new = tracks.projection.to_geodetic(tracks[i]), again.projection.to_geodetic(again[k])
        turn = (new - old + [180, 0]) % 360 - [180, 0]
        assert np.abs(np.where(np.abs(turn) > 359, 0, turn)).max() < 1e-8


@pytest.mark.parametrize("ending", ["csv", "parquet"])
@given(tracks=some_tracks(geodetic=False))
@relaxed
def test_planar_is_exact(tmp_path, ending, tracks):
    again, report = read_back(tracks, tmp_path / f"tracks.{ending}")
    assert report.rejected == {}
    for name in ("points", "times", "offsets", "ids"):
        np.testing.assert_array_equal(getattr(tracks, name), getattr(again, name))
    np.testing.assert_array_equal(tracks.columns["sog"], again.columns["sog"])
    for name in tracks.attributes:
        np.testing.assert_array_equal(tracks.attributes[name], again.attributes[name])


def test_refusals(tmp_path):
    tracks = Tracks.from_arrays([np.zeros((2, 2))])
    with pytest.raises(ValueError, match="longitude and latitude"):
        wio.write_tracks(tracks, tmp_path / "a.geojson")
    with pytest.raises(ValueError, match="csv, geojson, parquet, not"):
        wio.write_tracks(tracks, tmp_path / "a.shp")
    with pytest.raises(ValueError, match="one dimension"):
        wio.write_tracks(Tracks.from_arrays([np.zeros((2, 1))]), tmp_path / "a.csv")


@pytest.mark.parametrize("name", ["a\nb", "a\rb", " a", "a\t", "7.0", "a\0b", ""])
def test_ids_that_would_come_back_as_others_are_refused(tmp_path, name):
    with pytest.raises(ValueError, match="id"):
        wio.write_tracks(Tracks.from_arrays([np.zeros((2, 2))], ids=[name]), tmp_path / "a.csv")
    assert not (tmp_path / "a.csv").exists()
