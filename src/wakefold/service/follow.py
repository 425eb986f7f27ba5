"""What ``wakefold track`` does: one belief for each agent of a feed, an answer for each observation."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from io import BufferedIOBase
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from wakefold.base.files import opened
from wakefold.base.signals import held
from wakefold.base.wording import counted
from wakefold.service.agents import Crowd
from wakefold.service.album import Album
from wakefold.service.answers import csv_header, csv_line, json_line
from wakefold.service.feed import Refused, blocks_of, form_of, read
from wakefold.service.observed import feed_of

if TYPE_CHECKING:
    from wakefold.service.feed import Form

_TROUBLE = re.compile(r"[a-z, ]+")  # what is wrong with a line, before all that is its own


def run(
    crowd: Crowd,
    observations: str,
    output: str,
    form: Form | None,
    reading: Mapping[str, Any],
    agents: frozenset[str],
    album: Album | None,
    progress: Callable[..., None],
    say: Callable[[str], None],
) -> int:
    """Answer every observation of a file (or "-") in a file (or "-"), in order, as soon as they can be written.

    Args:
        form: of the answers; that of the observations without.
        reading: ``columns``, ``time_format`` and what else ``read_tracks`` takes.
        agents: follow these only; all if empty.
        album: collects moments for a picture.

    Returns:
        how many lines were refused; the remarks of the crowd told of them.

    Raises:
        ReadError: no observations at all, or none of these agents.
    """
    from wakefold.io import ReadError

    if observations == "-":
        if sys.stdin is None:
            raise ReadError("standard input is closed")
        if "max_speed" in reading:
            raise ReadError("--max-speed does not apply to standard input, which is taken line by line")
        blocks = blocks_of(cast(BufferedIOBase, sys.stdin.buffer))
        first = next(blocks, [])
        given = form_of(next((line for _, line in first if line.strip()), b""))
        feed = read(chain([first], blocks), reading["columns"], reading["time_format"])
    else:
        given, feed, notes = feed_of(Path(observations), reading, progress)
        for note in notes:
            say(note)
    form = form or given
    answered = refused = 0
    met: set[str] = set()
    with opened(output) as out:
        if form == "csv":
            out.write(csv_header(crowd.place_names, crowd.levels, crowd.horizons, crowd.doubting))
            out.flush()
        line_of = csv_line if form == "csv" else json_line
        try:
            for block in feed:
                wanted = [seen for seen in block if not agents or isinstance(seen, Refused) or seen.agent in agents]
                if agents:
                    met.update(seen.agent for seen in wanted if not isinstance(seen, Refused))
                for part in crowd(wanted):
                    lines = []
                    for one in part:
                        if isinstance(one, Refused):
                            refused += 1
                            trouble = _TROUBLE.match(one.why)
                            kind = trouble[0].strip(", ") if trouble else "other"
                            crowd.remarks(f"lines refused ({kind})", f"line {one.line} refused: {one.why}")
                            continue
                        if one.seen.note is not None:
                            crowd.remarks.once("notes", f"line {one.seen.line}: {one.seen.note}")
                        lines.append(line_of(one.answer))
                        if album is not None:
                            album.add(one.seen, one.belief, crowd)
                    with held():
                        out.write("".join(lines))
                        out.flush()
                        answered += len(lines)
        finally:
            tail = f", {counted(refused, 'line')} refused" if refused else ""
            crowd.remarks.totals()
            say(f"{counted(answered, 'observation')} of {counted(crowd.met, 'agent')} answered{tail}")
    if not answered and not refused:
        raise ReadError(f"{observations}: no observation" + (f" of {_named(agents)}" if agents else ""))
    if absent := agents - met:
        say(f"no observation of {_named(absent)}")
    return refused


def _named(agents: frozenset[str]) -> str:
    return "agent " + ", ".join(sorted(agents))
