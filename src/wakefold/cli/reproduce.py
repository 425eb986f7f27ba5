"""``wakefold reproduce``: the experiments of the papers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from wakefold.cli import options
from wakefold.cli.console import guarded, progress, say
from wakefold.cli.options import arg, opt


@guarded
def reproduce(
    figures: Annotated[list[str] | None, arg("Names such as fig1, mse, fig7a; all if none is given.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few runs of each: a taste, too few for any verdict.")] = False,
    out: Annotated[Path, typer.Option(help="Directory for index.html, pictures and results.")] = Path("reproduced"),
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.", min=0)] = 0,
    raster: Annotated[
        Path | None,
        opt("File of tracks, such as AIS, whose traffic the tankers of fig8 and fig9 follow; made up if not given."),
    ] = None,
    processes: Annotated[int | None, opt("Processes at once; one for each core if not given.")] = None,
    list_: Annotated[bool, typer.Option("--list", help="List the names and end.")] = False,
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
        options.wrong("figures", f"no {unknown[0]!r}; there are {', '.join(registry.FIGURES)}")
    options.output_directory("--out", out)
    if processes is not None and processes < 1:
        options.wrong("--processes", "at least 1")
    from wakefold.base.parallel import Processes
    from wakefold.experiments.reproduce import reproduce as run

    size = (registry.QUICK if quick else registry.FULL)._replace(seed=seed)
    if raster is not None:
        from wakefold.experiments.mhpf.rasters import keep

        size = size._replace(tankers=keep(raster, out))
    with progress("reproducing") as update:
        page = run(figures or [], size, out, Processes(processes), update)
    say(f"wrote {page}")
