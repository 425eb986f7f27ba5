"""Numbers for people: lengths, durations and counts, without exponents."""

from __future__ import annotations

import re
from collections.abc import Iterable

_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def number_text(value: float, digits: int = 3) -> str:
    """So many digits, or the whole number where that takes more of them: "0.25", "12.3", "1,810"."""
    text = f"{value:,.{digits}g}"
    return f"{value:,.0f}" if "e+" in text and abs(value) < 1e15 else text


def length_text(metres: float) -> str:
    """ "250 m", "12.3 km"."""
    return f"{number_text(metres / 1000)} km" if metres >= 1000 else f"{number_text(metres)} m"


def duration_text(seconds: float) -> str:
    """ "45 s", "2.5 min", "1,440 min"."""
    if seconds < 60:
        return f"{number_text(seconds)} s"
    return f"{seconds / 60:.2g} min" if seconds < 600 else f"{seconds / 60:,.0f} min"


def counted(count: int, noun: str) -> str:
    """ "1 track", "2,000 tracks"."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def escaped(text: str) -> str:
    """A text from a file as it may be shown anywhere: tabs, line ends, escape codes and what turns the direction of
    writing as ``\\t``, ``\\n``, ``\\x1b``, ``\\u202e``."""
    return _CONTROL.sub(lambda match: match[0].encode("unicode_escape", "surrogatepass").decode(), text)


def near_miss(name: str, names: Iterable[str]) -> str:
    """ "; did you mean 'ferry0#0'?": names that are pieces of this one, or written much like it; "" without any."""
    from difflib import get_close_matches

    every = list(names)
    close = [other for other in every if other.startswith(f"{name}#")][:3] or get_close_matches(name, every, 3)
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else ""
