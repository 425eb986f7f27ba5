"""Writes the API reference, docs/api.md and a page for each package in docs/api/: ``python docs/make_api.py``.

Signatures are taken from the source, as they are written there; the rest are the docstrings. A test holds the pages to
the code.
"""

import ast
import dataclasses
import inspect
import re
import sys
import textwrap
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import wakefold

DOCS = Path(__file__).parent
MORE = {  # what stands in no `wakefold.X`: package -> (title, module, names; all that it exports without)
    "base": [("Executors", "base.parallel", ["Executor", "Threads", "Processes", "Ray"])],
    "io": [
        ("Reports of readers", "io.report", ["Report", "Offence", "ReadError"]),
        ("Lists of places", "io.places", ["read_places"]),
    ],
    "tracks": [("The plane", "tracks.projection", ["Projection"])],
    "model": [("Velocities of the classes", "model.dynamics", ["Dynamics"])],
    "plot": [("Pictures", "plot", None)],
    "relations": [
        ("Predicates and couplings", "relations", None),
        ("Answers of a scene", "relations.scene", ["ObjectTable", "RelationTable", "ActivityTable", "Pairs"]),
        ("Two objects, phase by phase", "relations.phases", ["Phase", "Turn", "PhaseFilter", "PairPhases"]),
        ("What ships do together", "relations.events.events", ["find", "Settings", "Event", "Found"]),
        ("Ships, minute by minute", "relations.events.stops", ["Moments"]),
        ("People, followed", "relations.learning.walkers", ["follow", "Walkers", "Together", "Looks"]),
        (
            "Who walks with whom",
            "relations.learning.together",
            ["crowd", "Crowd", "fit", "TogetherFit", "SceneConstants"],
        ),
    ],
    "forecast": [
        ("Questions and answers", "forecast.questions", ["Questions", "ask"]),
        ("Samples, scored", "forecast.samples", ["judged", "Judged"]),
    ],
    "filters": [
        ("What particle filters share", "filters.particles", ["ParticleFilter"]),
        (
            "Kinds of beliefs",
            "filters.belief",
            ["TrackBelief", "FieldBelief", "StackBelief", "GaussianBelief"],
        ),
        ("What they hold beside particles", "filters.sets", ["Stack", "Gaussians"]),
        ("Tables of classes", "filters.levels", ["LevelTable", "LevelRow"]),
        ("Hidden states", "filters.hmm", ["StateBelief"]),
    ],
    "experiments": [
        ("Data of the papers", "experiments.mhpf.datasets", None),
        ("Scenes of pedestrians", "experiments.walking.pedestrians", ["read_scenes", "read_scene", "PedestrianScene"]),
        (
            "What beliefs are worth",
            "experiments.walking.recalibration",
            ["learn_soon", "learn_surer", "Correction"],
        ),
        (
            "What company tells",
            "experiments.walking.hidden",
            ["hide", "Beside", "learn_company", "Company", "beside"],
        ),
        (
            "Who is who at return",
            "experiments.walking.blackout",
            ["reunite", "Window", "learn_reunion", "Reunion"],
        ),
    ],
}
TYPES = """\
| name of a type | is |
|---|---|
| `Floats`, `Ints`, `Bools` | numpy array of float64, of int64, of booleans |
| `ArrayLike` | an array, or whatever `numpy.asarray` makes one of |
| `Length` | metres, or text such as `"200m"`, `"1.5km"`, `"2nmi"` |
| `Duration` | seconds, or text such as `"90s"`, `"30min"`, `"6h"` |
| `Time` | seconds UTC since 1970, a date, datetime or datetime64, or ISO 8601 text |
| `Evidence` | `Fix` or `CoarseClass` |
| `Box` | x0, y0, x1, y1 of a rectangle, metres |
| `Columns` | what is in a table -> name or number of its column |
| `Progress` | a function that is told how far the work has come |
| `Reporter` | a function from positions `(n, 2)` and random numbers to classes `(n,)` |
| `DetectProb` | a probability, or a function from positions `(n, 2)` to probabilities `(n,)` |
| `Drawn`, `Among`, `Episode` | what pictures read of a `Scene`, of `Found`, of an `Event` |
"""
FACTORIES = {"dict": "{}", "list": "[]", "tuple": "()"}


def source(thing: Any) -> tuple[str, Any]:
    """Source text of a class or function, and its syntax tree."""
    text = textwrap.dedent(inspect.getsource(thing))
    return text, ast.parse(text).body[0]


