"""Runs jobs on all cores and keeps every result on disk, so that an interrupted run goes on where it stopped."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from wakefold.experiments.registry import Job
from wakefold.parallel import Executor

SOURCE = Path(__file__).parents[1]
# What cannot change a result: pictures, pages, the command line, readers of files.
ASIDE = ("plot", "cli", "demo", "io", "export", "observations", "experiments/page", "experiments/runner")


@cache
def code_digest() -> str:
    """Of the source that results depend on: results of other code are not taken up again."""
    digest = hashlib.sha256()
    for file in sorted(SOURCE.rglob("*.py")):
        if not file.relative_to(SOURCE).as_posix().startswith(ASIDE):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def key(job: Job, digest: str) -> str:
    """Name of a job's result: a hash of all it depends on."""
    text = json.dumps([digest, job.run, job.spec], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def run_all(
    jobs: Sequence[Job], kept: Path, executor: Executor, progress: Callable[[float], None] | None = None
) -> list[Any]:
    """Results of the jobs, in their order; each different job runs once, and not at all if its result is kept.

    Args:
        kept: directory of results, one JSON file each; made if need be.
        progress: called with the share of the cost that is done.
    """
    kept.mkdir(parents=True, exist_ok=True)
    digest = code_digest()
    files = [kept / f"{key(job, digest)}.json" for job in jobs]
    todo = {file: job for file, job in zip(files, jobs, strict=True) if not file.exists()}
    # The dearest first, so that no core waits long for the last one; jobs alike stay together, as they share models.
    ordered = sorted(todo.items(), key=lambda item: -item[1].cost)
    executor.map(_run, [(job.run, dict(job.spec), str(file)) for file, job in ordered], progress=progress)
    return [json.loads(file.read_text()) for file in files]


def _run(item: tuple[str, dict[str, Any], str]) -> None:
    name, spec, file = item
    module, function = name.split(":")
    result = getattr(import_module(f"wakefold.experiments.{module}"), function)(spec)
    unfinished = Path(f"{file}.{os.getpid()}")
    unfinished.write_text(json.dumps(result, allow_nan=False))
    unfinished.replace(file)
