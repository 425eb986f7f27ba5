"""Public functions refuse what is of a wrong kind in a sentence that names it, whatever it is."""

from __future__ import annotations

import numpy as np
import pytest

import wakefold as wf

HUGE = 10**400
FIX = wf.Fix(lon=10.0, lat=55.0)
ODD = ["x", None, 5, HUGE, [], {}, b"x", 2.5, float("nan"), True, object(), "a\0b"]
ALLOWED = (TypeError, ValueError)
# What Python itself says when nobody looked: no sentence for a person.
RAW = (
    "has no attribute", "object is not iterable", "not supported between", "invalid literal", "argument must be",
    "could not convert", "expected str, bytes", "too large to convert", "did not contain a loop", "unsupported operand",
)  # fmt: skip


@pytest.fixture(scope="module")
def model():
    lon, lat = np.tile(10 + np.arange(5) / 1e3, 2), np.repeat([55.0, 55.001], 5)
    time = 1.7e9 + np.tile(60.0 * np.arange(5), 2)
    return wf.learn(wf.Tracks.from_columns(agent=["a"] * 5 + ["b"] * 5, time=time, lon=lon, lat=lat))


def refused(call, *arguments, **named):
    """Whether a call is refused; any other end of it than a result or a sentence fails."""
    try:
        call(*arguments, **named)
    except ALLOWED as error:
        text = str(error)
        assert text, named
        assert not any(raw in text for raw in RAW), text
        assert len(text) < 600
        return True
    return False


@pytest.mark.parametrize("odd", ODD, ids=lambda odd: repr(odd)[:12])
@pytest.mark.parametrize("kind", [wf.MHPF, wf.BL1, wf.BL2, wf.Calibrated])
def test_filters(model, kind, odd):
    assert refused(kind, odd)
    for name in ("particles", "seed", "sd", "dof", "depletion", "likelihood", "resampling"):
        refused(kind, model, **{name: 20 if odd == HUGE and name == "seed" else odd})
    follower = kind(model, 20)
    belief = follower.start(fix=FIX, time=1.7e9)
    assert refused(follower.start, fix=odd) == (odd is not None)
    assert refused(follower.start, agent=odd) == (not isinstance(odd, str) and odd is not None)
    refused(follower.start, time=odd)
    refused(follower.start, at=odd)
    assert refused(follower.step, odd)
    assert refused(follower.step, odd, [], dt=1.0)
    refused(follower.step, belief, odd, dt=1.0)
    assert refused(follower.step, belief, [odd], dt=1.0)
    refused(follower.step, belief, [], dt=odd)
    refused(follower.step, belief, [], time=odd)
    refused(follower.forecast, belief, odd)
    assert refused(follower.forecast, odd, [1.0])


@pytest.mark.parametrize("odd", ODD, ids=lambda odd: repr(odd)[:12])
def test_reading_learning_and_evidence(model, tmp_path, odd):
    path = tmp_path / "t.csv"
    path.write_text("id,t,x,y\na,0,1,2\n")
    assert refused(wf.read_tracks, odd)
    refused(wf.read_tracks, [odd])
    for name in ("format", "columns", "time_format", "max_speed", "max_unpacked"):
        refused(wf.read_tracks, path, **{name: odd})
    assert refused(wf.learn, odd)
    for name in ("linkage", "epsilon", "noise", "scale", "sd", "threads"):
        refused(wf.learn, model.tracks, **{name: odd})
    assert refused(wf.load, odd)
    assert refused(wf.write_tracks, odd, path)
    refused(wf.write_tracks, model.tracks, odd)
    refused(wf.Fix, odd)
    for name in ("lon", "lat", "sd"):
        refused(wf.Fix, **({"lon": 1.0, "lat": 2.0} | {name: odd}))
    for arguments in ((odd,), (1, odd), (1, 1.0, odd)):
        refused(wf.CoarseClass, *arguments)
    assert refused(wf.Tracks.from_arrays, odd)
    refused(wf.Tracks.from_arrays, [odd])
