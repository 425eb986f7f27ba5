"""AIS as CSV: both generations of MarineCadastre, the Danish files, and the rules on rows."""

from __future__ import annotations

import numpy as np
import pytest

import wakefold.io as wio

OLD = (
    "MMSI,BaseDateTime,LAT,LON,SOG,COG,Heading,VesselName,IMO,CallSign,VesselType,Status,Length,Width,Draft,Cargo,"
    "TransceiverClass"
)
NEW = (
    "mmsi,base_date_time,longitude,latitude,sog,cog,heading,vessel_name,imo,call_sign,vessel_type,status,length,width,"
    "draft,cargo,transceiver"
)
DMA = (
    "# Timestamp,Type of mobile,MMSI,Latitude,Longitude,Navigational status,ROT,SOG,COG,Heading,IMO,Callsign,Name,"
    "Ship type,Cargo type,Width,Length,Type of position fixing device,Draught,Destination,ETA,Data source type,A,B,C,D"
)


def old(
    mmsi="367000140", time="2020-06-30T00:00:00", lat="40.64409", lon="-74.07157", sog="5.0", cog="-60.6", heading="246"
):
    """A line of a MarineCadastre file."""
    return f"{mmsi},{time},{lat},{lon},{sog},{cog},{heading},SAMUEL,IMO7702774,WYR3371,60.0,0,94.0,21.0,5.1,69,A"


def read(tmp_path, *lines, header=OLD, end="\n", **options):
    path = tmp_path / "any.name"
    path.write_bytes((end.join([header, *lines]) + end).encode("latin-1"))
    return wio.read_tracks(path, **options)


def place(tracks):
    return tracks.projection.to_geodetic(tracks.points)


def test_old_names(tmp_path):
    tracks, report = read(tmp_path, old(), old(time="2020-06-30T00:01:00", lat="40.65"))
    assert report.format == "MarineCadastre CSV"
    assert (report.rows, report.kept, report.rejected) == (2, 2, {})
    assert list(tracks.ids) == ["367000140"]
    np.testing.assert_allclose(place(tracks), [[-74.07157, 40.64409], [-74.07157, 40.65]], atol=1e-9)
    np.testing.assert_array_equal(tracks.times, 1593475200 + np.array([0.0, 60.0]))
    np.testing.assert_allclose(tracks.columns["sog"], 5 * 1852 / 3600, rtol=1e-6)
    np.testing.assert_allclose(tracks.columns["cog"], 299.4, rtol=1e-6)
    found = {name: values[0] for name, values in tracks.attributes.items()}
    assert found == {
        "agent": "367000140", "name": "SAMUEL", "callsign": "WYR3371", "type": "60", "length": 94.0, "width": 21.0
    }  # fmt: skip


def test_new_names_longitude_first(tmp_path):
    line = "367000140,2025-01-02 03:04:05,-74.07157,40.64409,5.0,60.6,246,A B,IMO1,WYR,60,0,94,21,5.1,69,A"
    tracks, report = read(tmp_path, line, header=NEW)
    assert report.format == "MarineCadastre CSV"
    np.testing.assert_allclose(place(tracks), [[-74.07157, 40.64409]], atol=1e-9)
    assert tracks.times[0] == 1735787045


@pytest.mark.parametrize(
    "header",
    ["BaseDateTime,LON,LAT,MMSI,SOG,COG,TranscieverClass,ETA", "LAT,LON,extra,MMSI,BaseDateTime"],
)
def test_spellings_missing_and_extra_columns(tmp_path, header):
    cells = {"BaseDateTime": "2020-06-30T00:00:00", "LON": "-74", "LAT": "40", "MMSI": "1", "SOG": "1", "COG": "1"}
    tracks, report = read(tmp_path, ",".join(cells.get(name, "") for name in header.split(",")), header=header)
    assert report.kept == 1
    assert tracks.ids[0] == "1"


def test_danish(tmp_path):
    rest = "Under way using engine,0.0,12.3,102.3,511,Unknown,Unknown,SØREN,Cargo,,20,100,GPS,6.5,{},12/11/2024,AIS"
    lines = [
        "01/11/2024 00:00:01,Class A,219000001,57.1,11.2," + rest.format("GOTEBORG") + ",1,2,3,4",
        "01/11/2024 00:00:01,Class A,219000001,57.1,11.2," + rest.format("GOTEBORG") + ",1,2,3,4",
        "41/11/2024 00:00:01,Class A,219000001,57.1,11.2," + rest.format("Unknown") + ",1,2,3,4",
        "01/11/2024 00:00:11,Class A,219000001,57.101,11.2," + rest.format("Unknown") + ",1,2,3,4",
        "01/11/2024 00:00:02,Base Station,2190064,91,11.2," + rest.format("Unknown") + ",1,2,3,4",
    ]
    tracks, report = read(tmp_path, *lines, header=DMA)
    assert report.format == "Danish Maritime Authority CSV"
    assert (report.rows, report.kept) == (5, 2)
    assert report.rejected == {"duplicate": 1, "no time": 1, "fixed station": 1}
    assert tracks.times[0] == 1730419201
    assert tracks.attributes["destination"][0] == "GOTEBORG"
    assert tracks.attributes["name"][0] == "SØREN"
    assert tracks.attributes["callsign"][0] == ""
    assert tracks.attributes["type"][0] == "Cargo"
    older = [line.rsplit(",", 4)[0] for line in lines]
    again, _ = read(tmp_path, *older, header=DMA.rsplit(",", 4)[0])
    np.testing.assert_array_equal(again.points, tracks.points)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (old(lat="91"), "no position"),
        (old(lon="181"), "no position"),
        (old(lat=""), "no position"),
        (old(lat="x"), "no position"),
        (old(mmsi=""), "no agent"),
        (old(time=""), "no time"),
        (old(time="2020-02-31T00:00:00"), "no time"),
        (old(time="soon"), "no time"),
        (old()[:30], "bad line"),
        (old() + ",1", "bad line"),
        (old().replace("SAMUEL", '"SAMUEL'), "bad line"),
        (old().replace("246,SAMUEL", '24" 6,"SAMUEL'), "bad line"),
    ],
)
def test_one_bad_line_costs_itself_only(tmp_path, line, reason):
    good = [old(time=f"2020-06-30T00:{m:02d}:00", lat=f"40.{m:02d}") for m in range(10, 20)]
    tracks, report = read(tmp_path, *good[:5], line, *good[5:], max_speed=None)
    assert (report.rows, report.kept, report.rejected) == (11, 10, {reason: 1})
    (offence,) = report.offences[reason]
    assert offence == ("any.name", 7, line)
    assert len(tracks.points) == 10


