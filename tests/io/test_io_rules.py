"""The rules that compare rows, against loops."""

from __future__ import annotations

from itertools import pairwise

import naive
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wakefold.io import ReadError, rules
from wakefold.io.collect import Collector
from wakefold.io.records import Latest, Rows, last_rows

ROWS = st.lists(
    st.tuples(st.sampled_from("abc"), *([st.integers(0, 8).map(float)] * 3)), min_size=1, max_size=40
)  # agent, time, x, y: few values, so that all rules are met


def batches(rows, cuts):
    bounds = sorted({0, len(rows), *(cut % (len(rows) + 1) for cut in cuts)})
    for lo, hi in pairwise(bounds):
        agent, time, x, y = zip(*rows[lo:hi], strict=True)
        yield Rows(
            agent=pa.array(agent),
            time=np.array(time),
            position=(np.array(x), np.array(y)),
            geodetic=False,
            lines=np.arange(lo, hi) + 1,
            text=str,
            attributes={"name": pa.array([f"{a}{t}" if t % 2 else "" for a, t in zip(agent, time, strict=True)])},
        )


@given(rows=ROWS, cuts=st.lists(st.integers(0, 40), max_size=3), max_speed=st.floats(0.5, 8))
def test_collector_against_loops(rows, cuts, max_speed):
    collector = Collector()
    collector.open("file")
    for batch in batches(rows, cuts):
        collector.add(batch)
    expected, counts = naive.clean_rows(rows, max_speed)
    if not expected:
        with pytest.raises(ReadError):
            collector.finish("rows", max_speed)
        return
    tracks, report = collector.finish("rows", max_speed)
    assert list(tracks.ids) == list(expected)
    for i, track in enumerate(expected.values()):
        np.testing.assert_array_equal(tracks.times_of(i), [row[1] for row in track])
        np.testing.assert_array_equal(tracks[i], [row[2:] for row in track])
    assert report.rejected == {reason: count for reason, count in counts.items() if count}
    assert report.rows == len(rows) == report.kept + sum(report.rejected.values())
    names = [[f"{a}{t}" for a, t, *_ in rows if a == agent[0] and t % 2] for agent in expected]
    assert list(tracks.attributes["name"]) == [known[-1] if known else "" for known in names]


def test_what_is_too_far_for_its_neighbours_is_a_jump():
    codes, time = np.zeros(4, dtype=np.int32), np.arange(4.0)
    for x, expected in (
        ([0.0, 50.0, 50.5, 51.0], [-1, 0, 0, 0]),
        ([0.0, 50.0, 1.0, 1.5], [0, -1, 0, 0]),
        ([0.0, 0.5, 1.0, 50.0], [0, 0, 0, -1]),
        ([0.0, 0.5, 50.0, 50.5], [0, 0, -1, -1]),  # nobody knows which are right; those that are kept fit together
        ([0.0, 50.0, 100.0, 150.0], [0, -1, -1, -1]),
    ):
        found = rules.bodies(codes, time, [np.array(x), np.zeros(4)], geodetic=False, limit=10.0)
        assert found.tolist() == expected


def test_great_circle_and_pieces(monkeypatch):
    assert rules.great_circle(*np.array([[179.9], [0.0], [-179.9], [0.0]]))[0] == pytest.approx(22_239, rel=1e-4)
    assert rules.great_circle(*np.array([[0.0], [-90.0], [7.0], [90.0]]))[0] == pytest.approx(
        np.pi * 6_371_009, rel=1e-6
    )
    random = np.random.default_rng(0)
    lon, lat = random.uniform(-180, 180, 1000), random.uniform(-90, 90, 1000)
    codes, time = np.repeat(np.arange(10, dtype=np.int32), 100), np.arange(1000.0)
    whole = rules.fast_legs(codes, time, [lon, lat], geodetic=True, limit=5e6), *rules.project(lon, lat)
    monkeypatch.setattr(rules, "CHUNK", 7)
    pieces = rules.fast_legs(codes, time, [lon, lat], geodetic=True, limit=5e6), *rules.project(lon, lat)
    assert 0 < whole[0].sum() < 990
    np.testing.assert_array_equal(whole[0], pieces[0])
    np.testing.assert_array_equal(whole[1], pieces[1])
    assert whole[2] == pieces[2]


def test_grouping_is_stable():
    codes = np.random.default_rng(0).integers(0, 50, 5000).astype(np.int32)
    np.testing.assert_array_equal(rules.grouping(codes), np.argsort(codes, kind="stable"))


def test_latest_over_many_merges_and_kinds(monkeypatch):
    monkeypatch.setattr("wakefold.io.records.MERGE", 5)
    random, latest, expected = np.random.default_rng(0), Latest(), {}
    for _ in range(50):
        codes = random.integers(0, 20, 30).astype(np.int32)
        values = random.choice(["", "x", "y", "z"], 30)
        good = random.random(30) < 0.8
        latest.add(codes, pa.array(values.tolist()), good, last_rows(codes, good))
        expected |= {int(c): str(v) for c, v, g in zip(codes, values, good, strict=True) if g and v}
    assert latest.of(np.arange(25)).tolist() == [expected.get(c, "") for c in range(25)]
    latest.add(np.array([3], dtype=np.int32), np.array([1.5]), np.array([True]), np.array([0]))
    assert latest.of(np.array([3])).tolist() == ["1.5"]
