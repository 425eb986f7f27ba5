"""The rendezvous experiment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from wakefold.experiments.registry import Job, Section, Size
from wakefold.experiments.rendezvous.trials import CONDITIONS, FEW, MODELS

TITLE = "Rendezvous of two ships against hidden Markov models and a rule (Manfredotti et al. 2011, Section 3)"


def jobs(size: Size) -> list[Job]:
    """A job for each split of each condition: 100, or 2 of the first when quick."""
    conditions = list(CONDITIONS)[:1] if size.quick else list(CONDITIONS)
    out = []
    for name in conditions:
        models = list(MODELS) if name == conditions[0] else list(FEW)
        for k in range(2 if size.quick else 100):
            spec = {"condition": name, "split": k, "seed": size.seed, "models": models}
            out.append(Job("rendezvous.trials:split", spec, cost=float(len(models))))
    return out


def report(results: list[Any], size: Size, folder: Path) -> Section:
    """Means, spreads, paired differences, and one scene of each kind."""
    from wakefold.experiments.rendezvous.report import section

    by: dict[str, list[dict[str, Any]]] = {}
    for job, result in zip(jobs(size), results, strict=True):
        by.setdefault(job.spec["condition"], []).append(result)
    return section(TITLE, by, folder, size.seed)
