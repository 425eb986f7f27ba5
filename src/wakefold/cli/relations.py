"""``wakefold relations``: what ships do together and alone. Heavy imports inside, as in app.py."""

from __future__ import annotations

import csv
import json
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wakefold.base.files import naming
from wakefold.cli import options
from wakefold.cli.console import guarded, progress, say
from wakefold.cli.options import Columns, Json, MaxSpeed, MaxUnpacked, TimeFormat, opt

if TYPE_CHECKING:
    from wakefold.relations.events.events import Event, Found
    from wakefold.tracks.projection import Projection

FORMS = (".csv", ".geojson", ".json")


@guarded
def relations(
    tracks: Annotated[list[Path], typer.Argument(help="Files of tracks; their format is recognised.")],
    output: Annotated[
        Path | None, opt("File for the events: .csv, or .geojson or .json for GeoJSON.", "-o", "--output")
    ] = None,
    pictures: Annotated[Path | None, opt("Directory for a picture of each event of two ships.")] = None,
    near: Annotated[str, typer.Option(help="Two ships meet within this distance,")] = "500m",
    slow: Annotated[str, typer.Option(help="both slower than this,")] = "2kn",
    together: Annotated[str, typer.Option(help="for at least this long.")] = "30min",
    convoy: Annotated[str, typer.Option(help="Two ships sail in convoy for at least this long.")] = "20min",
    berth: Annotated[str, typer.Option(help="Within this distance of a berth only port visits are told.")] = "250m",
    berths: Annotated[
        Path | None, opt("File of more berths: CSV with lon and lat (x and y for planar tracks), or GeoJSON points.")
    ] = None,
    gap: Annotated[
        str, typer.Option(help="After a longer silence a ship takes part in nothing until it is heard again.")
    ] = "15min",
    columns: Columns = "",
    time_format: TimeFormat = None,
    max_speed: MaxSpeed = None,
    max_unpacked: MaxUnpacked = None,
    json_: Json = False,
) -> None:
    """Find encounters, rendezvous, convoys, loitering and port visits of ships.

    \b
    Berths are found from the tracks: places where ships are tied up, or come one after the other. --berths adds more.
    Examples:
      $ wakefold relations harbour.csv -o events.csv
      $ wakefold relations harbour.csv --together 2h -o events.geojson --pictures events
    """
    import wakefold as wf
    from wakefold.io.places import read_places
    from wakefold.relations.events import events
    from wakefold.tracks.projection import dated

    options.input_files(tracks)
    settings = events.Settings(
        near=options.length("--near", near),
        slow=options.speed("--slow", slow),
        together=options.duration("--together", together),
        convoy=options.duration("--convoy", convoy),
        berth=options.length("--berth", berth),
        gap=options.duration("--gap", gap),
    )
    how = options.reading(columns, time_format, max_speed, max_unpacked)
    if output is not None:
        options.output_file("--output", output)
        if output.suffix.lower() not in FORMS:
            options.wrong("--output", f"{output}: the name of the events ends in {', '.join(FORMS)}")
    if pictures is not None:
        options.output_directory("--pictures", pictures)
    known = read_places(berths) if berths is not None else ()
    with progress("reading") as update:
        read, report = wf.read_tracks(tracks, **how, progress=update)
    (say if json_ else print)(str(report))
    if output is not None and output.suffix.lower() != ".csv" and read.projection is None:
        options.wrong("--output", "GeoJSON holds longitude and latitude, and these tracks are planar")
    if berths is not None and read.projection is None:
        known = read_places(berths, planar=True)
    with progress("following pairs") as update:
        found = events.find(read, settings, known=known, progress=update)
    dates = dated(read.projection, float(read.times.min()))
    rows = [_row(event, read.projection, dates) for event in found.events]
    if output is not None:
        with naming(output):
            _write(rows, columns_of(read.projection), output)
        say(f"wrote {output}")
    if pictures is not None:
        _draw(found, pictures, read.projection)
    counts = Counter(event.kind for event in found.events)
    if json_:
        print(json.dumps({"events": rows, "berth_stops": len(found.berths), "left_out_at_berths": found.at_berths}))
        return
    for kind in events.KINDS:
        print(f"{counts[kind]:>8,} {kind}")
    print(f"{found.at_berths:>8,} times two ships lay together at berths, left out")
    for row in [row for row in rows if row["second"]][:20]:
        print(f"{row['begin']}  {row['kind']:<11}{row['first']} {row['second']}  {row['minutes']:.0f} min  "
              f"p {row['probability']:.2f}  {row['distance_m']:.0f} m  {row['speed_kn']:.1f} kn")  # fmt: skip


def columns_of(projection: Projection | None) -> list[str]:
    """What is told of an event; its place in degrees, or, of planar tracks, in the plane they lie in."""
    place = ("x", "y") if projection is None else ("lon", "lat")
    return ["kind", "first", "second", "begin", "end", "minutes", "probability", *place, "distance_m", "speed_kn"]


def _row(event: Event, projection: Projection | None, dates: bool) -> dict[str, Any]:
    """An event in plain types; what is not known is None. Times that are no ``dates`` stay seconds."""
    import numpy as np

    from wakefold.base.units import KNOT

    place = event.place if projection is None else projection.to_geodetic(event.place[None])[0]
    times = (event.begin, event.end)
    clock = [str(np.datetime64(round(t), "s")) + "Z" if dates else round(t, 3) for t in times]
    distance = None if np.isnan(event.distance) else round(event.distance, 1)
    first, second = (*event.agents, "")[:2]
    values = (event.kind, first, second, *clock, round((event.end - event.begin) / 60, 1))
    at = np.round(place, 6 if projection is not None else 2).tolist()
    numbers = (round(event.probability, 4), *at, distance, round(event.speed / KNOT, 2))
    return dict(zip(columns_of(projection), (*values, *numbers), strict=True))


def _write(rows: list[dict[str, Any]], names: list[str], path: Path) -> None:
    """CSV, or GeoJSON of tracks that have longitudes and latitudes."""
    with path.open("w", encoding="utf-8", newline="") as file:
        if path.suffix.lower() == ".csv":
            out = csv.DictWriter(file, names, lineterminator="\n")
            out.writeheader()
            out.writerows(rows)
            return
        features = []
        for row in rows:
            properties = {name: value for name, value in row.items() if name not in ("lon", "lat")}
            geometry = {"type": "Point", "coordinates": [row["lon"], row["lat"]]}
            features.append({"type": "Feature", "properties": properties, "geometry": geometry})
        json.dump({"type": "FeatureCollection", "features": features}, file, allow_nan=False, ensure_ascii=False)


def _draw(found: Found, folder: Path, projection: Projection | None) -> None:
    from wakefold import plot

    with naming(folder):
        folder.mkdir(parents=True, exist_ok=True)
    pairs = [event for event in found.events if len(event.agents) > 1]
    with progress("drawing") as update:
        for k, event in enumerate(pairs):
            path = folder / f"{k + 1:03d}-{event.kind}.png"
            plot.save(plot.event(found, event, projection), path)
            update(k, len(pairs))
    say(f"wrote {len(pairs):,} pictures to {folder}")
