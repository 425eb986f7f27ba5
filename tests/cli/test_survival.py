"""A feed survives what happens to its streams, and ends with every answer whole."""

import csv
import fcntl
import io
import json
import os
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path
from typing import IO

import pytest
from room import WAKEFOLD, fixes, run

TRACK = [*WAKEFOLD, "track", "harbour.model", "-"]
BAD = "agent,time,lon,lat\n" + "".join(f"a,never,1,{k}\n" for k in range(30)) + "a,2020-12-08T06:00:00Z,-74.02,40.61\n"


@pytest.fixture(autouse=True, params=["", "1"], ids=["buffered", "unbuffered"])
def buffers(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Standard streams with Python's buffers and without, as containers often set it."""
    monkeypatch.setenv("PYTHONUNBUFFERED", request.param)


def shell(line: str, given: str) -> subprocess.CompletedProcess[str]:
    words = " ".join(f"'{word}'" for word in TRACK)
    return subprocess.run(
        ["bash", "-c", f"{words} {line}"], input=given, capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.parametrize("where", ["2>/dev/full", "2>&-", "2> >(true)"])
def test_standard_error_that_cannot_be_written(room: Path, where: str) -> None:
    done = shell(where, BAD)
    assert done.returncode == 1  # lines were refused; the good one is answered
    assert len(done.stdout.splitlines()) == 2
    assert "Traceback" not in done.stderr + done.stdout


@pytest.mark.parametrize(
    ("where", "why"),
    [
        (">/dev/full", "No space left on device"),
        (">&-", "standard output is closed"),
        ("<&-", "standard input is closed"),
    ],
)
def test_streams_that_are_closed_or_full_are_one_line(room: Path, where: str, why: str) -> None:
    done = shell(where, fixes())
    assert done.returncode == 1
    assert why in done.stderr
    assert len([line for line in done.stderr.splitlines() if "error" in line]) == 1
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


@pytest.mark.parametrize("header", ["agent,ti\rme,lon,lat", "agent,time,lon,lat\rx", "\ragent,time,lon,lat"])
def test_a_lone_carriage_return_in_a_header(room: Path, header: str) -> None:
    text = f"{header}\na,2020-12-08T06:00:00Z,-74.02,40.61\n"
    (room / "cr.csv").write_bytes(text.encode())
    for line, given in (("track harbour.model -", text), ("track harbour.model cr.csv", None), ("info cr.csv", None)):
        code, _, err = run(line, given)
        assert code in (0, 1)
        assert "Traceback" not in err


def test_names_are_escaped_in_every_output(room: Path) -> None:
    fix = {"time": "2020-12-08T06:00:00Z", "lon": -74.02, "lat": 40.61}
    names = ["a\nb", "\x1b[2J", "c\td", "\u202e"]
    lines = "".join(json.dumps({"agent": name, **fix}) + "\n" for name in names)
    lines += json.dumps({"agent": "e\x1b", "time": "no\x1bw"}) + "\n"
    for form in ("csv", "jsonl"):
        code, out, err = run(f"track harbour.model - --max-agents 1 --format {form}", lines)
        assert code == 1
        assert "\x1b" not in out + err
        assert len(out.splitlines()) == 4 + (form == "csv")
    _, out, _ = run("track harbour.model - --format csv", lines)
    assert [row[0] for row in csv.reader(io.StringIO(out))][1:] == ["a\\nb", "\\x1b[2J", "c\\td", "\\u202e"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_with_every_answer_whole(room: Path, number: signal.Signals) -> None:
    """The pipe is full and an answer half written when the signal comes."""
    with subprocess.Popen(
        TRACK,
        0,  # without buffers, of which communicate would not know
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=restored,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        rows = "".join(f"a{k % 7},{1607400000 + k},-74.02,40.61\n" for k in range(20_000))
        os.set_blocking(process.stdin.fileno(), False)
        process.stdin.write(f"agent,time,lon,lat\n{rows}".encode()[:60_000])
        first = process.stdout.readline()
        before, waiting = -1, unread(process.stdout)
        while before < waiting:
            time.sleep(0.3)
            before, waiting = waiting, unread(process.stdout)
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    assert process.returncode == (130 if number == signal.SIGINT else 143), err.decode()
    assert len(first + out) > waiting > 50_000
    lines = (first + out).decode().splitlines()
    assert {len(row) for row in csv.reader(lines)} == {len(lines[0].split(","))}
    assert f"{len(lines) - 1:,} observation" in err.decode()
    assert "Traceback" not in err.decode()


def unread(pipe: IO[bytes]) -> int:
    return int.from_bytes(fcntl.ioctl(pipe, termios.FIONREAD, bytes(4)), sys.byteorder)


def restored() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)