def written(text: str, node: ast.expr | None, module: Any) -> str | None:
    """A type or default as it is written, on one line; names of constants and of ``Literal`` types spelt out."""
    if node is None:
        return None
    if isinstance(node, ast.Constant) and isinstance(node.value, str) and re.search(r"\W", node.value):
        node, text = ast.parse(node.value, mode="eval").body, node.value  # a quoted type
    value = " ".join((ast.get_source_segment(text, node) or "").split())
    if isinstance(node, ast.Call) and value.startswith("field("):
        factory = next((k.value for k in node.keywords if k.arg == "default_factory"), None)
        return FACTORIES.get(ast.unparse(factory), "...") if factory else None
    for name in {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}:
        meant = vars(module).get(name)
        if isinstance(meant, (int, float, str)) and not isinstance(meant, bool):
            value = re.sub(rf"\b{name}\b", repr(meant).replace("'", '"'), value)
        elif get_origin(meant) is Literal:
            choices = ", ".join(repr(c).replace("'", '"') for c in get_args(meant))
            value = re.sub(rf"\b{name}\b", f"Literal[{choices}]", value)
    return value


def parameter(name: str, kind: str | None, default: str | None) -> str:
    middle = f": {kind}" if kind else ""
    return name + middle + ("" if default is None else f" = {default}" if kind else f"={default}")


def of_function(thing: Any, bound: bool, of: type | None = None) -> tuple[list[str], str | None]:
    """Parameters of a function, and what it returns; ``bound`` leaves out the first, ``of`` is the class it is in."""
    text, node = source(thing)
    module, a = sys.modules[thing.__module__], node.args
    plain = [*a.posonlyargs, *a.args]
    defaults = [None] * (len(plain) - len(a.defaults)) + a.defaults
    listed = [(x.arg, x, d) for x, d in zip(plain, defaults, strict=True)][bound:]
    if a.vararg:
        listed.append((f"*{a.vararg.arg}", a.vararg, None))
    elif a.kwonlyargs:
        listed.append(("*", None, None))
    listed += [(x.arg, x, d) for x, d in zip(a.kwonlyargs, a.kw_defaults, strict=True)]
    if a.kwarg:
        listed.append((f"**{a.kwarg.arg}", a.kwarg, None))
    parts = [
        parameter(name, x and written(text, x.annotation, module), written(text, default, module))
        for name, x, default in listed
    ]
    back = written(text, node.returns, module)
    for name in set(re.findall(r"\w+", back or "")):
        if isinstance(kind := vars(module).get(name), TypeVar) and isinstance(limit := kind.__bound__, type):
            meant = of if of and issubclass(of, limit) else limit
            back = re.sub(rf"\b{name}\b", meant.__name__, back or "")
    return parts, back


def of_fields(thing: type) -> list[str]:
    """Parameters of a dataclass or named tuple."""
    lines: dict[str, tuple[str, ast.AnnAssign, Any]] = {}
    for kind in reversed([k for k in thing.__mro__ if k.__module__.startswith("wakefold")]):
        text, node = source(kind)
        here = [x for x in node.body if isinstance(x, ast.AnnAssign) and isinstance(x.target, ast.Name)]
        lines |= {x.target.id: (text, x, sys.modules[kind.__module__]) for x in here}
    if dataclasses.is_dataclass(thing):
        names = [(f.name, f.kw_only) for f in dataclasses.fields(thing) if f.init]
    else:
        names = [(name, False) for name in getattr(thing, "_fields", ())]
    parts = []
    for name, by_name in sorted(names, key=lambda n: n[1]):
        if by_name and "*" not in parts:
            parts.append("*")
        text, line, module = lines[name]
        parts.append(parameter(name, written(text, line.annotation, module), written(text, line.value, module)))
    return parts


def signature(name: str, thing: Any, bound: bool = False, of: type | None = None) -> list[str]:
    """The call as a person writes it, in a block of code; nothing for what is not called, as errors."""
    back = None
    if not inspect.isclass(thing):
        parts, back = of_function(inspect.unwrap(thing), bound, of)
    elif dataclasses.is_dataclass(thing) or hasattr(thing, "_fields"):
        parts = of_fields(thing)
    elif inspect.isfunction(thing.__init__) and not getattr(thing, "_is_protocol", False):
        parts, _ = of_function(thing.__init__, True)
    else:
        return []
    told = [part.lstrip("*").split(":")[0].split("=")[0] for part in parts if part != "*"]
    assert told == list(inspect.signature(thing).parameters)[bound:], name
    end = f" -> {back}" if back and back != "None" else ""
    call = f"{name}({', '.join(parts)}){end}"
    if len(call) > 100:
        call = f"{name}(\n" + "".join(f"    {part},\n" for part in parts) + f"){end}"
    return ["```python", call, "```", ""]


