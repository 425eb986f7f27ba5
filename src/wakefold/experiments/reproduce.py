"""``wakefold reproduce``: runs the experiments and writes the page."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from wakefold.base.parallel import Executor
from wakefold.experiments.page import page
from wakefold.experiments.registry import FIGURES, Section, Size, experiment
from wakefold.experiments.runner import run_all, seconds


def reproduce(
    names: Sequence[str],
    size: Size,
    out: Path,
    executor: Executor,
    progress: Callable[[float], None] | None = None,
    say: Callable[[str], None] = print,
) -> Path:
    """Run experiments and write ``out/index.html``, with the pictures and all results beside it.

    Args:
        names: of ``FIGURES``; all of them when empty.
        out: directory; results of an earlier run of the same code are taken up from its ``results``.

    Returns:
        the page.

    Raises:
        ValueError: an unknown name.
    """
    begin = time.monotonic()
    chosen = [(name, experiment(name)) for name in (names or FIGURES)]
    out.mkdir(parents=True, exist_ok=True)
    work = {name: module.jobs(size) for name, module in chosen}
    results = run_all([job for jobs in work.values() for job in jobs], out / "results", executor, progress)
    sections: list[Section] = []
    taken = 0
    for name, module in chosen:
        own: list[Any] = results[taken : taken + len(work[name])]
        taken += len(own)
        section = module.report(own, size, out)
        if own:
            spent = seconds(work[name], out / "results")
            section = section._replace(notes=[*section.notes, f"The runs took {spent:.0f} seconds of CPU time."])
        sections.append(section)
        for claim in sections[-1].claims:
            verdict = "" if size.quick or not claim.verdict else f" [{claim.verdict}]"
            say(f"{name}: {claim.claim}: {claim.ours}{f'; {claim.test}' if claim.test else ''}{verdict}")
    if size.quick:
        sections = [s._replace(claims=[c._replace(verdict="") for c in s.claims]) for s in sections]
    target = out / "index.html"
    target.write_text(page(sections, size, time.monotonic() - begin), encoding="utf-8")
    return target
