"""What ``wakefold track`` does: one belief for each agent of a feed, an answer for each observation."""

from __future__ import annotations

import sys
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import numpy as np

from wakefold.cli_support import naming
from wakefold.dynamics import MAX_SUBSTEPS
from wakefold.observations import (
    Answer,
    Best,
    Observation,
    Place,
    Refused,
    csv_header,
    csv_line,
    form_of,
    is_feed,
    json_line,
    numbered_lines,
    of_tracks,
)
from wakefold.observations import read as read_feed
from wakefold.particles import LOST
from wakefold.wording import counted

if TYPE_CHECKING:
    from wakefold.belief import Belief
    from wakefold.filters.bootstrap import BL1, BL2
    from wakefold.filters.mhpf import MHPF
    from wakefold.io import Columns
    from wakefold.io.report import Report
    from wakefold.model import Model
    from wakefold.observations import Form
    from wakefold.plot import Moment

ROWS = 6  # of the picture
TOLD = 20  # refused lines that are named
BACK = 3  # lines of an agent in a row that are earlier than its belief, with rising times: its clock was set right


class Crowd:
    """The live agents of a feed and their beliefs.

    One wrong time far ahead must not silence an agent for good: it starts anew with the third line in a row that is
    earlier than its belief, if the times of the three rise.

    Args:
        filter: takes the steps.
        levels: metres, of which the likeliest classes are told.
        horizons: seconds, of the forecasts.
        max_agents: beyond that many, the agent unheard of for longest is dropped.
        max_gap: seconds of silence after which an agent starts anew.
        say: told of every agent that is dropped, and once if fixes are in the plane of a geodetic model.
    """

    def __init__(
        self,
        filter: MHPF | BL1 | BL2,
        levels: Sequence[float],
        horizons: Sequence[float],
        max_agents: int,
        max_gap: float,
        say: Callable[[str], None],
    ) -> None:
        self.filter, self.levels, self.horizons = filter, levels, horizons
        self.max_agents, self.say = max_agents, say
        self.max_gap = min(max_gap, longest_step(filter.model))
        self.live: OrderedDict[str, Belief] = OrderedDict()
        self.met: set[int] = set()  # hashes of all names: some 60 bytes of each, while live agents are bounded
        self._told_plane = False
        self._earlier: dict[str, tuple[int, float]] = {}  # of live agents: lines in a row before the belief, the last

    def __call__(self, seen: Observation) -> tuple[Answer, Belief]:
        """The belief of the agent after an observation.

        Raises:
            ValueError: the observation does not fit the model or the agent's time; its belief stays as it was.
        """
        coarse, at = seen.coarse(self.filter.model.filtration), self._at(seen)
        before = self.live.get(seen.agent)
        if before is None or before.time is None or self._anew(seen, before.time):
            after = self.filter.start(fix=seen.fix, time=seen.time, agent=seen.agent)
            event = "start" if before is None else "restart"
            if coarse:
                after = self.filter.step(after, coarse, time=seen.time)
        else:
            items = coarse if seen.fix is None else [seen.fix, *coarse]
            after = self.filter.step(before, items, time=seen.time)
            event = "recovery" if after.recoveries > before.recoveries else "step"
        if at is not None and seen.fix is not None:
            sd = self.filter.sd if seen.fix.sd is None else seen.fix.sd
            event = "off-map" if np.linalg.norm(after.mean() - at) > LOST * sd else event
        answer = self._answer(seen, event, after)
        self._keep(seen.agent, after)
        return answer, after

    def _anew(self, seen: Observation, last: float) -> bool:
        """Whether a live agent with a belief of the time ``last`` starts anew: after a long silence, or set back."""
        if seen.time >= last:
            self._earlier.pop(seen.agent, None)
            return seen.time - last > self.max_gap
        count, earlier = self._earlier.get(seen.agent, (0, seen.time))
        count = count + 1 if seen.time > earlier else 1
        self._earlier[seen.agent] = count, seen.time
        return count >= BACK

    def _at(self, seen: Observation) -> np.ndarray | None:
        """Where a fix lies in the plane of the model.

        Raises:
            ValueError: it does not fit the model; the message begins with its fields.
        """
        if seen.fix is None:
            return None
        tracks = self.filter.model.tracks
        try:
            at = seen.fix.on_plane(tracks.projection, tracks.dim)
        except ValueError as error:
            fields = ("lon", "lat") if seen.fix.position is None else ("x", "y", "z")[: len(seen.fix.position)]
            raise ValueError(f"{', '.join(fields)}: {error}") from None
        if seen.fix.position is not None and tracks.projection is not None and not self._told_plane:
            self._told_plane = True
            self.say(f"x and y of the fixes are taken as {tracks.projection}, east and north: the model's plane")
        return at

    def _keep(self, agent: str, belief: Belief) -> None:
        self.met.add(hash(agent))
        self._earlier.pop(agent, None)
        self.live[agent] = belief
        self.live.move_to_end(agent)
        if len(self.live) > self.max_agents:
            oldest, _ = self.live.popitem(last=False)
            self._earlier.pop(oldest, None)
            self.say(f"agent {oldest} dropped: over {self.max_agents:,} live agents (--max-agents)")

    def _answer(self, seen: Observation, event: str, belief: Belief) -> Answer:
        levels = []
        for level in self.levels:
            best = next(iter(belief.level(level)))
            levels.append(Best(level, best.class_, best.probability, best.size))
        ahead: list[tuple[float, Place]] = []
        if self.horizons:
            later = self.filter.forecast(belief, self.horizons)
            ahead = [(h, self._place(b)) for h, b in zip(self.horizons, later, strict=True)]
        place = self._place(belief)
        return Answer(seen.agent, seen.stamp, event, place, belief.ess, belief.recoveries, levels, ahead)

    @property
    def place_names(self) -> tuple[str, ...]:
        """What positions are given in."""
        tracks = self.filter.model.tracks
        return ("lon", "lat") if tracks.projection is not None else ("x", "y", "z")[: tracks.dim]

    def _place(self, belief: Belief) -> Place:
        mean, projection = belief.mean(), self.filter.model.tracks.projection
        sd = float(np.sqrt(np.trace(belief.cov()) / len(mean)))
        at = mean if projection is None else projection.to_geodetic(mean)[0]
        return Place(self.place_names, tuple(at.tolist()), sd)


