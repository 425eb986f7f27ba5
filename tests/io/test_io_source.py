"""Packed files, several members, damage, bombs; recognising formats; errors of files."""

from __future__ import annotations

import gzip
import io
import time
import zipfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import wakefold.io as wio
from wakefold.io.sniff import FORMATS

CSV = b"id,t,x,y\n" + b"".join(b"%d,%d,%d,%d\n" % (i % 7, i, i * 13 % 101, i * 17 % 103) for i in range(3000))


def zst(data):
    sink = pa.BufferOutputStream()
    with pa.CompressedOutputStream(sink, "zstd") as stream:
        stream.write(data)
    return sink.getvalue().to_pybytes()


def archive(**members):
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in members.items():
            file.writestr(name, data)
    return sink.getvalue()


def read(tmp_path, data, **options):
    path = tmp_path / "file"
    path.write_bytes(data)
    return wio.read_tracks(path, **options)


@pytest.mark.parametrize(
    "packed",
    [gzip.compress(CSV), gzip.compress(CSV[:5000]) + gzip.compress(CSV[5000:]), zst(CSV),
     zst(CSV[:5000]) + zst(CSV[5000:]), archive(a=CSV), archive(a=gzip.compress(CSV))],
)  # fmt: skip
def test_packed_is_as_plain(tmp_path, packed):
    plain, _ = read(tmp_path, CSV)
    tracks, report = read(tmp_path, packed)
    np.testing.assert_array_equal(tracks.points, plain.points)
    assert report.rows == 3000


def test_all_members_of_an_archive(tmp_path):
    members = {"b.csv": CSV[:1000], "a.csv": CSV, "__MACOSX/a.csv": b"junk", "dir/": b"", ".hidden": b"junk"}
    _, report = read(tmp_path, archive(**members))
    assert report.files == ("file/a.csv", "file/b.csv")


@pytest.mark.parametrize("pack", [gzip.compress, zst, lambda data: archive(a=data)])
@pytest.mark.parametrize("cut", [4, 20, 0.3, 0.7, -5])
def test_cut_off_archives_are_refused(tmp_path, pack, cut):
    packed = pack(CSV)
    size = int(cut * len(packed)) if isinstance(cut, float) else cut
    with pytest.raises(wio.ReadError):
        read(tmp_path, packed[:size])


@pytest.mark.parametrize("pack", [gzip.compress, lambda data: archive(a=data)])
def test_spoilt_archives_are_refused(tmp_path, pack):
    packed = bytearray(pack(CSV))
    packed[len(packed) // 2] ^= 0xFF
    with pytest.raises(wio.ReadError, match=r"damaged|cannot be read"):
        read(tmp_path, bytes(packed))


@pytest.mark.parametrize("pack", [gzip.compress, zst, lambda data: archive(a=data)])
def test_bombs_are_refused(tmp_path, pack, monkeypatch):
    monkeypatch.setattr("wakefold.io.source.LEAST_LIMIT", 1 << 20)
    with pytest.raises(wio.ReadError, match=r"larger max_unpacked \(--max-unpacked\)"):
        read(tmp_path, pack(CSV + b"1,1,1,1\n" * (1 << 20)))
    _, report = read(tmp_path, pack(CSV + b"1,1,1,1\n" * (1 << 18)), max_unpacked=1 << 30)
    assert report.rows == 3000 + (1 << 18)
    with pytest.raises(wio.ReadError, match="more than 10 bytes"):
        read(tmp_path, pack(CSV), max_unpacked=10)


def test_endless_lines_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("wakefold.io.source.LONGEST_LINE", 1 << 20)
    with pytest.raises(wio.ReadError, match="line 3001 is longer than 1 MiB"):
        read(tmp_path, CSV[:-1] + b"1" * (10 << 20))


def test_encrypted_and_empty_archives(tmp_path):
    packed = bytearray(archive(a=CSV))
    packed[6] |= 1
    packed[packed.index(b"PK\x01\x02") + 8] |= 1
    with pytest.raises(wio.ReadError, match="encrypted"):
        read(tmp_path, bytes(packed))
    with pytest.raises(wio.ReadError, match="nothing in it"):
        read(tmp_path, archive())


@pytest.mark.parametrize("data", [b"", b"\n\n  \n", b"\xef\xbb\xbf", gzip.compress(b"")])
def test_empty(tmp_path, data):
    with pytest.raises(wio.ReadError, match="file: the file is empty"):
        read(tmp_path, data)


@pytest.mark.parametrize(
    "data", [b"hello", b"a,b,c\n1,2,3\n", bytes(range(256)), b"<html></html>", b"PAR1 no", b"id,t,x,y\n"]
)
def test_unknown(tmp_path, data):
    with pytest.raises(wio.ReadError) as caught:
        read(tmp_path, data)
    assert "file: " in str(caught.value)


def test_blank_lines_before_a_table_cost_no_more_than_others(tmp_path):
    """A pattern that looked over line ends took 18 s; this takes .05 s. The bound holds on slow machines too."""
    begin = time.process_time()
    tracks, _ = read(tmp_path, b"\n" * 65_000 + CSV)
    assert len(tracks) == 7
    assert time.process_time() - begin < 5.0


def test_one_line_errors_of_files(tmp_path):
    with pytest.raises(wio.ReadError, match="No such file"):
        wio.read_tracks(tmp_path / "nowhere.csv")
    with pytest.raises(wio.ReadError, match="is a directory"):
        wio.read_tracks(tmp_path)
    with pytest.raises(wio.ReadError, match="no files"):
        wio.read_tracks([])
    with pytest.raises(wio.ReadError, match="no format 'csv'"):
        wio.read_tracks(tmp_path, format="csv")


def test_formats_accepted_are_named(tmp_path):
    with pytest.raises(wio.ReadError) as caught:
        read(tmp_path, b"hello")
    assert all(name in str(caught.value) for name in FORMATS.values())
    assert "\n" not in str(caught.value)


def test_formats_accepted_are_documented():
    text = (Path(__file__).parents[2] / "docs" / "reading.md").read_text()
    assert all(f"| `{key}` |" in text for key in FORMATS)


def test_names_do_not_matter(tmp_path):
    path = tmp_path / "tracks.gpx.gz.parquet"
    path.write_bytes(CSV)
    assert wio.read_tracks(path)[1].format == "CSV"


def test_format_by_force(tmp_path):
    mc = b"MMSI,BaseDateTime,LAT,LON,SOG\n1,2020-01-01T00:00:00,40,-74,10\n"
    knots, _ = read(tmp_path, mc)
    metres, _ = read(tmp_path, mc, format="table")
    assert knots.columns["sog"][0] == pytest.approx(10 * 1852 / 3600)
    assert metres.columns["sog"][0] == 10


def test_progress(tmp_path):
    seen = []
    read(tmp_path, gzip.compress(CSV), progress=lambda done, of: seen.append((done, of)))
    assert seen[-1][0] == seen[-1][1] > 0
    assert seen == sorted(seen)
