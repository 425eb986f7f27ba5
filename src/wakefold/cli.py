"""The command line: parse, call, print. Heavy imports happen inside the commands, so that --help is quick."""

from __future__ import annotations

import io
import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from wakefold import __version__, cli_options, cli_relations, cli_support
from wakefold.cli_options import Columns, Json, TimeFormat, opt
from wakefold.cli_support import fail, guarded, level_table, model_facts, naming, progress, say
from wakefold.wording import number_text

MOST_POINTS = 20_000_000  # of a model: far more than can be compared

app = typer.Typer(
    name="wakefold",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)


class LinkageName(StrEnum):
    single = "single"
    complete = "complete"


class FilterName(StrEnum):
    mhpf = "mhpf"
    bl1 = "bl1"
    bl1_coarse = "bl1+coarse"
    bl2 = "bl2"


class RuleName(StrEnum):
    arxiv2016 = "arxiv2016"
    gsi2017 = "gsi2017"


class LikelihoodName(StrEnum):
    gaussian = "gaussian"
    student = "student"
    log = "log"


class FormName(StrEnum):
    csv = "csv"
    jsonl = "jsonl"


def _arg(help: str) -> Any:
    return typer.Argument(help=help, show_default=False)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    """Tells, at every scale at once, what a moving agent is doing.

    \b
    Learn classes of movement from past tracks, then follow live agents:
      $ wakefold learn harbour.csv -o harbour.model
      $ wakefold track harbour.model fixes.csv -o beliefs.csv

    \b
    Exit codes: 0 done; 1 an error in the data, or lines that were refused;
    2 wrong usage; 130 interrupted; 141 whoever read the output has gone.
    """
    cli_support.debug = debug
    if version:
        print(f"wakefold {__version__}")
        raise typer.Exit


@app.command()
@guarded
def learn(
    tracks: Annotated[list[Path], _arg("Files of tracks; their format is recognised.")],
    output: Annotated[Path, opt("Directory to keep the model in.", "-o", "--output")],
    spacing: Annotated[
        str,
        typer.Option(
            help="Distance between the points of a track, such as 200m. auto: a fiftieth of the median track; "
            "for geodetic data of those that get farther than 1 km, and 20 m to 200 m."
        ),
    ] = "auto",
    max_gap: Annotated[str, typer.Option(help="Cut a track where its agent is silent for longer.")] = "30min",
    max_speed: Annotated[
        float | None,
        opt("Cut a track where getting to the next point takes more, metres per second."),
    ] = None,
    stop: Annotated[
        str | None,
        opt("Cut a track where its agent stands: RADIUS,TIME such as 150m,10min."),
    ] = None,
    min_length: Annotated[str, typer.Option(help="Leave out tracks that are shorter, such as 1km.")] = "0",
    linkage: Annotated[LinkageName, typer.Option(help="How classes join.")] = LinkageName.single,
    epsilon: Annotated[
        str | None,
        opt("Radius of the velocity field, such as 500m; learned without."),
    ] = None,
    columns: Columns = "",
    time_format: TimeFormat = None,
    threads: Annotated[int | None, typer.Option(help="Of the distances; all cores without.", min=1)] = None,
    checkpoint: Annotated[
        Path | None,
        opt("Directory from which an interrupted comparison of the tracks goes on."),
    ] = None,
    json_: Json = False,
) -> None:
    """Learn a model from past tracks.

    \b
    Examples:
      $ wakefold learn harbour.csv -o harbour.model
      $ wakefold learn monday.csv tuesday.csv --stop 150m,10min --min-length 1km -o week.model
      $ wakefold learn people.csv --columns agent=who,time=t,x=px,y=py -o forum.model
    """
    import wakefold as wf

    cli_options.input_files(tracks)
    cli_options.model_directory(output)
    step = None if spacing == "auto" else cli_options.length("--spacing", spacing)
    cuts = {"max_gap": cli_options.duration("--max-gap", max_gap), "max_speed": max_speed, **cli_options.stop(stop)}
    if max_speed is not None and not max_speed > 0:
        cli_options.wrong("--max-speed", "must be above 0")
    shortest = cli_options.length("--min-length", min_length, zero=True)
    radius = None if epsilon is None else cli_options.length("--epsilon", epsilon)
    names = cli_options.columns(columns)
    with progress("reading") as update:
        read, report = wf.read_tracks(tracks, columns=names, time_format=time_format, progress=update)
    show = say if json_ else print
    show(str(report))
    pieces = read.segment(**cuts).filter(min_length=shortest)
    if not len(pieces):
        fail("no track is left to learn from: " + "; ".join(pieces.notes))
    for remark in filter(None, [cli_options.at_rest(pieces), cli_options.impossible(pieces)]):
        show(f"  note: {remark}")
    step = step or cli_options.auto_spacing(pieces) or fail("no track moves: give --spacing")
    if (points := cli_options.points_after(pieces, step)) > MOST_POINTS:
        every = f"a point every {number_text(step, 4)} m"
        fail(f"{every} makes {points:,} points, over {MOST_POINTS:,}: give a larger --spacing")
    pieces = pieces.resample(spacing=step)
    for note in pieces.notes:
        show(f"  {note}")
    if linkage is LinkageName.complete and len(pieces) > 5000:
        say(f"{len(pieces):,} tracks: their distances take {len(pieces) ** 2 * 8 / 2**30:.1f} GiB of memory and more")
    with progress("comparing tracks") as update:
        model = wf.learn(
            pieces,
            linkage=linkage.value,
            epsilon=radius,
            threads=threads,
            progress=update,
            checkpoint=checkpoint,
        )
    with naming(output):
        model.save(output)
    tree = model.filtration
    if json_:
        print(json.dumps({"model": str(output), "report": report.to_dict(), **model_facts(model), "spacing": step}))
        return
    print(f"{pieces!r}, a point every {number_text(step, 4)} m")
    print(repr(model))
    print(level_table(tree))
    print(f"kept in {output}")


