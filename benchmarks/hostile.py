"""Files made to cost much: time beside a good file of the size, and memory beside what a packed file may unpack to.

``python -m benchmarks.hostile`` reads each in a process of its own and ends with 1 if one is over a limit:

- CPU time at most ``TIMES`` that of a good table of as many (unpacked) bytes, for which ``SLACK`` seconds are taken at
  least, since a short file is read in less than the clock tells apart;
- memory at most ``ROOM`` and ``FACTOR`` times the bytes that the file may unpack to.
"""

from __future__ import annotations

import argparse
import gzip
import io
import json
import os
import resource
import struct
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

MB = 1 << 20
TIMES, SLACK = 5.0, 0.3
ROOM, FACTOR = 64 * MB, 4

HEADER = b"id,time,lon,lat,name\n"
ROW = b"%d,%d,10.%05d,55.12345,AEGIR\n"
DAMAGED = b'{"type":"Feature","properties":{"id":1},"geometry":{"type":"LineString","coordinates":[[1,2],[![1,2]]}}\n'


class Case(NamedTuple):
    """A file: its bytes for an unpacked size, and a good one of its kind."""

    make: Callable[[int], bytes]
    good: Callable[[int], bytes]


def table(size: int) -> bytes:
    """A good table of about so many bytes."""
    return HEADER + b"".join(ROW % (k % 50, 1_700_000_000 + k, k % 100_000) for k in range(size // 42))


def short_table(size: int) -> bytes:
    """A good table of short rows."""
    return b"id,t,x,y\n" + b"".join(b"%d,%d,1,1\n" % (k % 50, k) for k in range(size // 14))


def filled(piece: bytes, size: int) -> bytes:
    return piece * (size // len(piece))


def moment(k: int) -> bytes:
    return b"2024-05-%02dT%02d:%02d:%02dZ" % (k // 86_400 % 28 + 1, k // 3600 % 24, k // 60 % 60, k % 60)


def good_gpx(size: int) -> bytes:
    point = b'<trkpt lat="55.12345" lon="10.%05d"><time>%s</time></trkpt>'
    return (
        b"<gpx><trk><trkseg>" + b"".join(point % (k, moment(k)) for k in range(size // 74)) + b"</trkseg></trk></gpx>"
    )


def good_kml(size: int) -> bytes:
    point = b"<when>%s</when><gx:coord>10.%05d 55.12345 0</gx:coord>"
    points = b"".join(point % (moment(k), k) for k in range(size // 83))
    return b'<kml xmlns:gx="g"><Placemark><gx:Track>' + points + b"</gx:Track></Placemark></kml>"


def good_geojson(size: int) -> bytes:
    places = ", ".join(f"[10.{k:05d}, 55.12345]" for k in range(100))
    line = '{"type":"Feature","properties":{"id":%d,"times":%s},"geometry":{"type":"LineString","coordinates":[%s]}}\n'
    return b"".join((line % (k, list(range(100)), places)).encode() for k in range(size // 2600))


def good_parquet(size: int) -> bytes:
    """As many bytes when it is read."""
    return parquet(size, equal=False)


def packed(
    piece: bytes,
    good: Callable[[int], bytes],
    before: bytes = b"<gpx><trk><trkseg>",
    after: bytes = b"</trkseg></trk></gpx>",
) -> Case:
    return Case(lambda size: gzip.compress(before + filled(piece, size) + after, 1), good)


def parquet(size: int, equal: bool = True) -> bytes:
    """Rows of four columns of ``size`` bytes in all; equal ones take no room in the file."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    n = size // 32
    names = pa.DictionaryArray.from_arrays(np.zeros(n, dtype=np.int8), ["a"])
    sink = io.BytesIO()
    time, place = (np.zeros(n), np.zeros(n)) if equal else (np.arange(n) * 1.0, np.random.default_rng(0).random(n))
    pq.write_table(pa.table({"id": names, "t": time, "x": place, "y": place}), sink)
    return sink.getvalue()


def long_text(size: int) -> bytes:
    """One text of a megabyte for every row of a Parquet file."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    n = size // 16
    names = pa.DictionaryArray.from_arrays(np.zeros(n, dtype=np.int8), ["a" * MB])
    sink = io.BytesIO()
    pq.write_table(pa.table({"id": names, "t": np.arange(n) * 1.0, "x": np.zeros(n), "y": np.zeros(n)}), sink)
    return sink.getvalue()


def twins(size: int) -> bytes:
    """An archive with two members of one name."""
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("a.csv", table(size // 2))
        file.infolist()[0].filename = "b.csv"
        file.NameToInfo.clear()
        file.writestr("a.csv", table(size // 2))
        file.infolist()[0].filename = "a.csv"
    return sink.getvalue()


def forged(size: int) -> bytes:
    """A GeoPackage whose first table claims more lines than it holds."""
    import sqlite3

    base = sqlite3.connect(":memory:")
    base.executescript(
        """CREATE TABLE gpkg_contents (table_name TEXT, data_type TEXT);
        CREATE TABLE gpkg_geometry_columns (table_name TEXT, column_name TEXT, srs_id INTEGER);
        CREATE TABLE gpkg_spatial_ref_sys (srs_id INTEGER, organization TEXT, organization_coordsys_id INTEGER);
        INSERT INTO gpkg_geometry_columns VALUES ('fixes', 'geom', 4326);
        CREATE TABLE fixes (fid INTEGER PRIMARY KEY, geom BLOB, id TEXT);"""
    )
    blob = b"GP\0\1" + struct.pack("<I", 4326) + struct.pack("<BII", 1, 5, 1 << 31) + bytes(100)
    base.executemany("INSERT INTO fixes VALUES (?, ?, 'a')", ((k, blob) for k in range(size // 200)))
    base.commit()
    return base.serialize()


CASES = {
    "blank lines before a table": Case(lambda size: b"\n" * min(size, 65_000) + table(size), table),
    "blank lines behind it, packed": Case(lambda size: gzip.compress(table(1000) + b"\n" * size, 1), table),
    "damaged GeoJSON lines": Case(lambda size: b'{"features":[\n' + filled(DAMAGED, size), good_geojson),
    "unclosed GeoJSON lines": Case(lambda size: filled(b'{"a":[1,2,3,"' + b"x" * 80 + b'",\n', size), good_geojson),
    "GeoJSON lines in one another": Case(lambda size: filled(b'{"a":[\n', size), good_geojson),
    "one GeoJSON line of many positions, packed": Case(
        lambda size: gzip.compress(b'{"type":"LineString","coordinates":[[1,2]' + filled(b",[1,2]", size) + b"]}", 1),
        good_geojson,
    ),
    "Parquet of equal rows": Case(parquet, good_parquet),
    "Parquet of one long text": Case(long_text, good_parquet),
    "GPX of points, packed": packed(b'<trkpt lat="1" lon="2"/>', good_gpx),
    "GPX of waypoints, packed": packed(b'<wpt lat="1" lon="2"/>', good_gpx, b"<gpx>", b"</gpx>"),
    "GPX in one another, packed": packed(b"<a>", good_gpx),
    "GPX of parts of one point, packed": packed(b"<a/>", good_gpx, b'<gpx><trk><trkseg><trkpt lat="1" lon="2">'),
    "KML of one line, packed": packed(
        b"1,2 ",
        good_kml,
        b"<kml><Placemark><LineString><coordinates>",
        b"</coordinates></LineString></Placemark></kml>",
    ),
    "a quoted field": Case(lambda size: HEADER + b'1,,1,2,"' + filled(b"x", size) + b'"\n', table),
    "a field of quotes": Case(lambda size: HEADER + b'1,,1,2,"' + filled(b'""', size) + b'"\n', table),
    "an open quote": Case(lambda size: HEADER + b'1,,1,2,"' + filled(b"x", size), table),
    "a line of commas": Case(lambda size: HEADER + filled(b",", size), table),
    "a header of many columns": Case(lambda size: filled(b"column,", size) + b"\n1\n", table),
    "short rows, packed": Case(lambda size: gzip.compress(b"id,t,x,y\n" + filled(b"1,1,1,1\n", size), 1), short_table),
    "a name for each row, packed": Case(
        lambda size: gzip.compress(b"id,t,x,y\n" + b"".join(b"%d,1,1,1\n" % k for k in range(size // 12)), 1),
        short_table,
    ),
    "numbers behind an AIS sentence": Case(
        lambda size: b"!AIVDM,1,1,,A,1>pf7hOP1TJv<C0HOHP3Q2miP000,0*42," + filled(b"1325394060,", size), table
    ),
    "a trajectory of many cells, packed": Case(
        lambda size: gzip.compress(
            b"*T*,u,terrestrial,%d,0,*P*,terrestrial,2,1,1,0" % (size // 10) + filled(b",7,1,1,2", size), 1
        ),
        table,
    ),
    "two members of one name": Case(twins, table),
    "a GeoPackage of lines that claim much": Case(forged, table),
    "zeros, packed": Case(lambda size: gzip.compress(bytes(size), 1), table),
}


class Cost(NamedTuple):
    """What a file cost: CPU seconds, bytes of memory above those before, and what came of it."""

    seconds: float
    memory: int
    outcome: str


def cost(data: bytes) -> Cost:
    """Read a file in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder) / "file", Path(folder) / "cost"
        path.write_bytes(data)
        child = os.fork()
        if child == 0:
            try:
                out.write_text(json.dumps(_read(path)))
            finally:
                os._exit(0)
        os.waitpid(child, 0)
        return Cost(*json.loads(out.read_text()))


def _read(path: Path) -> Cost:
    import wakefold.io as wio

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.process_time()
    try:
        report = wio.read_tracks(path)[1]
        outcome = f"{report.kept:,} of {report.rows:,} rows"
    except wio.ReadError as error:
        outcome = str(error).splitlines()[0].removeprefix(f"{path.name}: ")[:60]
    seconds = time.process_time() - begin
    return Cost(seconds, 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before), outcome)


def warm() -> None:
    """Import and compile what all need, so that no case pays for it."""
    import numpy as np

    import wakefold.io as wio
    from wakefold.io import kernels

    with tempfile.TemporaryDirectory() as folder:
        for name, data in (("a.csv", table(5000)), ("b", parquet(320))):
            (Path(folder) / name).write_bytes(data)
            wio.read_tracks(Path(folder) / name)
    kernels.strands(np.arange(2.0), np.zeros((2, 3)), np.array([0, 2]), 1.0, 1.0, np.zeros(2, dtype=np.int64))


def limits(case: Case, size: int, data: bytes) -> tuple[float, int]:
    """CPU seconds, and bytes of memory, that a file of so many unpacked bytes may cost."""
    from wakefold.io.source import GREATEST_RATIO, LEAST_LIMIT

    packed = len(data) if 2 * len(data) < size else 0
    allowed = max(LEAST_LIMIT, size, GREATEST_RATIO * packed)
    return TIMES * max(cost(case.good(size)).seconds, SLACK), ROOM + FACTOR * allowed


def main(quick: bool = False, size: int = 64 * MB, only: str = "") -> int:
    """Print the table; ``quick`` makes files of 2 MB. How many are over a limit."""
    size = 2 * MB if quick else size
    warm()
    over = 0
    print(f"| file of {size / MB:.0f} MiB | CPU s | at most | memory MiB | at most | what comes of it |")
    print("|---|---|---|---|---|---|")
    for name, case in ((name, case) for name, case in CASES.items() if only in name):
        data = case.make(size)
        (seconds, memory), found = limits(case, size, data), cost(data)
        bad = found.seconds > seconds or found.memory > memory
        over += bad
        print(
            f"| {name} | {found.seconds:.2f} | {seconds:.2f} | {found.memory / MB:.0f} | {memory / MB:.0f} "
            f"| {found.outcome}{' **over**' if bad else ''} |",
            flush=True,
        )
    return over


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--size", type=int, default=64 * MB, help="bytes, unpacked")
    parser.add_argument("--only", default="", help="cases whose names hold this")
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    sys.exit(1 if main(arguments.quick, arguments.size, arguments.only) else 0)
