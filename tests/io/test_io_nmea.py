"""AIVDM logs: times of every kind, messages of several sentences, clocks, damage."""

from __future__ import annotations

import numpy as np
import pytest
from pyais.encode import encode_dict
from pyais.messages import TagBlock

import wakefold.io as wio

START = 1_609_459_200  # 2021-01-01T00:00:00Z


def position(mmsi=366000001, lon=-74.0, lat=40.6, second=0, kind=1, **more):
    """The sentence of a position report."""
    fields = {"mmsi": mmsi, "lon": lon, "lat": lat, "second": second, "msg_type": kind, "speed": 10.2, "course": 90.5}
    return encode_dict(fields | {"heading": 91} | more, talker_id="AI")[0]


def voyage(mmsi=366000001, seq_id=1):
    """The two sentences of a static report."""
    fields = {
        "mmsi": mmsi,
        "msg_type": 5,
        "shipname": "AEGIR",
        "callsign": "WX1",
        "destination": "NEW YORK",
        "ship_type": 70,
    }
    size = {"to_bow": 60, "to_stern": 40, "to_port": 8, "to_starboard": 12}
    return encode_dict(fields | size, talker_id="AI", seq_id=seq_id)


def clock(second=0, minute=0):
    """The sentence of a base station."""
    moment = {"year": 2021, "month": 1, "day": 1, "hour": 0, "minute": minute, "second": second}
    return encode_dict({"mmsi": 3660001, "msg_type": 4, **moment}, talker_id="AI")[0]


def tagged(sentence, time):
    return "\\" + TagBlock.create_str(receiver_timestamp=str(time), source_station="r1").strip("\\") + "\\" + sentence


def read(tmp_path, *lines, **options):
    path = tmp_path / "log"
    path.write_text("\r\n".join(lines) + "\r\n")
    return wio.read_tracks(path, **options)


@pytest.mark.parametrize(
    "timed",
    [
        lambda s, t: tagged(s, t),
        lambda s, t: tagged(s, t * 1000),
        lambda s, t: f"{s},{t}",
        lambda s, t: f"{s},s22270,d-103,T45.1,x1,r003669930,{t}",
        lambda s, t: f"{t} {s}",
        lambda s, t: f"[{np.datetime64(t, 's')}Z] {s}",
        lambda s, t: f"{s}\t{np.datetime64(t, 's')}",
        lambda s, t: f"{np.datetime64(t * 1000 + 500, 'ms')}+00:00 {s}".replace(".500", ""),
    ],
)
def test_times_of_every_kind(tmp_path, timed):
    tracks, report = read(tmp_path, *(timed(position(lat=40.6 + i / 1000), START + 60 * i) for i in range(3)))
    assert report.format == "NMEA AIVDM log"
    assert (report.rows, report.kept) == (3, 3)
    np.testing.assert_array_equal(tracks.times, START + 60.0 * np.arange(3))
    np.testing.assert_allclose(tracks.projection.to_geodetic(tracks.points)[:, 1], [40.6, 40.601, 40.602], atol=1e-6)
    np.testing.assert_allclose(tracks.columns["sog"], 10.2 * 1852 / 3600, rtol=1e-6)
    np.testing.assert_allclose(tracks.columns["cog"], 90.5)


def test_stated_time_format(tmp_path):
    tracks, _ = read(tmp_path, "01.01.2021 00:00:07;" + position(), time_format="%d.%m.%Y %H:%M:%S")
    assert tracks.times[0] == START + 7


def test_gatehouse_wrapper(tmp_path):
    tracks, _ = read(tmp_path, "$PGHP,1,2021,1,1,0,0,9,0,366,2,366000001,1,2C*19", position())
    assert tracks.times[0] == START + 9


@pytest.mark.parametrize("kind", [1, 2, 3, 18, 19, 27])
def test_positions(tmp_path, kind):
    fields = {"mmsi": 7, "msg_type": kind, "lon": -74.0, "lat": 40.6, "speed": 10, "course": 90}
    tracks, report = read(tmp_path, *(f"{s},{START}" for s in encode_dict(fields, talker_id="AI")))
    assert report.kept == 1
    assert tracks.ids[0] == "7"
    assert tracks.columns["cog"][0] == 90


def test_destination_of_a_static_message_in_two_sentences(tmp_path):
    first, second = voyage()
    other = position(mmsi=2)
    tracks, report = read(tmp_path, f"{position()},{START}", first, f"{other},{START + 1}", second)
    assert (report.rows, report.kept) == (2, 2)
    found = {name: values[0] for name, values in tracks.attributes.items()}
    assert found == {
        "agent": "366000001", "name": "AEGIR", "callsign": "WX1", "type": "70", "destination": "NEW YORK",
        "length": 100.0, "width": 20.0,
    }  # fmt: skip
    assert tracks.attributes["destination"][1] == ""


def test_clock_of_a_base_station(tmp_path):
    lines = [position(second=50), clock(second=58), position(second=2, lat=40.601), position(second=57, lat=40.602)]
    tracks, report = read(tmp_path, *lines)
    np.testing.assert_array_equal(tracks.times, [START + 50, START + 57, START + 62])
    assert report.rejected == {}
    assert "3 positions are timed by the clock of a base station (message 4)" in report.notes


def test_no_time_at_all_is_refused(tmp_path):
    with pytest.raises(wio.ReadError, match=r"no usable positions[\s\S]*2 rejected: no time"):
        read(tmp_path, position(), position(lat=41))


def test_damage_is_counted(tmp_path):
    good = position()
    spoilt = good[:20] + ("A" if good[20] != "A" else "B") + good[21:]
    lines = [f"{good},{START}", f"{spoilt},{START}", f"{good[:25]}", "# a remark", voyage()[1], voyage(seq_id=2)[0]]
    _, report = read(tmp_path, *lines)
    assert report.rejected == {"bad checksum": 1, "bad line": 1, "incomplete message": 2}
    assert report.rows == 5
    assert "1 lines are no AIS sentences" in report.notes


def test_not_available(tmp_path):
    lines = [
        f"{position(lon=181, lat=91)},{START}",
        f"{position(speed=102.3, course=360, heading=511)},{START + 1}",
        f"{position(kind=27, speed=63, course=511)},{START + 2}",
    ]
    tracks, report = read(tmp_path, *lines)
    assert report.rejected == {"no position": 1}
    for name in ("sog", "cog", "heading"):
        assert np.isnan(tracks.columns[name]).all()