@app.command()
@guarded
def track(
    model: Annotated[Path, _arg("Directory that `wakefold learn` made.")],
    observations: Annotated[str, _arg("CSV, JSON lines or any file of tracks; - is standard input.")],
    output: Annotated[str, typer.Option("-o", "--output", help="File for the answers; - is standard output.")] = "-",
    levels: Annotated[
        str | None,
        typer.Option(
            help="Levels to answer at: heights such as 500,2000 or 500m, or how many (3 without), picked by entropy.",
            show_default=False,
        ),
    ] = None,
    filter: Annotated[FilterName, typer.Option(help="Who follows.")] = FilterName.mhpf,
    rule: Annotated[RuleName | None, opt("Update rule of mhpf; arxiv2016 without.")] = None,
    likelihood: Annotated[LikelihoodName, typer.Option(help="Weight of a fix.")] = LikelihoodName.gaussian,
    sd: Annotated[
        str | None,
        opt("Accuracy of fixes that tell none, such as 20m; the model's without."),
    ] = None,
    particles: Annotated[int, typer.Option(help="Particles of each agent.", min=1, max=1_000_000)] = 200,
    depletion: Annotated[
        float, typer.Option(help="Share of the particles whose class is drawn anew, from all tracks, in every step.")
    ] = 0.001,
    seed: Annotated[int, typer.Option(help="Of all random numbers.", min=0)] = 0,
    forecast: Annotated[str, opt("Forecasts to add to every answer, such as 5min,15min.")] = "",
    format: Annotated[
        FormName | None,
        opt("Of the answers; by the name of --output (.csv, .jsonl, .ndjson), or that of the observations without."),
    ] = None,
    columns: Columns = "",
    time_format: TimeFormat = None,
    agent: Annotated[list[str] | None, opt("Follow this agent only; may be repeated.")] = None,
    max_agents: Annotated[
        int, typer.Option(help="Live agents at most; the one silent for longest is dropped.", min=1)
    ] = 10_000,
    max_gap: Annotated[str, typer.Option(help="An agent starts anew after a longer silence.")] = "6h",
    picture: Annotated[Path | None, opt("Picture (png, svg, pdf) of the first agent's beliefs.")] = None,
) -> None:
    """Follow agents: an answer for each observation, line by line.

    \b
    Examples:
      $ wakefold track harbour.model fixes.csv
      $ wakefold track harbour.model fixes.csv --levels 500,2000 --forecast 5min,15min -o beliefs.jsonl
      $ cat fixes.csv | wakefold track harbour.model - --format jsonl
      $ wakefold track harbour.model fixes.csv --agent ferry --picture ferry.png -o ferry.csv
    """
    import wakefold as wf
    from wakefold import cli_track

    if rule is not None and filter is not FilterName.mhpf:
        cli_options.wrong("--rule", "only --filter mhpf has update rules")
    if levels is not None and filter is FilterName.bl2:
        cli_options.wrong("--levels", "--filter bl2 tells no classes apart")
    if not 0 <= depletion <= 1:
        cli_options.wrong("--depletion", f"{depletion:g} is not a share from 0 to 1")
    asked = [] if filter is FilterName.bl2 else cli_options.levels(levels or "3")
    settings: dict[str, Any] = {"likelihood": likelihood.value, "depletion": depletion, "seed": seed}
    settings |= {} if sd is None else {"sd": cli_options.length("--sd", sd)}
    silence = cli_options.duration("--max-gap", max_gap)
    horizons = cli_options.horizons(forecast)
    names = cli_options.feed_columns(columns)
    if picture is not None:
        cli_options.output_file("--picture", picture, picture=True)
    if output != "-":
        path = cli_options.output_file("--output", Path(output))
        if path.exists() and Path(observations).exists() and path.samefile(observations):
            cli_options.wrong("--output", f"{output} holds the observations")
    known = wf.load(model)
    if horizons and horizons[-1] > (most := cli_track.longest_step(known)):
        cli_options.wrong("--forecast", f"{horizons[-1]:g} s is too far ahead for this model, {most:g} s at most")
    heights = cli_options.heights(asked, known.filtration)
    match filter:
        case FilterName.mhpf:
            settings |= {} if rule is None else {"rule": rule.value}
            follower = wf.MHPF(known, particles, levels=heights, **settings)
        case FilterName.bl2:
            follower = wf.BL2(known, particles, **settings)
        case _:
            follower = wf.BL1(known, particles, coarse=filter is FilterName.bl1_coarse, **settings)
    crowd = cli_track.Crowd(follower, heights, horizons, max_agents, silence, say)
    album = cli_track.Album(heights) if picture is not None else None
    form = cli_options.form_of_name(output) if format is None else format.value
    with progress("following", shown=output != "-") as update:
        try:
            refused = cli_track.run(
                crowd, observations, output, form, names, time_format, frozenset(agent or ()), album, update, say
            )
        finally:
            if album is not None and album.agent is not None and picture is not None:
                cli_track.draw(album, known, picture)
    if refused:
        raise typer.Exit(cli_support.FAILED)


