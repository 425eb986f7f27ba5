"""The house rules: imports point downwards only, importing is light, nothing is pickled."""

import ast
import subprocess
import sys
from pathlib import Path

import wakefold

SOURCE = Path(wakefold.__file__).parent
# From the top of the house to the bottom; modules of one storey may know each other.
STOREYS = [
    ["__main__", "cli*"],
    ["demo*"],
    ["observations", "export"],
    ["experiments.*"],
    ["plot*", "datasets"],
    ["events"],
    ["filters.*"],
    ["collapsed", "joint"],
    ["blocks", "blind"],
    ["association", "gating"],
    ["scene"],
    ["activities", "couplings"],
    ["relations_fit"],
    ["corrections"],
    ["detections", "relations"],
    ["predicates"],
    ["confusion"],
    ["particles", "deviation"],
    ["belief"],
    ["io.*"],
    ["model"],
    ["evidence"],
    ["dynamics"],
    ["filtration"],
    ["growth"],
    ["spanning"],
    ["search"],
    ["dendrogram", "distance", "features"],
    ["company", "reunion"],
    ["walkers"],
    ["logistic"],
    ["stops"],
    ["tracks", "shaping"],
    ["ragged", "sketch", "projection", "units", "smoothing", "places", "wording"],
    ["store"],
    ["parallel"],
    ["kernels.*"],
]


def modules():
    for file in sorted(SOURCE.rglob("*.py")):
        name = ".".join(file.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__")
        if name != "__init__":
            yield name, file


def storey(name):
    from fnmatch import fnmatch

    for level, patterns in enumerate(STOREYS):
        if any(fnmatch(name, p) or fnmatch(f"{name}.x", p) for p in patterns):
            return level
    raise AssertionError(f"module {name} has no place in the house: add it to STOREYS")


def imported(file, typing_too=False):
    """Modules of wakefold a file imports, anywhere in it but for typing."""
    tree = ast.parse(file.read_text())
    skipped = set()
    if not typing_too:
        for node in ast.walk(tree):
            if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
                skipped |= {id(inner) for inner in ast.walk(node)}
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        if isinstance(node, ast.Import):
            yield from (a.name.removeprefix("wakefold.") for a in node.names if a.name.startswith("wakefold."))
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "wakefold":
            inside = node.module.removeprefix("wakefold").lstrip(".")
            for alias in node.names:
                name = f"{inside}.{alias.name}".lstrip(".")
                path = SOURCE.joinpath(*name.split("."))
                if path.with_suffix(".py").exists() or path.is_dir():
                    yield name
                elif inside:
                    yield inside


def test_imports_point_downwards_only():
    wrong = [
        f"{name} imports {other}"
        for name, file in modules()
        for other in imported(file)
        if storey(other) < storey(name)
    ]
    assert not wrong, "\n".join(wrong)


def test_filters_do_not_import_one_another():
    for name, file in modules():
        if name.startswith("filters."):
            assert not [other for other in imported(file, typing_too=True) if other.startswith("filters")], name


def test_kernels_know_nothing_of_the_house():
    for name, file in modules():
        if name.startswith("kernels"):
            assert all(other.startswith("kernels") for other in imported(file, typing_too=True)), name


def test_functions_without_a_wrapper_are_called_by_kernels_only():
    """Python code that calls an ``inner`` function takes the interpreter down with it."""
    inner = {
        node.name
        for name, file in modules()
        if name.startswith("kernels.")
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.FunctionDef)
        and {"inner", "ordered_inner"} & {ast.unparse(d) for d in node.decorator_list}
    }
    assert "mean_velocity" in inner
    tests = Path(__file__).parent
    others = [file for name, file in modules() if not name.startswith("kernels")]
    for file in [*others, *tests.glob("*.py"), *tests.parent.joinpath("benchmarks").glob("*.py")]:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("wakefold.kernels."):
                assert not inner & {alias.name for alias in node.names}, file.name
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("kernel", "motion", "random"):
                assert node.attr not in inner, file.name


def test_importing_wakefold_imports_nothing_heavy():
    heavy = ["numba", "scipy", "pyarrow", "pyproj", "matplotlib", "pyais", "numpy"]
    code = f"import sys, wakefold; print([m for m in {heavy} if m in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_everything_promised_is_there():
    for name in wakefold.__all__:
        assert getattr(wakefold, name) is not None
    assert set(wakefold.__all__) <= set(dir(wakefold))


def test_nothing_is_pickled_or_evaluated():
    for name, file in modules():
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                names = [a.name for a in node.names] + [getattr(node, "module", None) or ""]
                assert not {"pickle", "marshal", "shelve", "dill", "cloudpickle"} & set(names), name
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("eval", "exec"), name
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                assert ast.unparse(node.value) == "False", name
