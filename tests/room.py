"""A harbour, people and fixes as files, and commands run on them: for tests of the command line."""

import shlex
import sys

from typer.testing import CliRunner

from wakefold import cli

WAKEFOLD = [sys.executable, "-m", "wakefold"]


def harbour(shift: float = 0.0) -> str:
    """Two ferry lines in a harbour, ten crossings, as CSV."""
    rows = ["agent,time,lon,lat"]
    for k in range(10):
        for i in range(21):
            lon = -74.0 + 0.002 * i + shift
            lat = 40.60 + 0.0004 * k + (0.0015 * i if k % 2 else 0.0)
            rows.append(f"ship{k},2020-12-0{1 + k % 7}T06:{i:02d}:00Z,{lon:.6f},{lat:.6f}")
    return "\n".join(rows) + "\n"


def fixes() -> str:
    """A ferry with an observed class, and a tug."""
    rows = ["agent,time,lon,lat,sd,class,level"]
    for i in range(8):
        rows.append(f"ferry,2020-12-08T06:{i:02d}:00Z,{-74.0 + 0.002 * i:.6f},40.6002,20,,")
        if i == 3:
            rows.append("ferry,2020-12-08T06:03:30Z,,,,track:ship0#0,300")
        rows.append(f"tug,2020-12-08T06:{i:02d}:00Z,{-74.0 + 0.002 * i:.6f},{40.6 + 0.0015 * i:.6f},20,,")
    return "\n".join(rows) + "\n"


def people() -> str:
    rows = ["who,t,px,py"]
    rows += [f"{k},{i},{i + 0.1 * k},{0.5 * k}" for k in range(6) for i in range(12)]
    return "\n".join(rows) + "\n"


def run(line: str, given: str | None = None) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command."""
    done = CliRunner().invoke(cli.app, shlex.split(line), input=given)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, done.stdout, done.stderr