@app.command()
@guarded
def show(
    model: Annotated[Path, _arg("Directory that `wakefold learn` made.")],
    output: Annotated[Path | None, opt("Picture (png, svg, pdf): map and tree.", "-o", "--output")] = None,
    level: Annotated[
        str | None,
        opt("Level of picture and GeoJSON, such as 500m; for the picture a telling one without."),
    ] = None,
    newick: Annotated[Path | None, opt("Write the tree as Newick; - is standard output.")] = None,
    linkage: Annotated[Path | None, opt("Write the merges as scipy does, CSV or .npy; - is standard output.")] = None,
    geojson: Annotated[Path | None, opt("Write the classes of a level as GeoJSON; - is standard output.")] = None,
    coastline: Annotated[Path | None, opt("GeoJSON file to draw under the tracks.")] = None,
    json_: Json = False,
) -> None:
    """Show the tree of classes and the tracks on a map; export the tree.

    \b
    Examples:
      $ wakefold show harbour.model
      $ wakefold show harbour.model -o harbour.png --level 500m
      $ wakefold show harbour.model --newick tree.nwk --linkage merges.csv
      $ wakefold show harbour.model --level 500m --geojson classes.geojson
    """
    import wakefold as wf
    from wakefold import export

    if geojson is not None and level is None:
        cli_options.wrong("--geojson", "say of which --level")
    height = None if level is None else cli_options.length("--level", level, zero=True)
    exports = {"--newick": newick, "--linkage": linkage, "--geojson": geojson}
    streamed = [option for option, path in exports.items() if path == cli_options.STANDARD]
    if len(streamed) + json_ > 1:
        cli_options.wrong(streamed[-1], "one thing only goes to standard output")
    for option, path in exports.items():
        if path is not None and option not in streamed:
            cli_options.output_file(option, path)
    if output is not None:
        cli_options.output_file("--output", output, picture=True)
    known = wf.load(model)
    tracks, tree = known.tracks, known.filtration
    if json_:
        print(json.dumps({"model": str(model), **model_facts(known)}))
    else:
        print(repr(known), level_table(tree), sep="\n", file=sys.stderr if streamed else sys.stdout)
    if newick is not None:
        export.write_newick(tree, newick)
    if linkage is not None:
        export.write_linkage(tree, linkage)
    if geojson is not None and height is not None:
        export.write_classes(tracks, tree, height, geojson)
    done = [path for option, path in exports.items() if path is not None and option not in streamed]
    if output is not None:
        from wakefold import plot

        plot.save(plot.filtration(tracks, tree, height, coastline=coastline), output)
        done.append(output)
    for path in done:
        say(f"wrote {path}")


