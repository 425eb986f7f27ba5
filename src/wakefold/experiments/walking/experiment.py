"""People walking together: the experiment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from wakefold.experiments.registry import Job, Section, Size
from wakefold.experiments.walking.pedestrians import SCENES
from wakefold.experiments.walking.trials import WHERE, data_directory

TITLE = "Real people: who walks with whom"


def jobs(size: Size) -> list[Job]:
    root = data_directory()
    if root is None:
        return []
    return [Job("walking.trials:judge", {"root": str(root), "scene": name, "seed": size.seed}) for name in SCENES]


def report(results: list[Any], size: Size, folder: Path) -> Section:
    if not results:
        return Section(TITLE, [f"Not run: the data is not there. {WHERE} must name OpenTraj's directory of datasets."])
    from wakefold.experiments.walking.report import section

    return section(TITLE, results, folder)
