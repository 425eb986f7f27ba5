"""Tables and pictures of the experiment with real people."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wakefold import plot
from wakefold.experiments.registry import Claim, Picture, Section, Table
from wakefold.experiments.walking import trials as walking
from wakefold.experiments.walking.pedestrians import FRAME
from wakefold.experiments.walking.recalibration import Correction
from wakefold.plot.canvas import INK, PALETTE

BARS = {"eth": 0.72, "hotel": 0.85, "zara01": 0.90, "students03": 0.86}  # pairwise F1 aimed at


def section(title: str, results: list[dict[str, Any]], folder: Path) -> Section:
    """The experiment's part of the page."""
    pictures = [
        Picture(
            _reliability(results, folder / "walking-reliability.png"), "Said and true share of pairs together.", 900
        ),
    ]
    root = walking.data_directory()
    if root is not None:
        by_name = {r["scene"]: r["recognition"] for r in results}
        pictures += [
            Picture(
                _scene(str(root), "students03", by_name["students03"], folder / "walking-scene.png"),
                "People of students03 at one moment; edges are as opaque as the relation is probable.",
                900,
            ),
            Picture(
                _beliefs(str(root), "students03", by_name["students03"], folder / "walking-beliefs.png"),
                "Probability of being together over time: pairs of a group (blue) and the nearest others (grey).",
                900,
            ),
        ]
    return Section(
        title,
        [
            "Each scene is judged with constants, thresholds and settings from the other three. Pairs seen together "
            "for at least 2 s. Intervals (95 %) from drawing pairs, people or windows of time again."
        ],
        pictures,
        _claims(results),
        [_recognition(results), _online(results), _tracking(results)],
    )


def _claims(results: list[dict[str, Any]]) -> list[Claim]:
    out: list[Claim] = []
    for r in results:
        name, found = r["scene"], r["recognition"]
        bar = min(BARS[name], 0.95 * found["own_labels"])
        best = max(found["f1"]["rule"], found["f1"]["logistic"])
        ours = found["f1"]["relation"]
        holds = ours >= bar and ours > best
        out.append(
            Claim(
                f"{name}: who is with whom, F1",
                f"at least {bar:.2f} and above the rivals",
                f"{_with(ours, found['interval']['relation'])}; best rival {best:.3f}",
                "",
                "holds" if holds else "does not hold",
            )
        )
    worst = max(r["recognition"]["calibration"]["ece"] for r in results)
    skill = min(r["recognition"]["calibration"]["skill"] for r in results)
    out.append(
        Claim(
            "Calibration, pairs ever within 3 m",
            "expected error at most 0.05, skill above 0",
            f"largest error {worst:.3f}, least skill {skill:.2f}",
            "",
            "holds" if worst <= 0.05 and skill > 0 else "does not hold",
        )
    )
    for what, where, bar, most in (("hidden", "Hidden 4.8 s", 0.35, 0.45), ("blackout", "Blackout 8 s", 0.55, np.inf)):
        for how in ("believed", "told"):
            pooled = _pooled(results, what, how)
            each = max(r[what][how]["ratio"] for r in results)
            holds = pooled <= bar and each <= most
            out.append(
                Claim(
                    f"{where}, relations {how}: error beside that without relations",
                    f"at most {bar}",
                    f"pooled {pooled:.3f}, largest {each:.3f}",
                    "",
                    "holds" if holds else "does not hold",
                )
            )
    return out


def _pooled(results: Sequence[dict[str, Any]], what: str, how: str) -> float:
    ours, plain = np.sum([r[what][how]["sums"] for r in results], axis=0)
    return float(ours / plain)


def _with(value: float, interval: Sequence[float]) -> str:
    return f"{value:.3f} [{interval[0]:.3f}, {interval[1]:.3f}]"


def _recognition(results: list[dict[str, Any]]) -> Table:
    rows: list[list[str]] = []
    for r in results:
        x = r["recognition"]
        rows.append(
            [
                f"{r['scene']} ({x['together']} of {x['pairs']})",
                *(_with(x["f1"][k], x["interval"][k]) for k in ("relation", "rule", "logistic")),
                f"{x['own_labels']:.3f}",
                f"{x['calibration']['ece']:.3f}",
                f"{x['calibration']['skill']:.2f}",
                f"{x['spacing'][0]:.2f} to {x['spacing'][1]:.2f} ({x['true_spacing']:.2f})",
            ]
        )
    head = ("scene (pairs together)", "relation", "rule", "logistic", "own labels", "ECE", "skill", "spacing, m")
    caption = (
        "Pairwise F1. Own labels: the logistic regression cross-validated inside the scene. Spacing: from the training "
        "scenes to what the scene's unlabelled people told (true)."
    )
    return Table(caption, head, rows)


def _online(results: list[dict[str, Any]]) -> Table:
    rows = [
        [r["scene"], *(f"{r['recognition']['second_half'][k]:.3f}" for k in ("none", "first", "whole"))]
        for r in results
    ]
    caption = (
        "Pairwise F1 of pairs that begin in the second half of a scene, with what the scene tells of spacing and of "
        "strangers left out, taken from its first half, and from all of it."
    )
    return Table(caption, ("scene", "of the training scenes", "first half", "whole"), rows)


