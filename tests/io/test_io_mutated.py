"""A fuzzer over all readers: sample files mutated at random are read, or refused by ``ReadError``, within seconds.

2,000 files, or as many as ``WAKEFOLD_FUZZ`` says (``make fuzz``: 20,000), from the seed ``WAKEFOLD_SEED``.
"""

from __future__ import annotations

import gzip
import os
import random
import signal
import sys
import types

import pytest
from test_io_fuzz import SAMPLES, check

FILES = int(os.environ.get("WAKEFOLD_FUZZ", "2000"))
SEED = int(os.environ.get("WAKEFOLD_SEED", "0"))
PARTS = 20
PATIENCE = 5  # seconds for a file
ODD = [
    b"", b"0", b"-1", b"1e308", b"-1e999", b"NaN", b"inf", b"9" * 400, b"181", b"91", b"63", b"\0", b"\r", b"\n",
    b"\r\n", b'"', b'""', b",", b";", b"\t", b"#", b"{", b"}", b"[", b"]", b"<", b">", b"</", b"&a;", b"\xff\xfe",
    b"\xef\xbb\xbf", b"null", b"true", b"2024-13-45T99:99:99Z", b"1/2/3", b"10:15:30", b"44197.500694444",
    b"20240501", b"POINT(1 2)", b"sep=;\n", b"track", b"id", b"time", b"timestamp", b"mmsi", b"+", b"%", b"\x1b[2J",
    b"\xc2\xb0N", b"class", b"\0\0",
]  # fmt: skip
OPTIONS = [
    {}, {}, {}, {"time_format": "ms"}, {"time_format": "days"}, {"time_format": "%d/%m/%Y %H:%M"}, {"max_speed": 1e-3},
    {"columns": {"agent": "id"}}, {"columns": {"time": "id+time"}}, {"columns": {"agent": 0, "x": 1, "y": 2}},
    {"max_unpacked": 100}, {"format": "table"}, {"format": "nmea"},
]  # fmt: skip


def mutated(rng: random.Random) -> bytes:
    """A sample, spoilt a few times; with a piece of another, at times."""
    data = bytearray(rng.choice(list(SAMPLES.values())))
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(len(data) + 1)
        to = min(len(data), at + rng.choice([1, 1, 2, 5, 20, 200]))
        match rng.randrange(9):
            case 0:
                data[at:at] = rng.choice(ODD) * rng.choice([1, 1, 1, 3, 50])
            case 1:
                data[at:to] = rng.choice(ODD)
            case 2:
                del data[at:to]
            case 3:
                data[at:at] = data[at:to] * rng.choice([1, 2, 30])
            case 4:
                for k in range(at, to):
                    data[k] ^= 1 << rng.randrange(8)
            case 5:
                del data[at:]
            case 6:
                other = rng.choice(list(SAMPLES.values()))
                begin = rng.randrange(len(other))
                data[at:at] = other[begin : begin + rng.choice([10, 100, 1000])]
            case 7:
                lines = bytes(data).split(b"\n")
                rng.shuffle(lines)
                data = bytearray(b"\n".join(lines))
            case _:
                old, new = (rng.choice(ODD[1:]) for _ in range(2))
                data = data.replace(old, new)
    out, kind = bytes(data), rng.random()
    if kind < 0.05:
        return gzip.compress(out, 1)
    return out.decode("latin-1").encode("utf-16") if kind < 0.08 else out


def late(number: int, frame: types.FrameType | None) -> None:
    raise AssertionError(f"not read within {PATIENCE} s")


@pytest.mark.skipif(sys.platform == "win32", reason="has no alarms")
@pytest.mark.parametrize("part", range(PARTS))
def test_mutated_samples(tmp_path, part):
    before = signal.signal(signal.SIGALRM, late)
    try:
        for k in range(part, FILES, PARTS):
            rng = random.Random(f"{SEED} {k}")
            data, options = mutated(rng), rng.choice(OPTIONS)
            signal.alarm(PATIENCE)
            try:
                check(tmp_path, data, **options)
            except Exception as error:
                (tmp_path / "culprit").write_bytes(data)
                raise AssertionError(f"file {k} of seed {SEED}, {options}: kept as {tmp_path / 'culprit'}") from error
            finally:
                signal.alarm(0)
    finally:
        signal.signal(signal.SIGALRM, before)