def prose(text: str) -> str:
    """Markdown of a docstring's text: its code stays code, and nothing else is taken for marks."""
    pieces = re.split(r"(``.+?``|`[^`]+`|\*\w+\*)", text, flags=re.DOTALL)
    for k, piece in enumerate(pieces):
        if k % 2 == 0:
            pieces[k] = re.sub(r"\*|<(?=\w)", r"\\\g<0>", piece)
        elif piece.startswith("`"):
            pieces[k] = f"`{piece.strip('`')}`"
    return "".join(pieces)


def described(doc: str) -> list[str]:
    """A docstring in Markdown, its sections as lists."""
    lines: list[str] = []
    section = ""
    for line in doc.splitlines():
        if title := re.fullmatch(r"(Args|Attributes|Raises|Returns):", line):
            section = {"Args": "Arguments"}.get(title[1], title[1])
            lines += [f"{section}:", ""]
        elif line and not line.startswith(" "):
            section = ""
            lines.append(line)
        elif section in ("", "Returns"):
            lines.append(line.removeprefix("    ") if section else line)
        elif item := re.fullmatch(r"    (\w+(?:, \w+)*): (.*)", line):
            names = ", ".join(f"`{name}`" for name in item[1].split(", "))
            lines.append(f"- {names}: {item[2]}")
        else:
            lines.append(f"  {line.strip()}" if line.strip() else "")
    return [*prose("\n".join(lines)).splitlines(), ""]


def members(thing: type, entries: set[Any]) -> tuple[list[tuple[str, Any]], dict[str, list[str]]]:
    """Public members that have a docstring, by name: those described here, and those of classes with entries."""
    own, told = [], {}
    for name in sorted(n for n in dir(thing) if not n.startswith("_")):
        home = next(k for k in thing.__mro__ if name in vars(k))
        member = vars(home)[name]
        known = isinstance(member, (property, cached_property, classmethod, staticmethod)) or inspect.isfunction(member)
        if not home.__module__.startswith("wakefold") or not known or not inspect.getdoc(getattr(thing, name)):
            continue
        if home is not thing and home in entries:
            told.setdefault(home.__name__, []).append(name)
        else:
            own.append((name, member))
    return own, told


def entry(shown: str, name: str, thing: Any, depth: int, entries: set[Any]) -> list[str]:
    """One class with its members, or one function."""
    lines = [f"{'#' * depth} {name}", "", *signature(shown, thing), *described(inspect.getdoc(thing) or "")]
    if not inspect.isclass(thing):
        return lines
    own, told = members(thing, entries)
    for base, names in told.items():
        lines += [f"From `{base}`: " + ", ".join(f"`{n}`" for n in names) + ".", ""]
    if any(isinstance(member, (property, cached_property)) for _, member in own):
        lines += ["Properties:", ""]
    for inner, member in own:
        if isinstance(member, (property, cached_property)):
            getter = member.fget if isinstance(member, property) else member.func
            kind = of_function(getter, True, thing)[1]
            first, *rest = described(inspect.getdoc(getter) or "")
            lines += [f"- `{parameter(inner, kind, None)}`: {first}", *(f"  {x}" if x else "" for x in rest[:-1])]
    if lines[-1]:
        lines.append("")
    for inner, member in own:
        if not isinstance(member, (property, cached_property)):
            called = getattr(thing, inner)
            bound = not isinstance(member, staticmethod)
            lines += [f"{'#' * (depth + 1)} {name}.{inner}", ""]
            lines += signature(f"{name}.{inner}", getattr(called, "__func__", called), bound, thing)
            lines += described(inspect.getdoc(called) or "")
    return lines


def package_of(thing: Any) -> str:
    return thing.__module__.split(".")[1]


