"""The documentation says what the code says."""

import pkgutil
import re
import runpy
import tomllib
from pathlib import Path

import pytest

import wakefold

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
API = runpy.run_path(str(DOCS / "make_api.py"))
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md")])


def test_the_api_reference_is_what_the_source_says():
    made = API["pages"]()
    assert {p.relative_to(DOCS).as_posix() for p in DOCS.rglob("api/*.md")} == made.keys() - {"api.md"}
    for name, text in made.items():
        assert (DOCS / name).read_text() == text, "run: python docs/make_api.py"
        assert "ForwardRef" not in text
    everything = "".join(made.values())
    assert [name for name in wakefold.__all__ if f"\n## {name}\n" not in everything] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page):
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target, part in re.findall(r"\]\(([^)#\s]*)(?:#([^)]*))?\)", text):
        if "://" not in target:
            other = page.parent / target if target else page
            assert other.exists(), f"{page.name} links to {target}"
            if part:
                assert part in API["headings"](other.read_text()).values(), f"{page.name} links to {target}#{part}"


def test_the_map_of_the_packages_is_what_they_import():
    """Where it fails: mend the table of docs/design.md, and run python docs/house.py."""
    house = runpy.run_path(str(DOCS / "house.py"))
    rows = re.findall(r"^\| `(\w+)` \| (.*?) ?\|", (DOCS / "design.md").read_text(), re.MULTILINE)
    assert {package: re.findall(r"\w+", on) for package, on in rows} == house["stands_on"]()
    assert house["ROOMS"].keys() == dict(rows).keys()


NAMING = [*(p for p in PAGES if p.name != "CHANGELOG.md"), *sorted(ROOT.glob("benchmarks/*.py"))]


@pytest.mark.parametrize("page", NAMING, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_what_is_named_is_there(page):
    """Modules and what is imported from them, also by the scripts inside benchmarks. (The changes name what was.)"""
    text = page.read_text()
    for name in re.findall(r"\bwakefold(?:\.(?!X\b)\w+)+", text):
        assert pkgutil.resolve_name(name) is not None
    for line in re.findall(r"^(?:from|import) wakefold\b.*[^(]$", text, re.MULTILINE):
        exec(line, {})


def test_the_snippet_of_the_readme_runs_in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (snippet,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    said: dict = {}
    exec(snippet, said)
    assert sum(row.probability for row in said["belief"].level(500.0)) == pytest.approx(1.0)
    assert not list(tmp_path.iterdir())


def test_the_version_is_the_same_everywhere():
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"] == wakefold.__version__
