"""What can be reproduced, and what every experiment gives. No heavy imports: the command line reads this.

An experiment is a module with three names:

- ``TITLE``: a line of text.
- ``jobs(size) -> list[Job]``: its work, cut into pieces that run anywhere and whose results are kept on disk.
- ``report(results, size, folder) -> Section``: its part of the page, from the results in the order of the jobs;
  pictures go into ``folder``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Protocol, cast

# Name on the command line -> module, in the order of the page.
FIGURES: dict[str, str] = {
    "fig1": "mhpf.fig1",
    "fig2": "mhpf.fig2",
    "fig3": "mhpf.fig3",
    "fig5": "mhpf.fig5",
    "mse": "mhpf.mse",
    "fig6": "mhpf.fig6",
    "fig7a": "mhpf.fig7a",
    "fig7b": "mhpf.fig7b",
    "fig8": "mhpf.fig8",
    "fig9": "mhpf.fig9",
    "ablation": "mhpf.ablation",
    "walking": "walking.experiment",
    "rendezvous": "rendezvous.experiment",
    "blindspot": "blindspot.experiment",
}


class Size(NamedTuple):
    """How much is run.

    Attributes:
        scenarios, repetitions: runs are scenarios x repetitions; the papers' 10 x 25.
        tanker_scenarios: of the tanker set; the papers' 5.
        particles: N.
        tankers: the walks of the tanker set, by the name of their data; see ``rasters``.
        seed: of everything.
        quick: too few runs for a verdict.
    """

    scenarios: int = 10
    repetitions: int = 25
    tanker_scenarios: int = 5
    particles: int = 100
    tankers: str = "tankers"
    seed: int = 0
    quick: bool = False


FULL = Size()
QUICK = Size(scenarios=2, repetitions=1, tanker_scenarios=2, quick=True)


class Job(NamedTuple):
    """A piece of work.

    Attributes:
        run: "module:function" inside ``wakefold.experiments``; takes ``spec``, returns plain JSON.
        spec: all it depends on, plain JSON, seeds included.
        cost: about how long it takes; any unit, the same for all.
    """

    run: str
    spec: Mapping[str, Any]
    cost: float = 1.0


class Claim(NamedTuple):
    """A published claim beside ours, all text.

    Attributes:
        claim: what is claimed.
        published: the papers' figure.
        ours: ours, with its 95 % interval over scenarios.
        test: two-sided Wilcoxon over the means of the scenarios.
        verdict: "holds", "depends on open choices", "does not hold", or "" where nothing is claimed.
    """

    claim: str
    published: str
    ours: str
    test: str = ""
    verdict: str = ""


class Table(NamedTuple):
    """Rows of text under a head; ``caption`` says what the numbers are."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


class Picture(NamedTuple):
    """A PNG file and what it shows."""

    path: Path
    caption: str
    width: int = 900


class Section(NamedTuple):
    """An experiment's part of the page; ``text`` and ``notes`` are paragraphs, plain text."""

    title: str
    text: Sequence[str]
    pictures: Sequence[Picture] = ()
    claims: Sequence[Claim] = ()
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()


def no_jobs(size: Size) -> list[Job]:
    """Of a figure that is a picture: the report makes all of it."""
    return []


class Experiment(Protocol):
    """What a module of ``FIGURES`` offers."""

    TITLE: str

    def jobs(self, size: Size) -> list[Job]: ...
    def report(self, results: list[Any], size: Size, folder: Path) -> Section: ...


def experiment(name: str) -> Experiment:
    """The module of a figure.

    Raises:
        ValueError: no such figure; the message names those there are.
    """
    if name not in FIGURES:
        raise ValueError(f"no figure {name!r}; there are {', '.join(FIGURES)}")
    return cast(Experiment, import_module(f"wakefold.experiments.{FIGURES[name]}"))
