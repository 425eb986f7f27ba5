"""The answers to observations, as lines of CSV or JSON."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple


class Place(NamedTuple):
    """An estimated position: ``names`` say of what (lon and lat, or x, y, z); sd per axis, metres."""

    names: tuple[str, ...]
    values: tuple[float, ...]
    sd: float


class Best(NamedTuple):
    """The likeliest class of a level."""

    level: float
    class_: int
    probability: float
    tracks: int


class Answer(NamedTuple):
    """What is believed of an agent after an observation.

    Attributes:
        event: "start" of an agent, "step", "recovery" (lost, started anew from the fix) or "restart" after a long
            silence or where times went back; instead of each "off-map" if the estimate lies more than 6 sd from the fix
            all the same.
        ahead: (seconds, place) of each forecast.
    """

    agent: str
    stamp: str | float
    event: str
    place: Place
    ess: float
    recoveries: int
    levels: Sequence[Best]
    ahead: Sequence[tuple[float, Place]]


def csv_header(place: Sequence[str], levels: Sequence[float], ahead: Sequence[float]) -> str:
    """The header over ``csv_line`` of answers with these levels (metres) and forecasts (seconds)."""
    names = ["agent", "time", "event", *place, "sd", "ess", "recoveries"]
    for level in _distinct(levels):
        names += [f"class@{level}", f"probability@{level}", f"tracks@{level}"]
    for seconds in _distinct(ahead):
        names += [f"{name}+{seconds}s" for name in (*place, "sd")]
    return _csv(names)


def _distinct(values: Sequence[float]) -> list[str]:
    """Different numbers as different texts: of six digits, or as many as that takes."""
    texts = ([f"{value:.{digits}g}" for value in values] for digits in range(6, 18))
    return next(names for names in texts if len(set(names)) == len(set(values)))


def csv_line(answer: Answer) -> str:
    """One line, with its end."""
    cells = [answer.agent, answer.stamp, answer.event, *_place(answer.place).values()]
    cells += [f"{answer.ess:.1f}", answer.recoveries]
    for best in answer.levels:
        cells += [best.class_, f"{best.probability:.6f}", best.tracks]
    for _, place in answer.ahead:
        cells += _place(place).values()
    return _csv(cells)


def json_line(answer: Answer) -> str:
    """One line, with its end."""
    row = {
        "agent": answer.agent,
        "time": answer.stamp,
        "event": answer.event,
        "estimate": _place(answer.place),
        "ess": round(answer.ess, 1),
        "recoveries": answer.recoveries,
        "levels": [
            {"level": b.level, "class": b.class_, "probability": round(b.probability, 6), "tracks": b.tracks}
            for b in answer.levels
        ],
    }
    if answer.ahead:
        row["forecast"] = [{"seconds": seconds, **_place(place)} for seconds, place in answer.ahead]
    return json.dumps(row, ensure_ascii=False, allow_nan=False) + "\n"


def _place(place: Place) -> dict[str, float]:
    digits = 6 if "lon" in place.names else 3  # 0.1 m, 1 mm
    out = {name: round(value, digits) for name, value in zip(place.names, place.values, strict=True)}
    return {**out, "sd": float(f"{place.sd:.4g}")}


def _csv(cells: Iterable[Any]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerow(cells)
    return out.getvalue()
