"""``wakefold show``: pictures and exports of a model."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

from wakefold.cli import options
from wakefold.cli.console import guarded, say
from wakefold.cli.options import Json, arg, opt


@guarded
def show(
    model: Annotated[Path, arg("Directory that `wakefold learn` made.")],
    output: Annotated[Path | None, opt("Picture (png, svg, pdf): map and tree.", "-o", "--output")] = None,
    level: Annotated[
        str | None,
        opt("Level of the picture and of --geojson, such as 500m. If not given, the picture has one that tells much."),
    ] = None,
    newick: Annotated[Path | None, opt("Write the tree as Newick; - is standard output.")] = None,
    linkage: Annotated[Path | None, opt("Write the merges as scipy does, CSV or .npy; - is standard output.")] = None,
    geojson: Annotated[Path | None, opt("Write the classes of a level as GeoJSON; - is standard output.")] = None,
    coastline: Annotated[Path | None, opt("GeoJSON file to draw under the tracks.")] = None,
    json_: Json = False,
) -> None:
    """Print a table of levels; draw the tracks and the tree of classes; export the tree.

    \b
    Examples:
      $ wakefold show harbour.model
      $ wakefold show harbour.model -o harbour.png --level 500m
      $ wakefold show harbour.model --newick tree.nwk --linkage merges.csv
      $ wakefold show harbour.model --level 500m --geojson classes.geojson
    """
    import wakefold as wf
    from wakefold.cli.facts import level_table, model_facts
    from wakefold.model import export

    if geojson is not None and level is None:
        options.wrong("--geojson", "say of which --level")
    height = None if level is None else options.length("--level", level, zero=True)
    exports = {"--newick": newick, "--linkage": linkage, "--geojson": geojson}
    streamed = [option for option, path in exports.items() if path == options.STANDARD]
    if len(streamed) + json_ > 1:
        options.wrong(streamed[-1], "one thing only goes to standard output")
    for option, path in exports.items():
        if path is not None and option not in streamed:
            options.output_file(option, path)
    if output is not None:
        options.output_file("--output", output, picture=True)
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
