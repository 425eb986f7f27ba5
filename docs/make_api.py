"""Writes docs/api.md from the docstrings: ``python docs/make_api.py``. A test holds the page to the code."""

import inspect
import sys
from pathlib import Path

import wakefold

PAGE = Path(__file__).with_name("api.md")


def entry(name: str, thing, depth: int) -> list[str]:
    lines = [f"{'#' * depth} `{name}`", ""]
    if not isinstance(thing, property):
        parameters, named = [], False
        for p in inspect.signature(thing).parameters.values():
            if p.kind is p.KEYWORD_ONLY and not named:
                parameters.append("*")
            named |= p.kind in (p.KEYWORD_ONLY, p.VAR_POSITIONAL)
            parameters.append(str(p).replace("'", ""))
        call = f"{name}({', '.join(parameters)})"
        lines += [
            "```python",
            call if len(call) <= 100 else f"{name}(\n    " + ",\n    ".join(parameters) + ",\n)",
            "```",
            "",
        ]
    return [*lines, "```text", inspect.getdoc(thing) or "", "```", ""]


def members(thing) -> list[tuple[str, object]]:
    """Public methods and properties, inherited ones included, in the order of their names."""
    out = []
    for name in sorted(dir(thing)):
        member = inspect.getattr_static(thing, name)
        if name.startswith("_") or (
            not isinstance(member, (property, classmethod, staticmethod)) and not callable(member)
        ):
            continue
        if inspect.getdoc(getattr(thing, name)):
            out.append((name, member))
    return out


def page() -> str:
    lines = [
        "# API reference",
        "",
        "Made from the docstrings by `python docs/make_api.py`. Lengths are metres, times",
        "seconds UTC; `(N, d)` is the shape of an array.",
        "",
    ]
    for name in wakefold.__all__:
        thing = getattr(wakefold, name)
        lines += entry(f"wakefold.{name}", thing, 2)
        if inspect.isclass(thing):
            for inner, member in members(thing):
                lines += entry(f"{name}.{inner}", member if isinstance(member, property) else getattr(thing, inner), 3)
    from wakefold import plot
    from wakefold.experiments.mhpf import datasets
    from wakefold.experiments.walking import blackout as reunion
    from wakefold.experiments.walking import hidden as company
    from wakefold.experiments.walking import recalibration as corrections
    from wakefold.io import places
    from wakefold.relations import model as relations
    from wakefold.relations import phases, scene
    from wakefold.relations.events import events
    from wakefold.relations.learning import together as relations_fit
    from wakefold.relations.learning import walkers

    relational = [name for name in relations.__all__ if name not in wakefold.__all__]
    parts = (
        ("Relations between objects", relations, relational),
        ("Answers of a scene", scene, ["ObjectTable", "RelationTable", "ActivityTable"]),
        ("What ships do together", events, ["find", "Settings", "Event", "Found"]),
        ("Lists of places", places, ["read_places"]),
        ("People, followed", walkers, ["follow", "Walkers"]),
        (
            "Who walks with whom",
            relations_fit,
            ["crowd", "Crowd", "fit", "TogetherFit", "SceneConstants"],
        ),
        ("What beliefs are worth", corrections, ["learn_soon", "learn_surer", "Correction"]),
        ("What company tells", company, ["hide", "Beside", "learn_company", "Company", "beside"]),
        ("Who is who at return", reunion, ["reunite", "Window", "learn_reunion", "Reunion"]),
        ("Two objects, phase by phase", phases, ["Phase", "Turn", "PhaseFilter", "PairPhases"]),
        ("Pictures", plot, plot.__all__),
        ("Data of the papers", datasets, datasets.__all__),
    )
    for title, part, names in parts:
        where = part.__name__
        lines += [f"## {title}: `{where}`", ""]
        for name in names:
            thing = getattr(part, name)
            lines += entry(f"{where.split('.')[-1]}.{name}", thing, 3)
            if inspect.isclass(thing) and part in (relations_fit, corrections, phases):
                own = [(n, m) for n, m in members(thing) if n in vars(thing) and callable(m)]
                lines += [x for n, _ in own for x in entry(f"{name}.{n}", getattr(thing, n), 4)]
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    if sys.argv[1:]:
        sys.exit(__doc__)
    PAGE.write_text(page())
