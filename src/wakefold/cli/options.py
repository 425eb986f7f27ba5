"""What the values of options mean. Whatever is wrong is a wrong usage that names its option, before any long work."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TypeVar

import typer

from wakefold.base.files import STANDARD

if TYPE_CHECKING:
    from wakefold.base.parallel import Executor
    from wakefold.model.filtration import Filtration
    from wakefold.service.feed import Form
    from wakefold.tracks.tracks import Tracks

T = TypeVar("T")
MOST_LEVELS = 20  # that are asked for by number; a larger number is a height without its unit
PICTURES = (".png", ".svg", ".pdf")


def opt(help: str, *names: str) -> Any:
    """An option whose default is said in its help, or needs no saying."""
    return typer.Option(*names, help=help, show_default=False)


Columns = Annotated[
    str,
    opt(
        "Columns of a table, or properties of GeoJSON, with names of their own: agent=...,time=...,lon=...,lat=... or "
        "x=...,y=...; time=Date+Time joins two; by position (0, 1, ...) if there is no header."
    ),
]
TimeFormat = Annotated[
    str | None,
    opt(
        "How times are written: s, ms, us or ns since 1970, days of a spreadsheet, or a pattern such as "
        "%d/%m/%Y %H:%M. Needless for ISO 8601 and seconds."
    ),
]
MAX_GAP, MIN_LENGTH = "30min", "0"  # what cuts a track and what it must have, if nothing is said
MaxSpeed = Annotated[
    str | None,
    opt(
        "Fastest that an agent can be, such as 400 (metres per second) or 30kn: what would take more is a jump, or "
        "another agent of that name. With longitudes and latitudes 60 if not given; none: no check."
    ),
]
MaxUnpacked = Annotated[
    str | None,
    opt("Most bytes that a packed file may unpack to, such as 4GB. 200 times its size, and 256 MiB, if not given."),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, for a program to read.")]


def given(context: typer.Context) -> dict[str, str]:
    """What the command line gives: names of the parameters, and how their options are written there."""
    sources = {p.name: context.get_parameter_source(p.name) for p in context.command.params if p.name}
    written = {p.name: max(p.opts, key=len) for p in context.command.params}
    return {name: written[name] for name, source in sources.items() if source and source.name == "COMMANDLINE"}


def wrong(option: str, why: str) -> NoReturn:
    """Wrong usage of an option: exit code 2."""
    raise typer.BadParameter(why, param_hint=option)


def parsed(option: str, parse: Callable[[str], T], text: str) -> T:
    """What a text says, or wrong usage."""
    try:
        return parse(text)
    except ValueError as error:
        wrong(option, str(error))


def length(option: str, text: str, *, zero: bool = False) -> float:
    """Metres, above 0 unless ``zero``."""
    from wakefold.base.units import metres

    value = parsed(option, metres, text)
    return value if value > 0 or zero else wrong(option, "must be above 0")


def duration(option: str, text: str) -> float:
    """Seconds, above 0."""
    from wakefold.base.units import seconds

    value = parsed(option, seconds, text)
    return value if value > 0 else wrong(option, "must be above 0")


def speed(option: str, text: str) -> float:
    """Metres per second, above 0."""
    from wakefold.base.units import metres_per_second

    value = parsed(option, metres_per_second, text)
    return value if value > 0 else wrong(option, "must be above 0")


def reading(
    columns_text: str, time_format: str | None, max_speed: str | None, max_unpacked: str | None
) -> dict[str, Any]:
    """What ``read_tracks`` takes of the options of reading."""
    out: dict[str, Any] = {"columns": columns(columns_text), "time_format": time_format}
    if max_speed is not None:
        out["max_speed"] = None if max_speed.strip().lower() == "none" else speed("--max-speed", max_speed)
    if max_unpacked is not None:
        out["max_unpacked"] = parsed("--max-unpacked", size, max_unpacked)
    return out


def size(text: str) -> int:
    """``4GB``, ``512 MiB`` or ``1000`` in bytes.

    Raises:
        ValueError: it is none.
    """
    match = re.fullmatch(r"\s*(\d{1,15}(?:\.\d{1,3})?)\s*(?:([kmgt])(i?)b?|b)?\s*", text, re.IGNORECASE)
    if match is None:
        raise ValueError(f"{text!r} is not a size such as 4GB or 512MiB")
    power = " kmgt".index((match[2] or " ").lower())
    return int(float(match[1]) * (1024 if match[3] else 1000) ** power)


def levels(text: str) -> int | list[float]:
    """``3`` is a number of levels; ``500m`` and ``500,2000`` are heights, metres, rising."""
    if text.strip().isdigit():
        number = int(text) if len(text) < 10 else MOST_LEVELS + 1
        if not 1 <= number <= MOST_LEVELS:
            wrong("--levels", f"a number of levels is 1 to {MOST_LEVELS}; heights are written 500m or 500,2000")
        return number
    return sorted({length("--levels", part, zero=True) for part in text.split(",")})


def heights(asked: int | list[float], tree: Filtration) -> list[float]:
    """The levels asked for, metres, rising."""
    return tree.levels(asked).tolist() if isinstance(asked, int) else asked


def horizons(text: str, option: str = "--forecast") -> list[float]:
    """``5min,15min`` in seconds, rising, each once."""
    return sorted({duration(option, part) for part in text.split(",")}) if text.strip() else []


def columns(text: str) -> dict[str, str | int] | None:
    """``agent=mmsi,time=t`` by our names; digits are the position of a column in a table without a header."""
    if not text:
        return None
    pairs = [part.partition("=") for part in text.split(",")]
    if not all(name.strip() and equals and value.strip() for name, equals, value in pairs):
        wrong("--columns", f"{text!r} is not like agent=mmsi,time=t,x=px,y=py")
    values = [value.strip() for _, _, value in pairs]
    return {
        name.strip(): int(value) if value.isdecimal() else value
        for (name, _, _), value in zip(pairs, values, strict=True)
    }


def feed_columns(text: str) -> dict[str, str | int] | None:
    """``columns`` of which every name is one that observations have."""
    from wakefold.service.feed import FIELDS, MORE_FIELDS

    given = columns(text)
    if unknown := [name for name in given or () if name not in FIELDS + MORE_FIELDS]:
        wrong("--columns", f"{unknown[0]!r} is none of {', '.join(FIELDS + MORE_FIELDS)}")
    return given


def stop(text: str | None) -> dict[str, Any]:
    """``150m,10min`` as the stop of ``Tracks.segment``."""
    if text is None:
        return {}
    radius, comma, time = text.partition(",")
    if not comma:
        wrong("--stop", f"{text!r} is not a radius and a time such as 150m,10min")
    return {"stop_radius": length("--stop", radius), "stop_time": duration("--stop", time)}


def cuts(max_gap: str | None, max_speed: float | None, stop_: str | None, min_length: str | None) -> dict[str, float]:
    """How tracks are cut from what was recorded, by what was said, as a model keeps it."""
    out: dict[str, float] = {} if max_gap is None else {"max_gap": duration("--max-gap", max_gap)}
    if max_speed is not None:
        out["max_speed"] = max_speed if max_speed > 0 else wrong("--max-speed", "must be above 0")
    out |= stop(stop_)
    return out if min_length is None else out | {"min_length": length("--min-length", min_length, zero=True)}


def cut(tracks: Tracks, cuts: Mapping[str, float]) -> Tracks:
    """Tracks cut as a model keeps it: by the settings of ``Tracks.segment``, without those under ``min_length``."""
    settings: dict[str, Any] = {name: value for name, value in cuts.items() if name != "min_length"}
    return tracks.segment(**settings).filter(min_length=cuts.get("min_length", 0.0))


def ray_workers(workers: int | None) -> Executor:
    """The workers of the cluster that RAY_ADDRESS names, or so many of a new one on this machine."""
    from wakefold.base.parallel import Ray

    try:
        import ray
    except ImportError:
        wrong("--executor", "Ray is not installed: pip install 'wakefold[ray]'")
    if not ray.is_initialized():
        ray.init(num_cpus=None if "RAY_ADDRESS" in os.environ else workers, log_to_driver=False)
    return Ray()


# Where input comes from and output goes


def input_files(paths: Sequence[Path]) -> None:
    """Files that are read more than once, so that standard input is none."""
    if STANDARD in paths:
        wrong("-", "standard input is read by `wakefold track` only: give files")


def model_directory(path: Path) -> Path:
    """A directory that a model may be kept in: a new one, or a stored one that will be replaced."""
    from wakefold.base.store import MANIFEST, StoreError, check_target

    if path == STANDARD:
        wrong("--output", "a model is a directory, which standard output is not")
    _outside_models("--output", path)
    if path.exists() and not (path / MANIFEST).is_file():
        wrong("--output", f"{path} exists and is no model")
    try:
        check_target(path, "model")
    except StoreError as error:
        wrong("--output", f"{error}")
    _writable("--output", path.absolute().parent)
    return path


def output_directory(option: str, path: Path) -> Path:
    """A directory that is there or can be made, and in which files can be made."""
    if path.exists() and not path.is_dir():
        wrong(option, f"{path} is not a directory")
    _writable(option, path)
    return path


def output_file(option: str, path: Path, *, picture: bool = False) -> Path:
    """A file that can be written: in a directory that is there, and for a picture with an ending that says its kind."""
    if picture and path.suffix.lower() not in PICTURES:
        wrong(option, f"{path}: the name of a picture ends in {', '.join(PICTURES)}")
    if path.is_dir():
        wrong(option, f"{path} is a directory")
    if not path.parent.is_dir():
        wrong(option, f"there is no directory {path.parent}")
    _outside_models(option, path)
    if not path.exists():
        _writable(option, path.parent)
    elif not os.access(path, os.W_OK):
        wrong(option, f"{path} cannot be written")
    return path


def _writable(option: str, folder: Path) -> None:
    """Refuse a directory in which no file can be made; of one that is not there yet, the nearest that is, counts."""
    folder = folder.absolute()
    there = next(one for one in (folder, *folder.parents) if one.exists())
    if not there.is_dir():
        wrong(option, f"{there} is not a directory")
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        wrong(option, f"{there} cannot be written ({error.strerror})")


def form_of_name(name: str) -> Form | None:
    """Of answers, by the ending of their file; None if it says nothing."""
    forms: dict[str, Form] = {".csv": "csv", ".jsonl": "jsonl", ".ndjson": "jsonl"}
    return forms.get(Path(name).suffix.lower())


def _outside_models(option: str, path: Path) -> None:
    from wakefold.base.store import MANIFEST

    for folder in path.absolute().parents:
        if (folder / MANIFEST).is_file():
            wrong(option, f"{path} lies inside the stored {folder.name}")


def arg(help: str) -> Any:
    return typer.Argument(help=help, show_default=False)
