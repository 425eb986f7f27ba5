"""The answers to observations, as lines of CSV or JSON."""

from __future__ import annotations

import re
from collections.abc import Sequence
from json.encoder import encode_basestring
from typing import NamedTuple


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
        none: probability that the agent goes none of the ways known; None of filters that cannot tell.
    """

    agent: str
    stamp: str | float
    event: str
    place: Place
    ess: float
    recoveries: int
    levels: Sequence[Best]
    ahead: Sequence[tuple[float, Place]]
    none: float | None = None


def csv_header(place: Sequence[str], levels: Sequence[float], ahead: Sequence[float], doubting: bool = False) -> str:
    """The header over ``csv_line`` of answers with these levels (metres) and forecasts (seconds).

    Args:
        doubting: whether answers tell how likely it is that an agent goes none of the ways known.
    """
    names = ["agent", "time", "event", *place, "sd", "ess", "recoveries", *(["none"] if doubting else [])]
    for level in _distinct(levels):
        names += [f"class@{level}", f"probability@{level}", f"tracks@{level}"]
    for seconds in _distinct(ahead):
        names += [f"{name}+{seconds}s" for name in (*place, "sd")]
    return ",".join(names) + "\n"


def _distinct(values: Sequence[float]) -> list[str]:
    """Different numbers as different texts: of six digits, or as many as that takes."""
    texts = ([f"{value:.{digits}g}" for value in values] for digits in range(6, 18))
    return next(names for names in texts if len(set(names)) == len(set(values)))


def csv_line(answer: Answer) -> str:
    """One line, with its end."""
    cells = [_cell(answer.agent), _cell(answer.stamp), answer.event, *_place(answer.place)]
    cells += [f"{answer.ess:.1f}", str(answer.recoveries)]
    cells += [] if answer.none is None else [f"{answer.none:.4f}"]
    for best in answer.levels:
        cells += [str(best.class_), f"{best.probability:.6f}", str(best.tracks)]
    for _, place in answer.ahead:
        cells += _place(place)
    return ",".join(cells) + "\n"


def json_line(answer: Answer) -> str:
    """One line, with its end."""
    levels = ", ".join(
        f'{{"level": {level!r}, "class": {best}, "probability": {round(probability, 6)!r}, "tracks": {tracks}}}'
        for level, best, probability, tracks in answer.levels
    )
    text = (
        f'{{"agent": {_text(answer.agent)}, "time": {_text(answer.stamp)}, "event": "{answer.event}", '
        f'"estimate": {{{_pairs(answer.place)}}}, "ess": {round(answer.ess, 1)!r}, '
        f'"recoveries": {answer.recoveries}, {_none(answer)}"levels": [{levels}]'
    )
    if answer.ahead:
        ahead = ", ".join(f'{{"seconds": {seconds!r}, {_pairs(place)}}}' for seconds, place in answer.ahead)
        text += f', "forecast": [{ahead}]'
    return text + "}\n"


def _none(answer: Answer) -> str:
    return "" if answer.none is None else f'"none": {round(answer.none, 4)!r}, '


def _place(place: Place) -> list[str]:
    """The numbers of a place as texts, the sd last."""
    digits = 6 if "lon" in place.names else 3  # 0.1 m, 1 mm
    return [*[repr(round(value, digits)) for value in place.values], repr(float(f"{place.sd:.4g}"))]


def _pairs(place: Place) -> str:
    return ", ".join(f'"{name}": {value}' for name, value in zip((*place.names, "sd"), _place(place), strict=True))


def _text(value: str | float) -> str:
    """A text or a number in JSON."""
    return encode_basestring(value) if isinstance(value, str) else repr(value)


def _cell(value: str | float) -> str:
    """A cell of CSV."""
    if not isinstance(value, str):
        return repr(value)
    return '"' + value.replace('"', '""') + '"' if _SPECIAL.search(value) else value


_SPECIAL = re.compile('[,"\r\n]')