def test_sentinels_are_nan_but_the_row_stays(tmp_path):
    tracks, report = read(
        tmp_path, old(sog="102.3", cog="360", heading="511"), old(time="2020-06-30T00:01:00", sog="abc")
    )
    assert report.kept == 2
    assert np.isnan(tracks.columns["sog"]).all()
    assert np.isnan(tracks.columns["cog"][0])
    assert np.isnan(tracks.columns["heading"][0])
    assert tracks.columns["heading"][1] == 246


def test_order_duplicates_and_same_time(tmp_path):
    lines = [
        old(time="2020-06-30T00:02:00", lat="40.602"),
        old(time="2020-06-30T00:00:00", lat="40.600"),
        old(time="2020-06-30T00:01:00", lat="40.601"),
        old(time="2020-06-30T00:01:00", lat="40.6012"),
        old(time="2020-06-30T00:01:00", lat="40.601"),
        old(mmsi="2", time="2020-06-30T00:01:00"),
    ]
    tracks, report = read(tmp_path, *lines)
    assert report.rejected == {"duplicate": 1, "same time": 1}
    assert report.offences["same time"][0].line == 5
    assert report.offences["duplicate"][0].line == 6
    assert report.notes == ("1 rows followed a later one of the same agent and were sorted",)
    np.testing.assert_allclose(place(tracks)[:3, 1], [40.6, 40.601, 40.602], atol=1e-9)


def test_jump(tmp_path):
    lats = ["40.600", "40.601", "41.9", "40.603", "40.604"]
    lines = [old(time=f"2020-06-30T00:0{m}:00", lat=lat) for m, lat in enumerate(lats)]
    tracks, report = read(tmp_path, *lines)
    assert report.rejected == {"jump": 1}
    assert report.offences["jump"][0].line == 4
    assert len(tracks.points) == 4
    assert read(tmp_path, *lines, max_speed=None)[1].kept == 5


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_marks_ends_quotes_and_blank_lines(tmp_path, end):
    lines = [old(), "", old(time="2020-06-30T00:01:00").replace("SAMUEL", '"SAM, ""UEL"""'), "  "]
    tracks, report = read(tmp_path, *lines, header="\xef\xbb\xbf" + OLD, end=end)
    assert (report.rows, report.kept) == (2, 2)
    assert tracks.attributes["name"][0] == 'SAM, "UEL"'


def test_truncated_last_line(tmp_path):
    path = tmp_path / "cut.csv"
    path.write_text("\n".join([OLD, old(), old(time="2020-06-30T00:01:00")[:40]]))
    _, report = wio.read_tracks(path)
    assert (report.rows, report.kept, report.rejected) == (2, 1, {"bad line": 1})


def test_nothing_but_bad_lines(tmp_path):
    with pytest.raises(
        wio.ReadError, match=r"no usable positions[\s\S]*2 rejected: no position[\s\S]*any.name:2: 367000140"
    ):
        read(tmp_path, old(lat="91"), old(lon="181"))


def test_many_blocks_agree_with_one(tmp_path, monkeypatch):
    random = np.random.default_rng(0)
    lines = [
        old(
            mmsi=str(random.integers(1, 30)),
            time=f"2020-06-30T{s // 3600:02d}:{s // 60 % 60:02d}:{s % 60:02d}",
            lat=f"40.{s}",
        )
        for s in random.integers(0, 86400, 2000)
    ]
    for at in random.integers(0, 2000, 50):
        lines[at] = random.choice(["", "rubbish", old(lat="?"), old()[:20], lines[0]])
    whole, report = read(tmp_path, *lines, max_speed=None)
    monkeypatch.setattr("wakefold.io.source.BLOCK", 1000)
    monkeypatch.setattr("wakefold.io.source.HEAD", 1000)
    monkeypatch.setattr("wakefold.io.source.Source.blocks.__defaults__", (1000, None))
    pieces, report_of_pieces = read(tmp_path, *lines, max_speed=None)
    assert report == report_of_pieces
    assert report.rows == report.kept + sum(report.rejected.values())
    np.testing.assert_array_equal(whole.points, pieces.points)
    np.testing.assert_array_equal(whole.times, pieces.times)
    np.testing.assert_array_equal(whole.ids, pieces.ids)


def test_real_hour_of_new_york(shared_data):
    tracks, report = wio.read_tracks(shared_data("nyharbor_ais/NYHarbor_2020_06_30_first_hour.csv"))
    assert (report.rows, len(tracks), report.rejected) == (8689, 295, {"duplicate": 2})
    assert tracks.projection.lat == pytest.approx(40.65, abs=0.1)