class Album:
    """A handful of moments of the first agent followed, evenly over its steps however many come, for a picture."""

    def __init__(self, levels: Sequence[float]) -> None:
        self.levels = levels
        self.agent: str | None = None
        self._kept: list[tuple[Moment, int]] = []
        self._fixes: list[np.ndarray] = []
        self._steps, self._stride = 0, 1

    def add(self, seen: Observation, belief: Belief, crowd: Crowd) -> None:
        """Keep the moment if its turn has come."""
        from wakefold.plot import Moment

        self.agent = seen.agent if self.agent is None else self.agent
        if seen.agent != self.agent:
            return
        tracks = crowd.filter.model.tracks
        if seen.fix is not None and len(self._fixes) < 10_000:
            self._fixes.append(seen.fix.on_plane(tracks.projection, tracks.dim)[:2])
        if self._steps % self._stride == 0:
            tables = {b: (t.classes, t.probability) for b in self.levels for t in [belief.level(b)]}
            self._kept.append((Moment(seen.time, tables, estimate=belief.mean()[:2]), len(self._fixes)))
            if len(self._kept) > 2 * ROWS:
                self._kept, self._stride = self._kept[::2], 2 * self._stride
        self._steps += 1

    def moments(self) -> list[Moment]:
        """At most ``ROWS``, the first and the last among them."""
        fixes = np.reshape(self._fixes, (-1, 2))
        rows = np.unique(np.linspace(0, len(self._kept) - 1, ROWS).round().astype(int)) if self._kept else []
        return [self._kept[r][0]._replace(observed=fixes[: self._kept[r][1]]) for r in rows]


def longest_step(model: Model) -> float:
    """Seconds that a belief can be taken ahead at once."""
    return MAX_SUBSTEPS * model.dynamics.interval


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
        given, feed = form_of(first[1]), read_feed(chain([first], lines), columns, time_format)
    else:
        given, feed, report = feed_of(Path(observations), columns, time_format, progress)
        if report is not None:
            say(str(report))
    form = form or given
    answered = refused = 0
    met: set[str] = set()
    with _opened(output) as out:
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
            say(f"{counted(answered, 'observation')} of {counted(len(crowd.met), 'agent')} answered{tail}")
    if not answered and not refused:
        raise ReadError(f"{observations}: no observation" + (f" of {_named(agents)}" if agents else ""))
    if absent := agents - met:
        say(f"no observation of {_named(absent)}")
    return refused


def _named(agents: frozenset[str]) -> str:
    return "agent " + ", ".join(sorted(agents))


@contextmanager
def _opened(output: str) -> Iterator[TextIO]:
    """The file of the answers; "-" is standard output, which stays open."""
    if output == "-":
        yield sys.stdout
        return
    with naming(output), Path(output).open("w", encoding="utf-8", errors="backslashreplace") as out:
        yield out


def draw(album: Album, model: Model, path: Path) -> None:
    """The picture of the moments collected.

    Raises:
        ValueError: there are none.
    """
    from wakefold import plot

    plot.save(plot.beliefs(model.tracks, model.filtration, album.moments()), path)


def feed_of(
    path: Path, columns: Columns | None, time_format: str | None, progress: Callable[[int, int], None]
) -> tuple[Form, Iterator[Observation | Refused], Report | None]:
    """What a file observes: CSV or JSON lines as they stand, any other format by way of ``read_tracks``.

    Returns:
        the form of the file ("csv" for anything else), its observations, the report of ``read_tracks``.

    Raises:
        ReadError: neither observations nor tracks.
    """
    from wakefold.io import ReadError, read_tracks
    from wakefold.io.sniff import sniff
    from wakefold.io.source import open_sources

    def feed() -> Iterator[Observation | Refused]:
        for source in open_sources(path, progress=progress):
            yield from read_feed(source.lines(), columns, time_format)

    source = next(iter(open_sources(path)))
    first = next((line for line in source.head.split(b"\n") if line.strip()), b"")
    try:
        ais = sniff(source, columns) in ("marinecadastre", "dma")  # they have sentinels and rules of their own
    except ReadError:
        ais = False
    if is_feed(first, columns) and not ais:
        return form_of(first), feed(), None
    tracks, report = read_tracks(path, columns=columns, time_format=time_format, progress=progress)
    return "csv", of_tracks(tracks), report
