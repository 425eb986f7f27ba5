"""What the experiments that compare filters share: a grid of settings and methods, its tables, charts and verdicts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from wakefold import plot
from wakefold.base.types import Floats
from wakefold.experiments.mhpf.scenarios import Setting
from wakefold.experiments.mhpf.simulate import Method, Scores, job, scores
from wakefold.experiments.registry import Claim, Job, Picture, Size, Table
from wakefold.experiments.stats import (
    half_width,
    mean_text,
    number,
    p_text,
    ratio_interval,
    ratio_text,
    scenario_means,
    wilcoxon,
)
from wakefold.plot.canvas import styled

Found = Mapping[tuple[Setting, Method], Scores]
HOLDS, DEPENDS, FAILS = "holds", "depends on open choices", "does not hold"

PUBLISHED = (Method("mhpf", "log", "arxiv2016"), Method("mhpf", "log", "gsi2017"))
BL1, BL1_COARSE, BL2 = Method("bl1"), Method("bl1+coarse"), Method("bl2")
LOG = (*PUBLISHED, BL1, BL1_COARSE, BL2)
MATCHED = tuple(method._replace(likelihood="gaussian") for method in LOG)
CALIBRATED = Method("calibrated", "gaussian")
METHODS = (*LOG, *MATCHED, CALIBRATED)
NAMING = tuple(method for method in METHODS if method.filter != "bl2")  # BL2 tells no classes apart
LOOKS = {  # colour, marker
    "mhpf arxiv2016": ("#b2182b", "o"),
    "mhpf gsi2017": ("#ef8a62", "s"),
    "bl1 ": ("#2166ac", "D"),
    "bl1+coarse ": ("#67a9cf", "v"),
    "bl2 ": ("#6b7780", "x"),
    "calibrated ": ("#117733", "*"),
}


def jobs(settings: Iterable[Setting], methods: Sequence[Method], size: Size, stack: bool = False) -> list[Job]:
    """One job for each method under each setting."""
    return [job(setting, method, size, stack) for setting, method in product(settings, methods)]


def found(settings: Iterable[Setting], methods: Sequence[Method], results: Sequence[Any]) -> dict:
    """Scores by (setting, method), from the results of ``jobs``."""
    return dict(zip(product(settings, methods), map(scores, results), strict=True))


def means(table: Found, setting: Setting, method: Method, score: str) -> Floats:
    """``(scenarios,)`` means of a score."""
    return scenario_means(getattr(table[setting, method], score))


def both(out: bool, inside: bool) -> str:
    """The verdict on a claim that holds or not with the truth left out of the model, and with it inside."""
    return HOLDS if out and inside else DEPENDS if out or inside else FAILS


def score_table(
    table: Found,
    settings: Sequence[Setting],
    methods: Sequence[Method],
    score: str,
    caption: str,
    columns: Mapping[str, Callable[[Setting], str]],
) -> Table:
    """A row for each setting: what ``columns`` say of it, then each method's mean ± half its 95 % interval."""
    head = [*columns, *(method.name for method in methods)]
    rows = [
        [
            *(text(setting) for text in columns.values()),
            *(mean_text(means(table, setting, method, score)) for method in methods),
        ]
        for setting in settings
    ]
    return Table(caption, head, rows)


NOISE: dict[str, Callable[[Setting], str]] = {
    "truth": lambda s: {"out": "left out", "in": "in the model"}[s.truth],
    "κ": lambda s: f"{s.kappa:.0%}",
    "ψ": lambda s: f"{s.psi:.0%}",
}


