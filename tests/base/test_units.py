from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wakefold.base.units import metres, metres_per_second, seconds, timestamp


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (1800, 1800.0),
        ("1800", 1800.0),
        ("30min", 1800.0),
        (" 0.5 h ", 1800.0),
        ("1h 30min", 5400.0),
        ("1h30min", 5400.0),
        ("2 days", 172800.0),
        ("250ms", 0.25),
        ("1e3", 1000.0),
        (timedelta(minutes=5), 300.0),
        (np.timedelta64(5, "m"), 300.0),
        (0, 0.0),
    ],
)
def test_durations(given, expected):
    assert seconds(given) == pytest.approx(expected, abs=0)


@pytest.mark.parametrize(("given", "expected"), [(200, 200), ("200m", 200), ("1.5 km", 1500), ("2nmi", 3704)])
def test_lengths(given, expected):
    assert metres(given) == expected


@pytest.mark.parametrize("bad", ["", "abc", "5 parsecs", "min", "5min!", "-3s", -3, "nan", float("inf"), "1h-5min"])
def test_what_is_not_a_duration_is_refused(bad):
    with pytest.raises(ValueError, match="duration"):
        seconds(bad)


@pytest.mark.parametrize(
    ("given", "expected"), [(1, 1.0), ("3.6 km/h", 1.0), ("2kn", 3704 / 3600), ("1 knots", 1852 / 3600)]
)
def test_speeds(given, expected):
    assert metres_per_second(given) == expected


def test_minutes_are_not_metres():
    with pytest.raises(ValueError, match="length"):
        metres("5min")
    with pytest.raises(ValueError, match="duration"):
        seconds("5m")


@given(st.integers(0, 50), st.integers(0, 50), st.integers(0, 50))
def test_parts_of_a_duration_add_up(hours, minutes, secs):
    assert seconds(f"{hours}h {minutes}min {secs}s") == 3600 * hours + 60 * minutes + secs


def test_a_time_without_a_zone_is_utc():
    moment = datetime(2020, 12, 8, 6, 30, tzinfo=UTC).timestamp()
    assert timestamp("2020-12-08T06:30:00Z") == timestamp("2020-12-08 06:30") == moment
    assert timestamp("2020-12-08T08:30:00+02:00") == timestamp(datetime(2020, 12, 8, 6, 30)) == moment
    assert timestamp(np.datetime64("2020-12-08T06:30")) == timestamp(moment) == moment
    for bad in ("yesterday", float("nan")):
        with pytest.raises(ValueError, match="not a time"):
            timestamp(bad)
