"""The blind spot experiment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from wakefold.experiments.blindspot.scenes import SCENES
from wakefold.experiments.registry import Job, Section, Size

TITLE = "Three people through a blind spot (relational filter, second experiment)"


def jobs(size: Size) -> list[Job]:
    """A job for each scene: 100 of each sort, or 2 when quick."""
    seeds = range(2 if size.quick else 100)
    return [Job("blindspot.trials:run", {"scene": s, "seed": size.seed + k}, cost=1.0) for s in SCENES for k in seeds]


def report(results: list[Any], size: Size, folder: Path) -> Section:
    """Errors of both filters in each sort of scene, and one scene drawn."""
    from wakefold.experiments.blindspot.report import section

    by_scene: dict[str, list[dict[str, Any]]] = {}
    for job, result in zip(jobs(size), results, strict=True):
        by_scene.setdefault(job.spec["scene"], []).append(result)
    return section(TITLE, by_scene, folder, size.seed)
