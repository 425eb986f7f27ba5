"""``wakefold track``: follow agents."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from wakefold.cli import console, options
from wakefold.cli.console import guarded, progress, say
from wakefold.cli.followers import FILTERS, FilterName, check, crowd, follower
from wakefold.cli.options import Columns, MaxSpeed, MaxUnpacked, TimeFormat, arg, opt


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


DEPLETION = 0.001  # of 200 particles it redraws none, and lets a recovery find any track


@guarded
def track(
    context: typer.Context,
    model: Annotated[Path, arg("Directory that `wakefold learn` made.")],
    observations: Annotated[
        str,
        arg(
            "CSV or JSON lines with agent, time, lon and lat (or x and y), and if known sd, class, level, confidence; "
            "or any file of tracks. - is standard input."
        ),
    ],
    output: Annotated[str, typer.Option("-o", "--output", help="File for the answers; - is standard output.")] = "-",
    levels: Annotated[
        str | None,
        typer.Option(
            help="Levels at which classes are told: heights such as 500,2000 or 500m, or a number of levels, picked by "
            "entropy. 3 if not given.",
            show_default=False,
        ),
    ] = None,
    filter: Annotated[
        FilterName, typer.Option(help="The filter that follows. An option that it does not read is refused.")
    ] = FilterName.trail,
    rule: Annotated[RuleName | None, opt("Update rule of mhpf; gsi2017 if not given.")] = None,
    likelihood: Annotated[
        LikelihoodName, typer.Option(help="How a fix weighs particles; log is the papers' way.")
    ] = LikelihoodName.gaussian,
    sd: Annotated[
        str | None,
        opt("Standard deviation of fixes that tell none, such as 20m; the model's if not given."),
    ] = None,
    particles: Annotated[
        int,
        typer.Option(help="Particles of each agent; calibrated has one for each track at least.", min=1, max=1_000_000),
    ] = 200,
    depletion: Annotated[
        float | None,
        typer.Option(
            help="Share of the particles whose class is drawn anew from all tracks in every step. A share that rounds "
            f"to no particle, as the default, {DEPLETION} of 200, only lets a lost agent be found on any track.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.", min=0)] = 0,
    forecast: Annotated[str, opt("Forecasts to add to every answer, such as 5min,15min.")] = "",
    format: Annotated[
        FormName | None,
        opt(
            "Format of the answers. If not given, by the name of --output (.csv, .jsonl, .ndjson), else that of the "
            "observations."
        ),
    ] = None,
    columns: Columns = "",
    time_format: TimeFormat = None,
    max_speed: MaxSpeed = None,
    max_unpacked: MaxUnpacked = None,
    agent: Annotated[list[str] | None, opt("Follow this agent only; may be repeated.")] = None,
    max_agents: Annotated[
        int, typer.Option(help="Most live agents; with more, the one silent for longest is dropped.", min=1)
    ] = 10_000,
    max_gap: Annotated[str, typer.Option(help="After a longer silence an agent starts anew.")] = "6h",
    picture: Annotated[Path | None, opt("Picture (png, svg, pdf) of the first agent's beliefs.")] = None,
) -> None:
    """Follow agents: an answer for each observation, line by line.

    An answer tells where the agent is, its likeliest class at each level, and the forecasts asked for.

    \b
    Examples:
      $ wakefold track harbour.model fixes.csv
      $ wakefold track harbour.model fixes.csv --levels 500,2000 --forecast 5min,15min -o beliefs.jsonl
      $ cat fixes.csv | wakefold track harbour.model - --format jsonl
      $ wakefold track harbour.model fixes.csv --agent ferry --picture ferry.png -o ferry.csv
    """
    import wakefold as wf
    from wakefold.filters.particles import ParticleFilter
    from wakefold.service import album, fleet, follow
    from wakefold.service.remarks import Remarks

    check(filter, options.given(context))
    share = DEPLETION if depletion is None else depletion
    if not 0 <= share <= 1:
        options.wrong("--depletion", f"{share:g} is not a share from 0 to 1")
    asked = options.levels(levels or "3") if "levels" in FILTERS[filter].reads else []
    settings: dict[str, Any] = {
        "rule": None if rule is None else rule.value,
        "likelihood": likelihood.value,
        "sd": None if sd is None else options.length("--sd", sd),
        "particles": particles,
        "depletion": share,
        "seed": seed,
    }
    silence = options.duration("--max-gap", max_gap)
    horizons = options.horizons(forecast)
    reading = options.reading(columns, time_format, max_speed, max_unpacked)
    options.feed_columns(columns)
    if picture is not None:
        options.output_file("--picture", picture, picture=True)
    if output != "-":
        path = options.output_file("--output", Path(output))
        if path.exists() and Path(observations).exists() and path.samefile(observations):
            options.wrong("--output", f"{output} holds the observations")
    known = wf.load(model)
    heights = options.heights(asked, known.filtration)
    following = follower(filter, known, {**settings, "levels": heights})
    most = following.limit if isinstance(following, wf.Trail) else fleet.longest_step(known)
    if horizons and horizons[-1] > most:
        options.wrong("--forecast", f"{horizons[-1]:g} s is too far ahead for this model, {most:g} s at most")
    if depletion and isinstance(following, ParticleFilter) and not following.redrawn:
        say(f"--depletion {depletion:g} of {particles:,} particles is none: no class is drawn anew while an agent is "
            f"followed; more than {0.5 / particles:g} draws one")  # fmt: skip
    live = crowd(following, heights, horizons, max_agents, silence, Remarks(say))
    pages = album.Album(heights) if picture is not None else None
    form = options.form_of_name(output) if format is None else format.value
    with progress("following", shown=output != "-") as update:
        try:
            refused = follow.run(live, observations, output, form, reading, frozenset(agent or ()), pages, update, say)
        finally:
            if pages is not None and pages.agent is not None and picture is not None:
                album.draw(pages, known, picture)
    if refused:
        raise typer.Exit(console.FAILED)