def headings(text: str) -> dict[str, str]:
    """Headings of a page, and what links to them end in, as GitHub makes them."""
    found: dict[str, str] = {}
    for title in re.findall(r"^#+ (.*)", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE):
        shown = re.sub(r"\[(.*?)\]\(.*?\)", r"\1", title)
        slug = re.sub(r"[^\w\- ]", "", shown.lower()).replace(" ", "-")
        count = sum(re.sub(r"-\d+$", "", other) == slug for other in found.values())
        found.setdefault(title, f"{slug}-{count}" if count else slug)
    return found


def linked(text: str, page: str, places: dict[str, str]) -> str:
    """A page on which the first mention of another entry in every part leads there."""
    parts = re.split(r"(^#+ [^\n]*|```.*?```)", text, flags=re.DOTALL | re.MULTILINE)
    title, known = "", set()
    for k, part in enumerate(parts):
        if part.startswith("#"):
            title, known = part.lstrip("# "), set()
        elif not part.startswith("```"):

            def link(found: re.Match[str], title: str = title, known: set[str] = known) -> str:
                name = found[1]
                if name not in places or not name[0].isupper() or name in known or title.startswith(name):
                    return found[0]
                known.add(name)
                return f"[`{name}`]({places[name].removeprefix(page)})"

            parts[k] = re.sub(r"(?<!\[)`([\w.]+)`", link, part)
    return "".join(parts)


def pages() -> dict[str, str]:
    """All pages: path below docs/ -> text."""
    face = {name: getattr(wakefold, name) for name in wakefold.__all__}
    parts: dict[str, list[tuple[str, Any, list[str]]]] = {}
    for package, listed in MORE.items():
        for title, where, names in listed:
            module = import_module(f"wakefold.{where}")
            names = names or [n for n in module.__all__ if n not in face]
            parts.setdefault(package, []).append((title, module, names))
    entries = {*face.values(), *(getattr(m, n) for p in parts.values() for _, m, names in p for n in names)}
    made = {}
    index = [
        "# API reference",
        "",
        "Made from the source by `python docs/make_api.py`: a page for each package. `wf` is `import wakefold as wf`.",
        "Lengths are metres, times seconds UTC; `(N, d)` is the shape of an array.",
        "",
        *TYPES.splitlines(),
        "",
    ]
    packages = "io tracks model evidence filters forecast relations plot experiments base"
    for package in packages.split():
        about = prose(inspect.getdoc(import_module(f"wakefold.{package}")) or "")
        own = [(f"wf.{name}", name, thing) for name, thing in face.items() if package_of(thing) == package]
        lines = [f"# wakefold.{package}", "", about, "", "[All pages](../api.md)", ""]
        for shown, name, thing in own:
            lines += entry(shown, name, thing, 2, entries)
        for title, module, names in parts.get(package, []):
            lines += [f"## {title}", "", f"From `{module.__name__}`.", ""]
            for name in names:
                lines += entry(name, name, getattr(module, name), 3, entries)
        text = "\n".join(lines).rstrip() + "\n"
        made[f"{package}.md"] = re.sub(r"\n{3,}", "\n\n", text)
        slugs = headings(text)

        def brief(shown: str, name: str, thing: Any, slugs: dict[str, str] = slugs, page: str = package) -> str:
            sentence = re.split(r"(?<=\.)\s", inspect.getdoc(thing) or "", maxsplit=1)[0]
            return f"- [`{shown}`](api/{page}.md#{slugs[name]}): {prose(' '.join(sentence.split()))}"

        index += [f"## [{package}](api/{package}.md)", "", about.splitlines()[0], ""]
        index += [brief(*row) for row in own]
        for title, module, names in parts.get(package, []):
            index += ["", f"{title}, `{module.__name__}`:", ""]
            index += [brief(name, name, getattr(module, name)) for name in names]
        index.append("")
    places = {name: f"{page}#{slug}" for page, text in made.items() for name, slug in headings(text).items()}
    return {"api.md": re.sub(r"\n{3,}", "\n\n", "\n".join(index)).rstrip() + "\n"} | {
        f"api/{page}": linked(text, page, places) for page, text in made.items()
    }


def main() -> None:
    made = pages()
    (DOCS / "api").mkdir(exist_ok=True)
    for old in (DOCS / "api").glob("*.md"):
        if f"api/{old.name}" not in made:
            old.unlink()
    for name, text in made.items():
        (DOCS / name).write_text(text)


if __name__ == "__main__":
    if sys.argv[1:]:
        sys.exit(__doc__)
    main()
