"""What ``wakefold track`` does: one belief for each agent of a feed, an answer for each observation."""

from __future__ import annotations

import sys
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from wakefold.base.files import opened
from wakefold.base.wording import counted
from wakefold.service.album import Album
from wakefold.service.answers import csv_header, csv_line, json_line
from wakefold.service.feed import Refused, feed_of, form_of, numbered_lines, read
from wakefold.service.fleet import Crowd

if TYPE_CHECKING:
    from wakefold.io.read import Columns
    from wakefold.service.feed import Form

TOLD = 20  # refused lines that are named


def run(
    crowd: Crowd,
    observations: str,
    output: str,
    form: Form | None,
    columns: Columns | None,
    time_format: str | None,
    agents: frozenset[str],
    album: Album | None,
    progress: Callable[..., None],
    say: Callable[[str], None],
) -> int:
    """Answer every observation of a file (or "-") in a file (or "-"), each line as soon as it can be written.

    Args:
        form: of the answers; that of the observations without.
        agents: follow these only; all if empty.
        album: collects moments for a picture.

    Returns:
        how many lines were refused; each of the first was said.

    Raises:
        ReadError: no observations at all, or none of these agents.
    """
    from wakefold.io import ReadError

    if observations == "-":
        lines = numbered_lines(sys.stdin.buffer)
        first = next(lines, (1, b""))
        given, feed = form_of(first[1]), read(chain([first], lines), columns, time_format)
    else:
        given, feed, report = feed_of(Path(observations), columns, time_format, progress)
        if report is not None:
            say(str(report))
    form = form or given
    answered = refused = 0
    met: set[str] = set()
    with opened(output) as out:
        if form == "csv":
            out.write(csv_header(crowd.place_names, crowd.levels, crowd.horizons))
            out.flush()
        line_of = csv_line if form == "csv" else json_line
        try:
            for seen in feed:
                if not isinstance(seen, Refused):
                    if agents and seen.agent not in agents:
                        continue
                    if agents:
                        met.add(seen.agent)
                    try:
                        answer, belief = crowd(seen)
                    except ValueError as error:
                        seen = Refused(seen.line, str(error))
                    else:
                        answered += 1
                        out.write(line_of(answer))
                        out.flush()
                        if album is not None:
                            album.add(seen, belief, crowd)
                        continue
                refused += 1
                if refused <= TOLD:
                    say(f"line {seen.line} refused: {seen.why}")
                elif refused == TOLD + 1:
                    say("more lines refused, from here on only counted")
        finally:
            tail = f", {counted(refused, 'line')} refused" if refused else ""
            say(f"{counted(answered, 'observation')} of {counted(crowd.met, 'agent')} answered{tail}")
    if not answered and not refused:
        raise ReadError(f"{observations}: no observation" + (f" of {_named(agents)}" if agents else ""))
    if absent := agents - met:
        say(f"no observation of {_named(absent)}")
    return refused


def _named(agents: frozenset[str]) -> str:
    return "agent " + ", ".join(sorted(agents))