@styled
def _chart(
    table: Found,
    panels: Mapping[str, Sequence[Setting]],
    methods: Sequence[Method],
    score: str,
    label: str,
    scale: Literal["linear", "log"],
) -> Figure:
    figure = Figure(figsize=(2.6 * len(panels) + 1.2, 3.4), layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for ax, (title, settings) in zip(axes, panels.items(), strict=True):
        for k, method in enumerate(methods):
            colour, marker = LOOKS[f"{method.filter} {method.rule}"]
            values = [means(table, setting, method, score) for setting in settings]
            at = np.arange(len(settings)) + 0.09 * (k - 0.5 * (len(methods) - 1))
            dashed = method.likelihood != "log" and method.filter != "calibrated"
            ax.errorbar(
                at,
                [v.mean() for v in values],
                [half_width(v) for v in values],
                color=colour,
                marker=marker,
                markersize=4.5,
                linewidth=0.8,
                linestyle=":" if dashed else "-",
                markerfacecolor="white" if dashed else colour,
                elinewidth=0.7,
                label=method.name,
            )
        ax.set_xticks(range(len(settings)), [f"{s.kappa:.0%}" for s in settings])
        ax.set_xlabel("noise of the dynamics κ")
        ax.set_title(title)
        if scale == "log":  # an interval that reaches below zero is cut
            ax.set_yscale("log", nonpositive="clip")
        else:
            ax.set_ylim(bottom=0)
        ax.grid(axis="y", linewidth=0.3)
    axes[0].set_ylabel(label)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def chart(
    table: Found,
    settings: Sequence[Setting],
    methods: Sequence[Method],
    score: str,
    label: str,
    path: Path,
    caption: str,
    columns: Mapping[str, Callable[[Setting], str]],
    scale: Literal["linear", "log"] = "linear",
) -> Picture:
    """A score over κ, a panel for all else that ``columns`` say of settings, with 95 % intervals over scenarios."""
    panels: dict[str, list[Setting]] = {}
    for setting in settings:
        title = ", ".join(f"{name} {text(setting)}" for name, text in columns.items() if name != "κ")
        panels.setdefault(title, []).append(setting)
    plot.save(_chart(table, panels, methods, score, label, scale), path)
    return Picture(path, caption, min(1080, 280 * len(panels) + 130))


class Paired(NamedTuple):
    """Two methods over some settings, paired by scenario.

    Attributes:
        below: in how many settings the mean of the first is the lower. of: settings.
        ratio: of the means over all settings, with its interval, as text.
        p: of the scenarios' means over all settings.
    """

    below: int
    of: int
    ratio: str
    p: float

    @property
    def text(self) -> str:
        """For the page."""
        return f"below in {self.below} of {self.of}, ratio {self.ratio}"


def paired(table: Found, settings: Sequence[Setting], a: Method, b: Method, score: str) -> Paired:
    """How much lower a method's score is than another's."""
    x, y = (np.array([means(table, s, m, score) for s in settings]) for m in (a, b))
    below = int((x.mean(axis=1) < y.mean(axis=1)).sum())
    return Paired(
        below, len(settings), ratio_text(x.mean(axis=0), y.mean(axis=0)), wilcoxon(x.mean(axis=0), y.mean(axis=0))
    )


def claim_calibrated(table: Found, settings: Sequence[Setting], score: str, what: str, bound: float) -> Claim:
    """That in each setting ``calibrated`` is at most a share of the better published rule; ours, not the papers'."""
    shares, p = [], 0.0
    for setting in settings:
        best = min((means(table, setting, m, score) for m in PUBLISHED), key=lambda x: float(x.mean()))
        ours = means(table, setting, CALIBRATED, score)
        shares.append(ratio_interval(ours, best))
        p = max(p, wilcoxon(ours, best))
    return Claim(
        f"calibrated: {what} at most {bound:g} of the better published rule's, in each setting, truth left out",
        "no such filter",
        ", ".join("{} [{}, {}]".format(*map(number, share)) for share in shares),
        f"largest {p_text(p)}",
        HOLDS if all(share[0] <= bound for share in shares) else FAILS,
    )


def claims_below(
    table: Found, settings: Sequence[Setting], score: str, what: str, published: str, level: float
) -> list[Claim]:
    """That each published rule is below BL1 in all settings, and whether it is below BL1+coarse, which is fair.

    ``settings`` are those with the truth left out; with the truth in the model they are judged as well.
    """
    out = []
    for other, says in ((BL1, published), (BL1_COARSE, "not compared")):
        for mhpf in PUBLISHED:
            found = [
                paired(table, [s._replace(truth=truth) for s in settings], mhpf, other, score)
                for truth in ("out", "in")
            ]
            out.append(
                Claim(
                    f"{what}: MHPF {mhpf.rule} below {other.name.removesuffix(' log')}",
                    says,
                    "; ".join(
                        f"{f.text} ({where})" for f, where in zip(found, ("left out", "in the model"), strict=True)
                    ),
                    "; ".join(p_text(f.p) for f in found),
                    both(*(f.below == f.of and f.p <= level for f in found)),
                )
            )
    return out