@app.command()
@guarded
def info(
    files: Annotated[list[Path], _arg("Files of tracks, or models.")],
    columns: Columns = "",
    time_format: TimeFormat = None,
    json_: Json = False,
) -> None:
    """Say what files of tracks, or models, hold.

    \b
    Examples:
      $ wakefold info harbour.csv
      $ wakefold info harbour.model --json
    """
    from wakefold.cli_info import about

    cli_options.input_files(files)
    names, known = cli_options.columns(columns), []
    for path in files:
        with progress("reading") as update:
            text, facts = about(path, names, time_format, update)
        known.append(facts)
        if not json_:
            print(text)
    if json_:
        print(json.dumps(known if len(known) > 1 else known[0], allow_nan=False))


@app.command()
@guarded
def demo(
    out: Annotated[Path, typer.Option(help="Directory for report.html and pictures.")] = Path("demo-output"),
    json_: Json = False,
) -> None:
    """Learn a week of New York Harbor and follow the ships of the day after.

    \b
    Needs the sample data: pip install "wakefold[demo]".
    Example:
      $ wakefold demo --out demo-output
    """
    from wakefold import demo as harbour

    cli_options.output_directory("--out", out)
    with progress("demo") as update:
        results = harbour.run(out, update, (lambda line: None) if json_ else print)
    if json_:
        print(json.dumps(results, allow_nan=False))


@app.command()
@guarded
def reproduce(
    figures: Annotated[list[str] | None, _arg("Which: fig1, mse, fig7a, ...; all without. --list tells them.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few runs of each, too few for any verdict.")] = False,
    out: Annotated[Path, typer.Option(help="Directory for index.html, pictures and results.")] = Path("reproduced"),
    seed: Annotated[int, typer.Option(help="Of everything.", min=0)] = 0,
    raster: Annotated[
        Path | None, opt("Tracks, such as AIS, to count the tankers' raster from; synthetic without.")
    ] = None,
    processes: Annotated[int | None, opt("At once; one on each core without.")] = None,
    list_: Annotated[bool, typer.Option("--list", help="Name the figures and end.")] = False,
) -> None:
    """Repeat the experiments of the papers: one page, every figure and number beside the published one.

    \b
    A run that was interrupted goes on where it stopped.
    Examples:
      $ wakefold reproduce --out reproduced
      $ wakefold reproduce mse fig7a --quick
      $ wakefold reproduce fig8 fig9 --raster gulf.csv
    """
    from wakefold.experiments import registry

    if list_:
        for name in registry.FIGURES:
            print(f"{name:10} {registry.experiment(name).TITLE}")
        return
    if unknown := [name for name in figures or [] if name not in registry.FIGURES]:
        cli_options.wrong("figures", f"no {unknown[0]!r}; there are {', '.join(registry.FIGURES)}")
    cli_options.output_directory("--out", out)
    if processes is not None and processes < 1:
        cli_options.wrong("--processes", "at least 1")
    from wakefold.experiments.reproduce import reproduce as run
    from wakefold.parallel import Processes

    size = (registry.QUICK if quick else registry.FULL)._replace(seed=seed)
    if raster is not None:
        from wakefold.experiments.rasters import keep

        size = size._replace(tankers=keep(raster, out))
    with progress("reproducing") as update:
        page = run(figures or [], size, out, Processes(processes), update)
    say(f"wrote {page}")


app.command()(cli_relations.relations)


def main() -> None:
    """Entry point of the ``wakefold`` command. It writes UTF-8 in every locale, as files and names hold anything."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(encoding="utf-8", errors="backslashreplace")
    app()
