"""Runs jobs on all cores and keeps every result on disk, so that an interrupted run goes on where it stopped."""

from __future__ import annotations

import ast
import hashlib
import json
import os
import time
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from wakefold.base.parallel import Executor
from wakefold.experiments.registry import Job

SOURCE = Path(__file__).parents[1]


@cache
def code_digest(module: str) -> str:
    """Of the source of a module of ``wakefold.experiments`` and of all of Wakefold that it imports, directly or not.

    Results of other code are not taken up again; code that no result depends on, such as pages, may change.
    """
    # The package itself is left out: it offers everything.
    digest, seen, waiting = hashlib.sha256(), {"wakefold"}, [f"wakefold.experiments.{module}"]
    while waiting:
        name = waiting.pop()
        file = SOURCE.joinpath(*name.split(".")[1:])
        file = file / "__init__.py" if file.is_dir() else file.with_suffix(".py")
        if name in seen or not file.exists():
            continue
        seen.add(name)
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("wakefold"):
                waiting += [node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)]
            elif isinstance(node, ast.Import):
                waiting += [alias.name for alias in node.names if alias.name.startswith("wakefold")]
    for name in sorted(seen - {"wakefold"}):
        file = SOURCE.joinpath(*name.split(".")[1:])
        digest.update(f"{name}\n".encode())
        digest.update((file / "__init__.py" if file.is_dir() else file.with_suffix(".py")).read_bytes())
    return digest.hexdigest()


def key(job: Job) -> str:
    """Name of a job's result: a hash of all it depends on."""
    text = json.dumps([code_digest(job.run.split(":")[0]), job.run, job.spec], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def run_all(
    jobs: Sequence[Job], kept: Path, executor: Executor, progress: Callable[[float], None] | None = None
) -> list[Any]:
    """Results of the jobs, in their order; each different job runs once, and not at all if its result is kept.

    Args:
        kept: directory of results, one JSON file each, with the CPU seconds it took; made if need be.
        progress: called with the share of the cost that is done.
    """
    kept.mkdir(parents=True, exist_ok=True)
    files = [kept / f"{key(job)}.json" for job in jobs]
    todo = {file: job for file, job in zip(files, jobs, strict=True) if not file.exists()}
    # The dearest first, so that no core waits long for the last one; jobs alike stay together, as they share models.
    ordered = sorted(todo.items(), key=lambda item: -item[1].cost)
    executor.map(_run, [(job.run, dict(job.spec), str(file)) for file, job in ordered], progress=progress)
    return [json.loads(file.read_text())["result"] for file in files]


def seconds(jobs: Sequence[Job], kept: Path) -> float:
    """CPU time that jobs took, each different one counted once; those of ``kept`` that ``run_all`` has done."""
    return sum(json.loads((kept / f"{name}.json").read_text())["seconds"] for name in {key(job) for job in jobs})


def _run(item: tuple[str, dict[str, Any], str]) -> None:
    name, spec, file = item
    module, function = name.split(":")
    run, begin = getattr(import_module(f"wakefold.experiments.{module}"), function), time.thread_time()
    result = run(spec)
    unfinished = Path(f"{file}.{os.getpid()}")
    unfinished.write_text(json.dumps({"seconds": time.thread_time() - begin, "result": result}, allow_nan=False))
    unfinished.replace(file)