def _tracking(results: list[dict[str, Any]]) -> Table:
    rows = [
        [
            r["scene"],
            *(f"{_with(r['hidden'][k]['ratio'], r['hidden'][k]['interval'])}" for k in ("believed", "told")),
            f"{r['hidden']['told']['plain']:.2f} m² ({r['hidden']['told']['n']})",
            *(f"{r['blackout'][k]['error']:.3f}" for k in ("believed", "told")),
            f"{r['blackout']['plain']:.3f} ({r['blackout']['people']})",
        ]
        for r in results
    ]
    pooled = {(a, b): f"{_pooled(results, a, b):.3f}" for a in ("hidden", "blackout") for b in ("believed", "told")}
    rows.append(
        [
            "pooled ratio",
            *(pooled["hidden", how] for how in ("believed", "told")),
            "",
            *(pooled["blackout", how] for how in ("believed", "told")),
            "",
        ]
    )
    head = ("scene", "hidden, believed", "hidden, told", "without (n)", "blackout, believed", "told", "without (n)")
    caption = (
        "Hidden 4.8 s beside a partner: mean squared error as a share of constant velocity's. Blackout 8 s: share of "
        "wrong names. Believed: relations as recognised until then; told: the annotated ones."
    )
    return Table(caption, head, rows)


def _reliability(results: list[dict[str, Any]], file: Path) -> Path:
    figure = Figure(figsize=(9, 4), layout="constrained")
    curve, bars = figure.subplots(1, 2)
    curve.plot([0, 1], [0, 1], color=INK, lw=0.6)
    for color, r in zip(PALETTE, results, strict=False):
        said, was, count = (np.array(x) for x in r["recognition"]["calibration"]["curve"])
        some = count >= 5
        label = f"{r['scene']}, ECE {r['recognition']['calibration']['ece']:.3f}"
        curve.plot(said[some], was[some], "o-", color=color, ms=4, label=label)
    curve.set(xlabel="probability said", ylabel="share that is together", aspect="equal")
    curve.legend(frameon=False, fontsize=8)
    place = np.arange(len(results))
    for k, (name, color) in enumerate((("relation", PALETTE[0]), ("logistic", PALETTE[1]), ("rule", PALETTE[2]))):
        value = [r["recognition"]["f1"][name] for r in results]
        ends = np.array([r["recognition"]["interval"][name] for r in results]).T
        error = np.maximum(np.abs(ends - np.array(value)), 0.0)
        bars.errorbar(place + 0.2 * (k - 1), value, error, fmt="o", color=color, label=name, capsize=2)
    bars.set_xticks(place, [r["scene"] for r in results])
    bars.set(ylabel="pairwise F1", ylim=(0.5, 1.0))
    bars.legend(frameon=False, fontsize=8, loc="lower right")
    plot.save(figure, file)
    return file


def _learned(root: str, name: str, recognised: dict[str, Any]) -> tuple[walking.Known, np.ndarray]:
    everybody = walking.scenes(root)
    test = next(k for k in everybody if k.scene.name == name)
    constants = walking.learned([k for k in everybody if k is not test], **recognised["settings"])
    belief = constants.over_time(test.walkers, test.crowd, constants.settle(test.crowd))
    return test, Correction(*recognised["soon"]).surer(belief)


def _scene(root: str, name: str, recognised: dict[str, Any], file: Path) -> Path:
    """The people of a scene at its middle, their last seconds, and edges between those who may be together."""
    test, belief = _learned(root, name, recognised)
    w, pairs, at = test.walkers, test.crowd.pairs, test.crowd.pairs.offsets
    now = int(w.end.max()) // 2
    figure = Figure(figsize=(9, 8), layout="constrained")
    ax: Axes = figure.subplots()
    place: dict[int, np.ndarray] = {}
    for i in np.flatnonzero((w.begin <= now) & (w.end > now)):
        row = w.offsets[i] + now - w.begin[i]
        tail = w.position[max(w.offsets[i], row - int(4.0 / FRAME)) : row + 1]
        place[int(i)] = tail[-1]
        ax.plot(*tail.T, color=INK, lw=0.8, alpha=0.5)
        ax.plot(*tail[-1], "o", color=INK, ms=4)
    for k in np.flatnonzero((pairs.begin <= now) & (pairs.end > now)):
        p = float(belief[at[k] + now - pairs.begin[k]])
        a, b = place[int(pairs.first[k])], place[int(pairs.second[k])]
        if p > 0.02:
            ax.plot(*np.array([a, b]).T, color=PALETTE[0], lw=4, alpha=p, solid_capstyle="round", zorder=0)
        if test.truth[k]:
            ax.plot(*np.array([a, b]).T, color=PALETTE[1], lw=1, ls=":")
    ax.set(aspect="equal", xlabel="m", ylabel="m")
    ax.set_title(f"{name}: blue as opaque as probable, dotted as annotated", fontsize=10, color=INK)
    plot.save(figure, file)
    return file


def _beliefs(root: str, name: str, recognised: dict[str, Any], file: Path) -> Path:
    """Beliefs about every fourth annotated pair, and about the same number of strangers who came nearest."""
    test, belief = _learned(root, name, recognised)
    at = test.crowd.pairs.offsets
    partners = np.flatnonzero(test.truth)[::4]
    strangers = np.flatnonzero(~test.truth)
    strangers = strangers[np.argsort(test.crowd.looks.log_spacing[strangers])][: len(partners)]
    figure = Figure(figsize=(9, 4), layout="constrained")
    ax: Axes = figure.subplots()
    for some, color in ((strangers, INK), (partners, PALETTE[0])):
        for k in some:
            y = belief[at[k] : at[k + 1]]
            ax.plot((np.arange(len(y)) + 1) * FRAME, y, color=color, lw=0.8, alpha=0.5)
    ax.set(xlabel="seconds seen together", ylabel="probability of being together", xlim=(0, 40), ylim=(0, 1))
    plot.save(figure, file)
    return file
