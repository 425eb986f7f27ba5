"""The code of the pages runs from top to bottom and prints what they say it prints."""

import contextlib
import io
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[1] / "docs"


@pytest.mark.parametrize(
    ("page", "codes", "texts"), [("tutorial", 8, 6), ("relational", 3, 3), ("rendezvous", 1, 0), ("tracks", 1, 0)]
)
def test_the_page_prints_what_it_says(
    page: str, codes: int, texts: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = DOCS / f"{page}.md"
    blocks = re.findall(r"^```(python|text)\n(.*?)^```", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert sum(kind == "python" for kind, _ in blocks) >= codes
    names: dict = {}
    printed, compared = "", 0
    for kind, block in blocks:
        if kind == "text":
            assert printed == block
            printed, compared = "", compared + 1
            continue
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            exec(compile(block, str(path), "exec"), names)
        printed += out.getvalue()
    assert printed == ""
    assert compared >= texts
    if page == "tutorial":
        assert (tmp_path / "ferries.png").stat().st_size > 10_000
