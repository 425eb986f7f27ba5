"""The tutorial's code runs from top to bottom and prints what the page says it prints."""

import contextlib
import io
import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[1] / "docs" / "tutorial.md"


def test_the_tutorial_prints_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```(python|text)\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert sum(kind == "python" for kind, _ in blocks) >= 8
    names: dict = {}
    printed, compared = "", 0
    for kind, block in blocks:
        if kind == "text":
            assert printed == block
            printed, compared = "", compared + 1
            continue
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            exec(compile(block, str(PAGE), "exec"), names)
        printed += out.getvalue()
    assert printed == ""
    assert compared >= 6
    assert (tmp_path / "ferries.png").stat().st_size > 10_000
