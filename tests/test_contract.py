"""The house rules: an ordered list of packages, no circles, small files; importing is light, nothing is pickled."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cached_property
from importlib import import_module
from pathlib import Path

import pytest

import wakefold
from wakefold.base.remember import Remembers

SOURCE = Path(wakefold.__file__).parent
TESTS = Path(__file__).parent
# From the bottom of the house to the top: a package imports only packages that stand before it.
PACKAGES = [
    "base",
    "tracks",
    "io",
    "model",
    "plot",
    "relations",
    "evidence",
    "filters",
    "forecast",
    "experiments",
    "service",
    "cli",
]
AT_THE_TOP = {"__init__", "__main__", *PACKAGES}
LONGEST = 400  # lines of a file
# fmt: off
PUBLIC = {  # what stands here once stays
    "Activity", "BL1", "BL2", "Belief", "Calibrated", "CoarseClass", "Confusion", "ConstantVelocity", "Detections",
    "Deviation", "Filtration", "Fix", "GaussianHMM", "MHPF", "Model", "PairEvidence", "Relation", "RelationalFilter",
    "RelationalModel", "Sampler", "Scene", "Scores", "Tracks", "Trail", "frechet", "frechet_matrix", "learn", "load",
    "read_tracks", "score", "write_tracks",
}
# fmt: on


def files() -> list[Path]:
    return sorted(SOURCE.rglob("*.py"))


def imported(file: Path, source: Path = SOURCE) -> Iterator[Path]:
    """Files of the package that a file imports, anywhere in it, imports for typing too."""
    for node in ast.walk(ast.parse(file.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{file}: imports are absolute"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        for name in names:
            parts = name.split(".")
            if parts.pop(0) != "wakefold":
                continue
            while True:  # the last part may be a name inside a file
                path = source.joinpath(*parts)
                if found := next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.exists()), None):
                    yield found
                    break
                parts.pop()


def upwards(source: Path) -> list[str]:
    """Imports of a higher package, or of the face of the whole by what stands below the command line."""
    wrong = []
    for file in sorted(source.rglob("*.py")):
        own = file.relative_to(source).parts[0]
        for other in imported(file, source):
            theirs = other.relative_to(source).parts[0]
            if own not in PACKAGES or theirs == own:
                continue
            if theirs not in PACKAGES:
                fine = own == "cli" and theirs == "__init__.py"
            else:
                fine = PACKAGES.index(theirs) < PACKAGES.index(own)
            if not fine:
                wrong.append(f"{file.relative_to(source)} imports {other.relative_to(source)}")
    return wrong


def circles(source: Path) -> list[str]:
    """Files from which a path of imports leads back to them."""
    to = {file: set(imported(file, source)) - {file} for file in sorted(source.rglob("*.py"))}
    free = dict(to)
    while leaves := [file for file, others in free.items() if not others & free.keys()]:
        for file in leaves:
            del free[file]
    # What is left imports a circle or is in one; what nobody left imports only leads there.
    while tops := [file for file in free if not any(file in to[other] for other in free if other != file)]:
        for file in tops:
            del free[file]
    return [str(file.relative_to(source)) for file in free]


def test_packages_import_downwards_only():
    assert not upwards(SOURCE)


def test_no_files_import_each_other_in_a_circle():
    assert not circles(SOURCE)


def test_the_rules_see_what_they_forbid(tmp_path):
    for name in ("base", "tracks", "io"):
        (tmp_path / name).mkdir()
    (tmp_path / "__init__.py").write_text("")
    (tmp_path / "base/a.py").write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from wakefold.base import b\n"
    )
    (tmp_path / "base/b.py").write_text("def f():\n    import wakefold.base.a\n")
    (tmp_path / "tracks/c.py").write_text("from wakefold.io.d import x\n")
    (tmp_path / "io/d.py").write_text("import wakefold\nx = 1\n")
    (tmp_path / "io/e.py").write_text("from wakefold.base.a import b\n")
    assert circles(tmp_path) == ["base/a.py", "base/b.py"]
    assert upwards(tmp_path) == ["io/d.py imports __init__.py", "tracks/c.py imports io/d.py"]


def test_nothing_else_stands_at_the_top():
    there = {p.stem for p in SOURCE.iterdir() if p.name not in ("py.typed", "__pycache__")}
    assert there == AT_THE_TOP


def test_tests_stand_where_the_code_does():
    assert {p.name for p in TESTS.iterdir() if p.is_dir() and list(p.glob("test_*.py"))} <= set(PACKAGES)


def test_files_are_small():
    every = [*files(), *TESTS.rglob("*.py"), *TESTS.parent.joinpath("benchmarks").glob("*.py")]
    assert not {str(file): n for file in every if (n := len(file.read_text().splitlines())) > LONGEST}


def test_filters_do_not_import_one_another():
    shared = {"belief.py", "levels.py", "particles.py", "resampling.py", "sets.py", "trails.py", "__init__.py"}
    filters = {f for f in (SOURCE / "filters").glob("*.py") if f.name not in shared}
    for file in filters:
        assert not filters & set(imported(file)), file.name


def kernels() -> list[Path]:
    return [f for f in files() if f.name == "kernels.py" or f.parent.name == "kernels" or f.parent.name == "base"]


def test_compiled_code_stands_in_kernels_and_knows_only_kernels():
    for file in files():
        if "base/compile.py" in {str(other.relative_to(SOURCE)) for other in imported(file)}:
            assert file in kernels(), f"{file} compiles, and is no kernels.py nor in a folder kernels/"
    for file in kernels():
        if file.parent.name != "base":
            assert set(imported(file)) <= set(kernels()), file


def test_functions_without_a_wrapper_are_called_by_kernels_only():
    """Python code that calls an ``inner`` function takes the interpreter down with it."""
    inner: dict[Path, set[str]] = {}
    for file in kernels():
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.FunctionDef) and {"inner", "ordered_inner"} & {
                ast.unparse(d) for d in node.decorator_list
            }:
                inner.setdefault(file, set()).add(node.name)
    assert "mean_velocity" in set().union(*inner.values())
    others = [f for f in files() if f not in kernels()]
    others += [*TESTS.rglob("*.py"), *TESTS.parent.joinpath("benchmarks").glob("*.py")]
    for file in others:
        tree, modules = ast.parse(file.read_text()), {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("wakefold."):
                base = SOURCE.joinpath(*(node.module or "").split(".")[1:])
                for alias in node.names:
                    assert alias.name not in inner.get(base.with_suffix(".py"), ()), (file, alias.name)
                    modules[alias.asname or alias.name] = inner.get((base / alias.name).with_suffix(".py"), set())
        compiled = {"kernel", "njit"}  # a test may compile a kernel of its own
        functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
        own = [f for f in functions if {ast.unparse(d) for d in f.decorator_list} & compiled]
        called = {id(inside) for function in own for inside in ast.walk(function)}
        for node in ast.walk(tree):
            if id(node) not in called and isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                assert node.attr not in modules.get(node.value.id, ()), (file, node.attr)


def test_importing_wakefold_imports_nothing_heavy():
    heavy = ["numba", "scipy", "pyarrow", "pyproj", "matplotlib", "pyais", "numpy"]
    code = f"import sys, wakefold; print([m for m in {heavy} if m in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def promises(face: Path) -> tuple[dict[str, str], dict[str, str]]:
    """Module of each public name by the imports for typing, and by the table of what is looked up on first use."""
    typed, looked_up = {}, {}
    for node in ast.parse(face.read_text()).body:
        if isinstance(node, ast.If):
            for line in node.body:
                assert isinstance(line, ast.ImportFrom)
                typed |= {alias.asname or alias.name: line.module for alias in line.names}
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "_WHERE":
            looked_up = {name: f"wakefold.{module}" for name, module in ast.literal_eval(node.value).items()}
    return typed, looked_up


def test_everything_promised_is_there():
    """The list is written out: a name that is left out of the face by mistake must be missed."""
    typed, looked_up = promises(SOURCE / "__init__.py")
    assert looked_up == typed
    assert sorted(wakefold.__all__) == sorted(PUBLIC) == sorted(typed)
    assert set(dir(wakefold)) >= PUBLIC
    for name, module in typed.items():
        value = getattr(wakefold, name)
        assert (value.__name__, value.__module__) == (name, module)
        assert value is getattr(import_module(module), name)
    with pytest.raises(AttributeError, match="'wakefold' has no attribute 'nothing'"):
        wakefold.nothing  # noqa: B018


def test_nothing_is_pickled_or_evaluated():
    for file in files():
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                names = [a.name for a in node.names] + [getattr(node, "module", None) or ""]
                assert not {"pickle", "marshal", "shelve", "dill", "cloudpickle"} & set(names), file
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("eval", "exec"), file
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                assert ast.unparse(node.value) == "False", file


def test_whoever_has_cached_properties_neither_copies_nor_pickles_what_they_hold():
    """One base does it for all: see ``wakefold.base.remember``."""
    found = set()
    for file in files():
        if "cached_property" in file.read_text() and file.name != "remember.py":
            name = ".".join(["wakefold", *file.relative_to(SOURCE).with_suffix("").parts])
            kinds = [kind for kind in vars(import_module(name)).values() if isinstance(kind, type)]
            found |= {k for k in kinds if any(isinstance(x, cached_property) for x in vars(k).values())}
    assert len(found) >= 7
    assert not [kind for kind in found if not issubclass(kind, Remembers)]
