"""Times that were read wrongly without a word: each kind, with variations."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from test_io_nmea import START, clock, position, tagged, voyage

import wakefold.io as wio

MAY = 1_714_557_600.0  # 2024-05-01T10:00:00Z
TWO_EPOCHS = [
    "!AIVDM,1,1,,A,1>pf7hOP1TJv<C0HOHP3Q2miP000,0*42,d-080,S2118,t050056.00,T56.48,r009990001,{},{}",
    "!AIVDM,1,1,,A,1>pf7hOP1TJv<UhHOHP3Q2lmP000,0*09,d-080,S2118,t050126.00,T26.48,r009990001,{},{}",
    "!AIVDM,1,1,,A,1>pf7hOP1TJv<pPHOHP3Q2miP000,0*11,d-080,S2118,t050156.00,T56.48,r009990001,{},{}",
]


def read(tmp_path, text, **options):
    path = tmp_path / "file"
    path.write_text(text) if isinstance(text, str) else path.write_bytes(text)
    return wio.read_tracks(path, **options)


def notes(report):
    return " | ".join(report.notes)


def log(numbers, own, behind="{}"):
    """Sentences of one ship whose own seconds are given, with what stands behind each."""
    return "\n".join(
        f"{position(lat=40 + k / 1e4, second=int(second))},{behind.format(*np.atleast_1d(number))}"
        for k, (number, second) in enumerate(zip(numbers, own, strict=True))
    )


@pytest.mark.parametrize("swap", [False, True])
def test_of_two_numbers_behind_a_sentence_the_one_that_goes_with_its_second_and_the_time_of_day(tmp_path, swap):
    pairs = [(1325394060, 1325394001), (1325394090, 1325394031), (1325394120, 1325394061)]
    lines = [line.format(*(pair[::-1] if swap else pair)) for line, pair in zip(TWO_EPOCHS, pairs, strict=True)]
    tracks, report = read(tmp_path, "\n".join(lines))
    assert tracks.times.tolist() == [1325394056.0, 1325394086.0, 1325394116.0]
    assert "several numbers" in notes(report)


@pytest.mark.parametrize("scale", [1, 1000, 10**6, 10**9])
def test_numbers_of_every_unit(tmp_path, scale):
    at = START + 7 * np.arange(12)
    tracks, _ = read(tmp_path, log([int(t) * scale for t in at], at % 60))
    assert tracks.times.tolist() == at.tolist()


@pytest.mark.parametrize(
    "numbers",
    [
        [366000001] * 12,  # an MMSI
        [999000001] * 12,
        [1_000_000_000 + k for k in range(12)],  # counters
        [1_700_000_000 + 100 * k for k in range(12)],
        [1_700_000_000_000 + k for k in range(12)],
    ],
)
def test_numbers_that_are_no_times_are_not_taken(tmp_path, numbers):
    own = np.random.default_rng(1).integers(0, 60, 12)
    text = log(numbers, own) + "\n" + f"{position(mmsi=9)},2021-01-01T00:00:00Z"
    tracks, report = read(tmp_path, text)
    assert report.rejected == {"no time": 12}
    assert list(tracks.ids) == ["9"]


def test_a_counter_beside_the_time_is_passed_over(tmp_path):
    at = START + 7 * np.arange(20)
    pairs = [(1_500_000_000 + 13 * k, t) for k, t in enumerate(at.tolist())]
    for order in (1, -1):
        tracks, _ = read(tmp_path, log([pair[::order] for pair in pairs], at % 60, "{},{}"))
        assert tracks.times.tolist() == at.tolist()


def test_a_receiver_whose_clock_is_off_is_believed_and_a_note_says_so(tmp_path):
    at = START + 7 * np.arange(20)
    tracks, report = read(tmp_path, log((at + 25).tolist(), at % 60))
    assert tracks.times.tolist() == (at + 25).tolist()
    assert "25 s off" in notes(report)


@pytest.mark.parametrize("mark", [",", "."])
def test_milliseconds_behind_a_comma(tmp_path, mark):
    sentence = position()
    tracks, _ = read(tmp_path, f"2021-03-01 12:00:00{mark}123 {sentence}\n2021-03-01 12:00:01{mark}987 {sentence}\n")
    assert np.round(tracks.times % 60, 3).tolist() == [0.123, 1.987]
    table = f"id;time;lon;lat\n1;2021-03-01 12:00:00{mark}123;1;2\n1;2021-03-01 12:00:01{mark}987;1;2.0001\n"
    assert np.round(read(tmp_path, table)[0].times % 60, 3).tolist() == [0.123, 1.987]


def test_rmc_and_zda_are_clocks_also_of_what_came_before(tmp_path):
    lines = [position(second=50), "$GPRMC,235958.00,A,5500.0,N,01030.0,E,0.0,0.0,311220,,,A*6F", position(second=59)]
    lines += ["$GPZDA,000010.00,01,01,2021,00,00*63", position(second=12, lat=40.601)]
    lines[1] = with_sum(lines[1])
    lines[3] = with_sum(lines[3])
    tracks, report = read(tmp_path, "\n".join(lines))
    assert tracks.times.tolist() == [START - 10, START - 1, START + 12]
    assert report.rejected == {}
    damaged = lines[1].replace("311220", "311221")  # its sum is wrong now
    with pytest.raises(wio.ReadError, match="no time"):
        read(tmp_path, "\n".join([lines[0], damaged]))


def with_sum(sentence):
    body = sentence[1 : sentence.index("*")]
    return f"${body}*{np.bitwise_xor.reduce(np.frombuffer(body.encode(), np.uint8)):02X}"


def test_a_clock_that_is_heard_rarely_goes_on_with_the_messages(tmp_path):
    at = START + 10 * np.arange(60)
    lines = [clock(), *(position(second=int(t % 60), lat=40 + k / 1e3) for k, t in enumerate(at))]
    tracks, _ = read(tmp_path, "\n".join(lines))
    assert tracks.times.tolist() == at.tolist()


def test_parts_of_a_message_of_another_day_or_station_do_not_go_together(tmp_path):
    first, second = voyage()
    for parts in (
        [f"{first},{START}", f"{second},{START + 86_400}"],
        [f"{first},r0001,{START}", f"{second},r0002,{START}"],
        [tagged(first, START), tagged(second, START + 7200)],
    ):
        tracks, report = read(tmp_path, "\n".join([f"{position()},{START}", *parts]))
        assert "name" not in tracks.attributes or not tracks.attributes["name"][0]
        assert report.rejected["incomplete message"] == 2
    tracks, _ = read(tmp_path, f"{position()},{START}\n{first},r1,{START}\n{second}\n")
    assert tracks.attributes["name"][0] == "AEGIR"


AIS = [(second, f"2024-05-01T10:{at}Z") for second, at in ((57, "00:58"), (7, "01:08"), (17, "01:18"), (60, "01:28"))]


def forms(names, rows):
    """A table as CSV, as JSON lines, as Parquet, and as points of GeoJSON."""
    yield "\n".join([",".join(names), *(",".join(map(str, row)) for row in rows)]).encode()
    yield "\n".join(json.dumps(dict(zip(names, row, strict=True))) for row in rows).encode()
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table({name: [row[k] for row in rows] for k, name in enumerate(names)}), sink)
    yield sink.getvalue().to_pybytes()
    if {"lon", "lat"} <= set(names):
        features = [
            {
                "type": "Feature",
                "geometry": {"type": "Point", "coordinates": [row[names.index("lon")], row[names.index("lat")]]},
                "properties": dict(zip(names, row, strict=True)),
            }
            for row in rows
        ]
        yield json.dumps({"type": "FeatureCollection", "features": features}).encode()


@pytest.mark.parametrize("received", ["received", "rx_time", "moment"])
def test_seconds_of_the_minute_are_no_times(tmp_path, received):
    names = ["mmsi", "lon", "lat", "timestamp", received]
    rows = [[7, 10.5 + k / 1e3, 55.1, second, time] for k, (second, time) in enumerate(AIS)]
    for data in forms(names, rows):
        tracks, report = read(tmp_path, data)
        assert tracks.times.tolist() == [MAY + 58, MAY + 68, MAY + 78, MAY + 88]
        assert f"{received} is the time: timestamp holds numbers from 0 to 63" in notes(report)
    for data in forms(names[:-1], [row[:-1] for row in rows]):
        with pytest.raises(wio.ReadError, match="timestamp holds numbers from 0 to 63"):
            read(tmp_path, data)
        tracks, _ = read(tmp_path, data, time_format="s", max_speed=None)
        assert tracks.times.tolist() == [7, 17, 57, 60]


def test_small_numbers_in_order_are_seconds(tmp_path):
    for data in forms(["id", "time", "lon", "lat"], [[1, k, 10 + k / 1e4, 55] for k in range(5)]):
        tracks, report = read(tmp_path, data)
        assert tracks.times.tolist() == [0, 1, 2, 3, 4]
        assert "which is no date" in notes(report)


def test_day_serials(tmp_path):
    serials = [44197.5 + k / 1440 for k in range(6)]
    rows = [["a", f"{serial:.9f}", 10 + k / 200, 55.0] for k, serial in enumerate(serials)]
    for data in forms(["id", "time", "lon", "lat"], rows):
        for options in ({}, {"time_format": "days"}):
            tracks, report = read(tmp_path, data, **options)
            assert tracks.times.tolist() == [1_609_502_400.0 + 60 * k for k in range(6)]
            assert ("spreadsheets" in notes(report)) == (not options)
    commas = "".join(f"a;{serial:.9f};10;55\n".replace(".", ",") for serial in serials)
    assert read(tmp_path, "id;time;lon;lat\n" + commas)[0].times[1] == 1_609_502_460.0
    _, report = read(tmp_path, "id,time,lon,lat\na,44197.5,10,55\na,44197.6,10.001,55\n")  # may be seconds
    assert "--time-format days" in notes(report)


@pytest.mark.parametrize(
    ("names", "cells"),
    [
        (("date", "time"), ("2024-05-01", "10:00:00")),
        (("Date", "Time"), ("20240501", "100000")),
        (("day", "time_utc"), ("2024/05/01", "10:00")),
        (("date", "t"), ("2024.05.01", "10:00:00.000")),
        (("date_utc", "time"), ("2024-05-01", "10:00:00,000")),
        (("DATE", "TIME"), ("2024-05-01", "10:00 AM")),
        (("date", "time"), ("31/12/2023", "10:00:00")),
        (("date", "time"), ("12/31/2023", "10:00:00")),
    ],
)
def test_a_date_and_a_time_of_day_are_joined(tmp_path, names, cells):
    at = MAY if "2024" in cells[0] else 1_704_016_800.0
    row = ";".join(cells)
    tracks, report = read(tmp_path, f"id;{';'.join(names)};lon;lat\n1;{row};10;55\n")
    assert tracks.times.tolist() == [at]
    assert "together" in notes(report)
    tracks, _ = read(
        tmp_path, f"id;a;b;lon;lat\n1;{row};10;55\n", columns={"agent": "id", "time": "a+b", "lon": "lon", "lat": "lat"}
    )
    assert tracks.times.tolist() == [at]


def test_digits_of_the_time_of_day_lose_their_zeros(tmp_path):
    rows = [[1, 20240501, clock, 10.0, 55.0] for clock in (95959, 100001)]
    for data in forms(["id", "date", "time", "lon", "lat"], rows):
        assert read(tmp_path, data)[0].times.tolist() == [MAY - 1, MAY + 1]


@pytest.mark.parametrize("times", [["10:15:30", "10:15:31"], ["101530", "101531", "101532"], ["081530", "081531"]])
def test_times_of_day_without_a_date_are_refused(tmp_path, times):
    rows = "".join(f"1,{time},10,{55 + k / 1e4}\n" for k, time in enumerate(times))
    with pytest.raises(wio.ReadError, match="holds times of day without a date"):
        read(tmp_path, "id,time,lon,lat\n" + rows)


@pytest.mark.parametrize("time", ["1/11/2023 0:00", "01.02.2023 10:00", "3-4-23 10:00"])
def test_what_may_be_two_days_is_asked_and_what_may_not_is_read(tmp_path, time):
    for header in ("mmsi,timestamp,lon,lat", "MMSI,BaseDateTime,LON,LAT"):
        with pytest.raises(wio.ReadError, match="can be read in more than one way; say how"):
            read(tmp_path, f"{header}\n1,{time},10,55\n")
        tracks, _ = read(tmp_path, f"{header}\n1,1/11/2023 0:00,10,55\n1,1/13/2023 0:05,10,55.1\n")
        assert tracks.times.tolist() == [1_673_395_200.0, 1_673_568_300.0]
    for form, month in (("%m/%d/%Y %H:%M", 1_673_395_200.0), ("%d/%m/%Y %H:%M", 1_698_796_800.0)):
        tracks, _ = read(tmp_path, "MMSI,BaseDateTime,LON,LAT\n1,1/11/2023 0:00,10,55\n", time_format=form)
        assert tracks.times.tolist() == [month]


@pytest.mark.parametrize("name", ["zeit", "obs_time", "fix_date", "tijdstip", "measured"])
def test_a_time_under_an_unknown_name_is_asked_for(tmp_path, name):
    for data in forms(["mmsi", name, "lon", "lat"], [[7, "2024-05-01T10:00:00", 10.5, 59.1]]):
        with pytest.raises(wio.ReadError, match=f"which column is time\\? There are {name}"):
            read(tmp_path, data)
        assert read(tmp_path, data, columns={"time": name})[0].times.tolist() == [MAY]


@pytest.mark.parametrize("name", ["date_time_utc", "UTC time", "DateTime", "gps_time", "Unix Time", "utc"])
def test_names_of_times(tmp_path, name):
    tracks, _ = read(tmp_path, f"mmsi,{name},lon,lat\n7,2024-05-01T10:00:00,10.5,59.1\n")
    assert tracks.times.tolist() == [MAY]


def test_units_in_the_name(tmp_path):
    for name, unit in (("time_ms", 1000), ("timestamp_us", 10**6), ("epochNanos", 10**9)):
        tracks, _ = read(tmp_path, f"mmsi,{name},lon,lat\n7,{int(MAY) * unit},10.5,59.1\n")
        assert tracks.times.tolist() == [MAY]


def test_frames_are_times(tmp_path):
    tracks, report = read(tmp_path, "frame,id,x,y\n101,1,0,0\n102,1,1,0\n105,1,2,0\n")
    assert tracks.times.tolist() == [101, 102, 105]
    assert "taken for seconds" in notes(report)


def line(geometry, **properties):
    return json.dumps({"type": "Feature", "geometry": geometry, "properties": {"id": "a", **properties}})


def test_one_list_of_times_for_all_parts(tmp_path):
    parts = {"type": "MultiLineString", "coordinates": [[[0, 0], [0, 0.001]], [[0, 1], [0, 1.001], [0, 1.002]]]}
    flat = [MAY + 10 * k for k in range(5)]
    tracks, _ = read(tmp_path, line(parts, times=flat))
    assert tracks.times.tolist() == flat
    tracks, _ = read(tmp_path, line(parts, times=[flat[:2], flat[2:]]))
    assert tracks.times.tolist() == flat
    for wrong in (flat[:4], [*flat, MAY + 99]):
        with pytest.raises(wio.ReadError, match="5 rejected: no time"):
            read(tmp_path, line(parts, times=wrong))


def test_more_times_than_positions_fit_nowhere(tmp_path):
    with pytest.raises(wio.ReadError, match="2 rejected: no time"):
        read(tmp_path, line({"type": "LineString", "coordinates": [[0, 0], [0, 1]]}, times=[MAY, MAY + 1, MAY + 2]))


@pytest.mark.parametrize("scale", [1, 1000])
def test_the_time_as_fourth_coordinate(tmp_path, scale):
    places = [[10, 55 + k / 1e4, 0, (MAY + 60 * k) * scale] for k in range(3)]
    tracks, report = read(tmp_path, line({"type": "LineString", "coordinates": places}))
    assert tracks.times.tolist() == [MAY, MAY + 60, MAY + 120]
    assert "fourth coordinate" in notes(report)
    points = "\n".join(line({"type": "Point", "coordinates": place}) for place in places)
    assert read(tmp_path, points)[0].times.tolist() == [MAY, MAY + 60, MAY + 120]
    for measure in ([0.0, 10.0, 20.0], [MAY + 60, MAY, MAY + 120]):  # a distance; not in order
        places = [[10, 55 + k / 1e4, 0, value] for k, value in enumerate(measure)]
        _, report = read(tmp_path, line({"type": "LineString", "coordinates": places}))
        assert report.untimed == 3


def test_time_formats_of_every_format(tmp_path):
    feature = line({"type": "LineString", "coordinates": [[0, 0]]}, times=[MAY * 1000])
    tracks, _ = read(tmp_path, feature, time_format="ms")
    assert tracks.times.tolist() == [MAY]
    gpx = '<gpx><trk><trkseg><trkpt lat="1" lon="2"><time>01.05.2024 10:00</time></trkpt></trkseg></trk></gpx>'
    assert read(tmp_path, gpx, time_format="%d.%m.%Y %H:%M")[0].times.tolist() == [MAY]
    traj = "*T*,u,terrestrial,1,0,*P*,terrestrial,2,1,1,0,7,1714557600000,-74.0,40.0"
    assert read(tmp_path, traj, time_format="ms")[0].times.tolist() == [MAY]
    with pytest.raises(wio.ReadError, match=r"time_format \(--time-format\) does not apply"):
        read(tmp_path, "TRACK.R1=[[593 42 95];[588 48 96]];\n", time_format="ms")
    stamps = pa.table({"id": [1], "time": pa.array([int(MAY)], pa.timestamp("s")), "lon": [1.0], "lat": [2.0]})
    pq.write_table(stamps, tmp_path / "p")
    with pytest.raises(wio.ReadError, match="take no time_format"):
        wio.read_tracks(tmp_path / "p", time_format="ms")


@pytest.mark.parametrize(
    "time", ["2024-05-01 10:00:00 UTC", "2024-05-01T10:00:00.000Z", "20240501T100000Z", "2024/05/01 10:00:00",
             "2024-05-01 12:00:00+02", "2024-05-01 10:00:00 GMT", "20240501100000", "2024-05-01 10:00"],
)  # fmt: skip
def test_spellings_of_a_moment(tmp_path, time):
    for data in forms(["id", "time", "lon", "lat"], [["a", time, 10.0, 55.0]]):
        assert read(tmp_path, data)[0].times.tolist() == [MAY]


@pytest.mark.parametrize("good", ["2024-05-01T10:00:00Z", "1714557600", "20240501100000"])
def test_damaged_times_cost_their_rows_only(tmp_path, good):
    rows = [f"7,{good},10,55", "7,bad,10,55", "8,,10,55", f"8,{good},10,55", f"9,{good},10,55"]
    tracks, report = read(tmp_path, "\n".join(["mmsi,time,lon,lat", *rows]))
    assert tracks.times.tolist() == [MAY] * 3
    assert report.rejected == {"no time": 2}


def test_a_time_that_the_caller_names_is_read_as_its_values_can_be(tmp_path):
    text = "A;Zeit;10;55\nB;31.05.2024 10:00:00;10;55\n"
    columns = {"agent": "Name", "time": "Wann", "lon": "Ost", "lat": "Nord"}
    header = "Name;Wann;Ost;Nord\n"
    tracks, report = read(tmp_path, header + text, columns=columns)
    assert tracks.times.tolist() == [MAY + 30 * 86_400]
    assert "are read as %d.%m.%Y %H:%M:%S" in notes(report)
    with pytest.raises(wio.ReadError, match="can be read in more than one way"):
        read(tmp_path, header + text.replace("31", "11"), columns=columns)
