"""The directory that tests of the command line work in."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from room import fixes, harbour, people, run


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A directory with the files that the examples name, as the current one."""
    path = tmp_path_factory.mktemp("room")
    for name, text in {
        "harbour.csv": harbour(),
        "monday.csv": harbour(),
        "tuesday.csv": harbour(0.0001).replace("ship", "boat"),
        "wednesday.csv": harbour(0.0002).replace("2020-12-0", "2020-12-1"),
        "held-out.csv": harbour(0.0002).replace("ship", "later"),
        "people.csv": people(),
        "fixes.csv": fixes(),
    }.items():
        (path / name).write_text(text)
    before = Path.cwd()
    os.chdir(path)
    try:
        assert run("learn harbour.csv -o harbour.model")[0] == 0
        yield path
    finally:
        os.chdir(before)
