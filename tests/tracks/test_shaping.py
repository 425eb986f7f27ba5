from itertools import pairwise

import naive
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wakefold.base.wording import counted
from wakefold.tracks.projection import Projection
from wakefold.tracks.tracks import Tracks


@st.composite
def ragged(draw, dims=(1, 2, 3)):
    """Random tracks with standstills, gaps and single points."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    dim = draw(st.sampled_from(dims))
    points, times = [], []
    for _ in range(draw(st.integers(1, 5))):
        n = draw(st.integers(1, 40))
        steps = rng.normal(size=(n, dim)) * rng.choice([0.0, 1.0, 50.0], (n, 1))
        points.append(rng.normal(size=dim) * 100 + np.cumsum(steps, axis=0))
        times.append(1.6e9 + np.cumsum(rng.choice([1.0, 7.5, 60.0, 4000.0], n)))
    tracks = Tracks.from_arrays(points, times)
    column = np.arange(len(tracks.points), dtype=float)
    return Tracks(tracks.points, tracks.times, tracks.offsets, tracks.ids, columns={"row": column})


def check_alone(tracks, method):
    """The result for a track does not depend on its neighbours, to the last bit."""
    together = method(tracks)
    one_by_one = [method(tracks.select([i])) for i in range(len(tracks))]
    assert together.ids.tolist() == [name for one in one_by_one for name in one.ids]
    assert together.points.tobytes() == b"".join(one.points.tobytes() for one in one_by_one)
    assert together.times.tobytes() == b"".join(one.times.tobytes() for one in one_by_one)


@given(ragged(), st.sampled_from([5.0, 60.0, 1e6]))
def test_gaps_partition_the_points(tracks, longest):
    pieces = tracks.segment(max_gap=longest, min_points=1)
    assert (pieces.columns["row"] == tracks.columns["row"]).all()
    for k in range(len(pieces)):
        assert (np.diff(pieces.times_of(k)) <= longest).all()
    for i, name in enumerate(tracks.ids):
        assert (pieces.attributes["agent"] == name).sum() == 1 + (np.diff(tracks.times_of(i)) > longest).sum()
    check_alone(tracks, lambda t: t.segment(max_gap=longest, min_points=1))


@given(ragged(), st.sampled_from([0.1, 3.0, 1e6]))
def test_no_leg_of_a_piece_is_too_fast(tracks, speed):
    pieces = tracks.segment(max_speed=speed, min_points=1)
    assert (pieces.columns["row"] == tracks.columns["row"]).all()
    for k in range(len(pieces)):
        assert (np.linalg.norm(np.diff(pieces[k], axis=0), axis=1) <= speed * np.diff(pieces.times_of(k))).all()
    for i, name in enumerate(tracks.ids):
        fast = np.linalg.norm(np.diff(tracks[i], axis=0), axis=1) > speed * np.diff(tracks.times_of(i))
        assert (pieces.attributes["agent"] == name).sum() == 1 + fast.sum()
    check_alone(tracks, lambda t: t.segment(max_speed=speed, min_points=1))


@given(ragged(), st.sampled_from([0.0, 1.0, 30.0]), st.sampled_from([1.0, 30.0, 4000.0]), st.sampled_from([1, 2, 5]))
def test_stops_follow_their_definition(tracks, radius, duration, min_points):
    every = tracks.segment(stop_radius=radius, stop_time=duration, min_points=1)
    stopped = np.concatenate([naive.stops(tracks[i], tracks.times_of(i), radius, duration) for i in range(len(tracks))])
    assert every.columns["row"].tolist() == np.flatnonzero(~stopped).tolist()
    assert (np.diff(np.flatnonzero(~stopped)) > 1).sum() <= len(every)
    kept = tracks.segment(stop_radius=radius, stop_time=duration, min_points=min_points)
    assert kept.ids.tolist() == every.ids[every.lengths >= min_points].tolist()
    lost = every.lengths[every.lengths < min_points].sum()
    assert any(f"({counted(lost, 'point')})" in note for note in kept.notes) == (lost > 0)
    assert any(f"{counted(stopped.sum(), 'point')} in stops" in note for note in kept.notes) == stopped.any()


def test_a_ferry_is_cut_at_its_berths():
    minute = np.arange(60.0)
    x = np.clip(minute - 20, 0, 20) * 300  # 20 minutes at berth, 20 under way, 20 at the other berth
    tracks = Tracks.from_columns(
        agent=["ferry"] * 60, time=minute * 60, x=x, y=0 * x, attributes={"type": ["passenger"] * 60}
    )
    voyage = tracks.segment(max_gap="30min", stop_radius="50m", stop_time=600)
    assert voyage.ids.tolist() == ["ferry#0"]
    assert voyage.attributes["agent"].tolist() == ["ferry"]
    assert voyage.attributes["type"].tolist() == ["passenger"]
    assert voyage[0][[0, -1], 0].tolist() == [300.0, 5700.0]
    assert voyage.segment(max_gap=30, min_points=1).ids[3] == "ferry#0#3"
    assert voyage.segment(max_gap=30, min_points=1).attributes["agent"][3] == "ferry"


def test_segment_needs_to_know_what_to_cut_at():
    tracks = Tracks.from_arrays([[[0.0, 0.0], [1.0, 0.0]]])
    for wrong in (
        {},
        {"stop_radius": 5},
        {"stop_time": 5},
        {"stop_radius": 5, "stop_time": 0},
        {"max_gap": "soon"},
        {"max_speed": 0},
    ):
        with pytest.raises(ValueError):  # noqa: PT011 -- five different messages
            tracks.segment(**wrong)
    empty = tracks.segment(stop_radius=10, stop_time=1)
    assert len(empty) == 0
    assert len(empty.segment(max_gap=1)) == len(empty.resample(5.0)) == len(empty.simplify(5.0)) == 0


@given(ragged(), st.sampled_from([3.0, 20.0, 200.0, 1e9]))
def test_resampling_by_distance(tracks, spacing):
    thin = tracks.resample(spacing)
    assert thin.ids.tolist() == tracks.ids.tolist()
    assert not thin.columns
    for i in range(len(tracks)):
        assert thin[i][[0, -1]].tolist() == tracks[i][[0, -1]].tolist()
        assert thin.times_of(i)[[0, -1]].tolist() == tracks.times_of(i)[[0, -1]].tolist()
        assert (np.linalg.norm(np.diff(thin[i], axis=0), axis=1) <= spacing * (1 + 1e-9)).all()
        steps = max(1, int(np.ceil(tracks.length[i] / spacing * (1 - 1e-12))))
        assert len(thin[i]) == (1 + steps if len(tracks[i]) > 1 else 1)
        for point in thin[i][:: 1 + len(thin[i]) // 20]:
            assert naive.distance_to_path(point, tracks[i]) <= 1e-6
    check_alone(tracks, lambda t: t.resample(spacing))


@given(ragged(), st.sampled_from([25.0, 777.7, 1e7]))
def test_resampling_by_time(tracks, period):
    even = tracks.resample(period=period)
    for i in range(len(tracks)):
        times = even.times_of(i)
        assert even[i][[0, -1]].tolist() == tracks[i][[0, -1]].tolist()
        assert times[[0, -1]].tolist() == tracks.times_of(i)[[0, -1]].tolist()
        steps = np.diff(times)
        assert (steps[:-1] == pytest.approx(period)) if len(steps) > 1 else True
        assert (steps <= period + 1e-3).all()
        for k in range(even.dim):
            assert even[i][:, k] == pytest.approx(np.interp(times, tracks.times_of(i), tracks[i][:, k]))


def test_an_even_walk_is_resampled_to_the_letter():
    walk = Tracks.from_arrays([[[0.0, 0.0], [500.0, 0.0], [1000.0, 0.0]]], [[0.0, 100.0, 300.0]])
    thin = walk.resample("200m")
    assert thin[0][:, 0] == pytest.approx([0, 200, 400, 600, 800, 1000])
    assert thin.times == pytest.approx([0, 40, 80, 140, 220, 300])
    assert walk.resample(period="2min").times.tolist() == [0, 120, 240, 300]


def test_standing_still_is_one_long_step():
    times = np.arange(7.0)
    x = [0.0, 0.0, 0.0, 10.0, 10.0, 20.0, 20.0]
    thin = Tracks.from_arrays([x], [times]).resample(5.0)
    assert thin[0][:, 0].tolist() == [0, 5, 10, 15, 20]
    assert thin.times[[0, 1, 3, 4]].tolist() == [0, 2.5, 4.5, 6]
    assert Tracks.from_arrays([[1.0, 1.0, 1.0]]).resample(5.0).times.tolist() == [0, 2]


def test_a_jump_keeps_the_clock_running():
    jump = Tracks.from_arrays([[[0.0, 0.0], [1e6, 0.0], [1e6, 1.0]]], [[1.6e9, 1.6e9 + 1e-3, 1.6e9 + 1]])
    thin = jump.resample(1.0)  # a metre each nanosecond, below the resolution of the times
    assert (np.diff(thin.times) > 0).all()
    assert len(thin.points) < 1e4
    assert thin[0][-1].tolist() == [1e6, 1.0]


def test_senseless_resampling_is_refused():
    tracks = Tracks.from_arrays([[[0.0, 0.0], [1e12, 0.0]]])
    for wrong in ({}, {"spacing": 1, "period": 1}, {"spacing": 0}, {"period": "0s"}, {"spacing": 1.0}, {"spacing": -1}):
        with pytest.raises(ValueError):  # noqa: PT011 -- five different messages
            tracks.resample(**wrong)


@given(ragged(), st.sampled_from([0.5, 10.0, 1e6]))
def test_simplification_keeps_its_promise(tracks, tolerance):
    few = tracks.simplify(tolerance)
    for i in range(len(tracks)):
        rows = (few.columns["row"][few.offsets[i] : few.offsets[i + 1]] - tracks.offsets[i]).astype(int)
        assert rows[[0, -1]].tolist() == [0, len(tracks[i]) - 1]
        assert few[i].tolist() == tracks[i][rows].tolist()
        for a, b in pairwise(rows):
            for point in tracks[i][a : b + 1]:
                assert naive.distance_to_path(point, tracks[i][[a, b]]) <= tolerance * (1 + 1e-12) + 1e-9
        assert rows.tolist() == naive.douglas_peucker(tracks[i], tolerance)
    assert f"{len(tracks.points) - len(few.points):,} of" in few.notes[0]


def test_filters_keep_whole_tracks_and_say_what_they_left_out():
    tracks = Tracks.from_columns(
        agent=["a", "a", "b", "b", "b", "c"],
        time=np.array([0, 10, 0, 3600, 7200, 5]) + 1606780800.0,
        lon=[-74.0, -74.1, 179.9, -179.9, -179.8, 0.0],
        lat=[40.0, 40.0, 0.0, 0.0, 0.0, 0.0],
        projection=Projection(-74.0, 40.0),
    )

    def kept(**conditions):
        return tracks.filter(**conditions).ids.tolist()

    assert kept() == ["a", "b", "c"]
    assert kept(min_points=2) == ["a", "b"]
    assert kept(min_length="9km") == ["b"]
    assert kept(min_duration="1h") == ["b"]
    assert kept(agents=["a", "c"]) == ["a", "c"]
    assert kept(lonlat_box=(179, -1, -179, 1)) == ["b"]
    assert kept(lonlat_box=(-180, -90, 180, 90)) == ["a", "b", "c"]
    assert kept(lonlat_box=(-75, 39, -74.05, 41)) == []
    assert kept(box=(-1e4, -1, 0, 1)) == []
    assert kept(box=(-1e4, -10, 0, 10)) == ["a"]
    assert kept(time=("2020-12-01", "2020-12-01T01:00:00Z")) == ["a", "c"]
    assert kept(time=(None, "2020-12-02")) == ["a", "b", "c"]
    assert kept(time=(1606780801.0, None)) == ["c"]
    note = tracks.filter(min_points=2, min_duration="1h").notes[-1]
    assert note == "filter: 2 of 3 tracks left out (1 by min_points, 1 by min_duration)"
    assert tracks.filter(min_points=1).notes == ()
    with pytest.raises(ValueError, match="planar"):
        Tracks.from_arrays([[0.0]]).filter(lonlat_box=(0, 0, 1, 1))


@given(st.floats(-180, 180), st.floats(-89, 89), st.integers(0, 100))
def test_tracks_move_to_another_plane_and_back(lon, lat, seed):
    rng = np.random.default_rng(seed)
    tracks = Tracks.from_arrays([rng.uniform(-1e5, 1e5, (5, 3))], projection=Projection(lon, lat))
    there = tracks.project(Projection(lon + 1, lat))
    back = there.project(Projection(lon, lat))
    assert np.abs(back.points - tracks.points).max() < 1e-3
    assert (there.points[:, 2] == tracks.points[:, 2]).all()
    assert tracks.project(Projection(lon, lat)) is tracks


def test_planar_tracks_have_no_other_plane():
    with pytest.raises(ValueError, match="planar"):
        Tracks.from_arrays([[[0.0, 0.0]]]).project(Projection(0, 0))
