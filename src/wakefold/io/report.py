"""What a reader did with every row: kept, or rejected and why, with the first offending lines."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, NamedTuple

from wakefold.base.wording import counted, escaped

SHOWN = 5
"""Offending lines kept for each reason."""
NAMED = 20
"""Columns that a message names."""
CLIP = 160
"""Characters kept of an offending line."""


class ReadError(ValueError):
    """A file that cannot be read: the message is one line, or one line and the first offending lines."""


class Offence(NamedTuple):
    """One rejected row: its file, its line (or row) number from 1 and its text, clipped.

    Rows that are rejected for what they are beside other rows (duplicate, same time, jump) are shown by their
    values, since their lines are long gone by then.
    """

    file: str
    line: int
    text: str


@dataclass(frozen=True)
class Report:
    """What was read. ``rows == kept + sum(rejected.values())``, always.

    Attributes:
        format: name of the format that was recognised.
        files: the files read, members of archives as ``archive.zip/member.csv``.
        rows: position records read; headers, blank lines and messages without a position are not rows.
        kept: rows that became points of tracks.
        rejected: rows left out, by reason.
        offences: the first five rejected rows of each reason.
        notes: whatever else a careful reader should know.
        untimed: points of files without times, which were taken one second apart.
    """

    format: str
    files: tuple[str, ...]
    rows: int
    kept: int
    rejected: dict[str, int]
    offences: dict[str, tuple[Offence, ...]]
    notes: tuple[str, ...] = ()
    untimed: int = 0

    def __str__(self) -> str:
        files = self.files[0] if len(self.files) == 1 else f"{len(self.files)} files"
        lines = [f"{files}: {self.format}, {counted(self.rows, 'row')} read, {self.kept:,} kept"]
        for reason, count in sorted(self.rejected.items(), key=lambda item: -item[1]):
            lines.append(f"  {count:,} rejected: {reason}")
            lines += [f"    {o.file}:{o.line}: {o.text}" for o in self.offences.get(reason, ())]
        return "\n".join(lines + [f"  note: {note}" for note in self.notes])

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(reason)}</td><td>{count:,}</td><td><code>"
            + "<br>".join(escape(f"{o.file}:{o.line}: {o.text}") for o in self.offences.get(reason, ()))
            + "</code></td></tr>"
            for reason, count in self.rejected.items()
        )
        head = escape(str(self).splitlines()[0])
        notes = "".join(f"<li>{escape(note)}</li>" for note in self.notes)
        table = f"<table><tr><th>rejected</th><th>rows</th><th>first</th></tr>{rows}</table>" if rows else ""
        return f"<p>{head}</p>{table}<ul>{notes}</ul>"

    def to_dict(self) -> dict[str, Any]:
        """Plain types, ready for JSON."""
        return {
            "format": self.format,
            "files": list(self.files),
            "rows": self.rows,
            "kept": self.kept,
            "rejected": dict(self.rejected),
            "offences": {reason: [o._asdict() for o in some] for reason, some in self.offences.items()},
            "notes": list(self.notes),
            "untimed": self.untimed,
        }


class Tally:
    """Counts kept while reading; ``report`` makes the ``Report`` of them."""

    def __init__(self) -> None:
        self.format = ""
        self.files: list[str] = []
        self.rows = 0
        self.rejected: Counter[str] = Counter()
        self.offences: dict[str, list[Offence]] = {}
        self.counted_notes: Counter[str] = Counter()
        self.others: dict[str, None] = {}
        self.untimed = 0

    def wants(self, reason: str) -> int:
        """How many more offending rows of this reason will be shown."""
        return SHOWN - len(self.offences.get(reason, ()))

    def reject(self, reason: str, count: int, first: Iterable[tuple[int, str]], file: str | None = None) -> None:
        """Count rejected rows; ``first`` gives line number and text of the first ones (the rest is not looked at)."""
        if count:
            self.rejected[reason] += count
            shown = self.offences.setdefault(reason, [])
            for _, (line, text) in zip(range(SHOWN - len(shown)), first, strict=False):  # no text is made in vain
                shown.append(Offence(file or self.files[-1], line, _clip(text)))

    def note(self, text: str, count: int = 1) -> None:
        """A remark; ``{n}`` in it becomes the sum of the counts given with it."""
        if count:
            self.counted_notes[text] += count

    def decided(self, notes: Iterable[str], others: Iterable[str] = ()) -> None:
        """What a reader took the columns of a file for, and the names of those that it took nothing from."""
        for note in notes:
            self.note(escaped(note).replace("{", "{{").replace("}", "}}"))
        self.others |= dict.fromkeys(others)

    def report(self, format: str, kept: int) -> Report:
        return Report(
            format=format,
            files=tuple(self.files),
            rows=self.rows,
            kept=kept,
            rejected=dict(self.rejected),
            offences={reason: tuple(some) for reason, some in self.offences.items()},
            notes=tuple(text.format(n=f"{count:,}") for text, count in self.counted_notes.items()),
            untimed=self.untimed,
        )

    def refusal(self, format: str) -> ReadError:
        """The error for files in which not one row was good."""
        return ReadError(f"no usable positions\n{self.report(format, 0)}")


def _clip(text: str) -> str:
    text = escaped(text[: CLIP + 1])
    return text if len(text) <= CLIP else text[: CLIP - 1] + "…"


def listed(names: Sequence[str]) -> str:
    """``a, b and c``."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def some(names: Sequence[str]) -> str:
    """``a, b and c`` of the first names, each clipped."""
    shown = [name if len(name) <= 40 else f"{name[:39]}…" for name in names[:NAMED]]
    return listed(shown) if len(names) <= NAMED else f"{', '.join(shown)} and {len(names) - NAMED:,} more"
