"""Real people: who walks with whom, where a hidden person is, who is who after nobody was seen for eight seconds.

Four scenes (ETH and UCY, with annotated groups); each is judged with constants, thresholds and settings learned and
chosen on the other three. Needs the data: ``WAKEFOLD_PEDESTRIANS`` names OpenTraj's ``datasets`` directory.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.base.types import Bools, Floats
from wakefold.experiments.stats import f1
from wakefold.experiments.walking.blackout import Window, learn_reunion, reunite
from wakefold.experiments.walking.hidden import Beside, Company, Told, accompanied, equations, hide, places, solve, told
from wakefold.experiments.walking.pedestrians import FRAME, SCENES, PedestrianScene, read_scenes
from wakefold.experiments.walking.recalibration import learn_soon, learn_surer
from wakefold.experiments.walking.rivals import Logistic, Rule, features, within
from wakefold.relations.learning.together import Crowd, SceneConstants, TogetherFit, crowd, fit, fits
from wakefold.relations.learning.walkers import Walkers, follow

WHERE = "WAKEFOLD_PEDESTRIANS"

FADES, RIDGES, TRUSTS = (0.3, 0.5), (0.3, 1.0), (0.5, 1.0)
WANDERS = (0.15, 0.25, 0.35, 0.5)  # q of the constant-velocity forecast, m/s per square root of a second
COUNTS = (1.0, 2.0), (4.0, 6.0)  # lift and power with which partners count
NOBODY = Company(np.zeros((12, 16)), 0.0, 2.0)  # tells nothing: constant velocity
DARK = 20  # frames: 8 s
RESAMPLES = 1000


class Known(NamedTuple):
    """A scene, ready for learning and judging."""

    scene: PedestrianScene
    walkers: Walkers
    crowd: Crowd
    truth: Bools
    table: Floats


def data_directory() -> Path | None:
    """Where the scenes are, if they are anywhere."""
    named = os.environ.get(WHERE)
    if not named or not all((Path(named) / place / "obsmat.txt").exists() for place in SCENES.values()):
        return None
    return Path(named)


@cache
def scenes(root: str) -> tuple[Known, ...]:
    """All four, read once in each process."""
    return tuple(known(scene) for scene in read_scenes(root))


def known(scene: PedestrianScene) -> Known:
    """A scene followed, with its pairs and which of them are partners."""
    walkers = follow(scene.tracks, FRAME)
    people, partners, ids = crowd(walkers), scene.partners(), scene.tracks.ids.tolist()
    pairs = zip(people.pairs.first.tolist(), people.pairs.second.tolist(), strict=True)
    truth = np.array([(ids[i], ids[j]) in partners for i, j in pairs])
    return Known(scene, walkers, people, truth, features(walkers, people))


def judge(spec: Mapping[str, Any]) -> dict[str, Any]:
    """Everything about one scene, learned on the other three."""
    everybody = scenes(spec["root"])
    test = next(k for k in everybody if k.scene.name == spec["scene"])
    others = [k for k in everybody if k is not test]
    rng = np.random.default_rng([spec["seed"], list(SCENES).index(spec["scene"])])
    recognised, beliefs = recognise(test, others, rng)
    return {
        "scene": test.scene.name,
        "recognition": recognised,
        "hidden": hidden(test, others, beliefs, rng),
        "blackout": blackout(test, others, beliefs, rng),
    }


def learned(train: Sequence[Known], fade: float, ridge: float, trust: float) -> TogetherFit:
    """Constants from scenes with known groups."""
    return fit([k.crowd for k in train], [k.truth for k in train], fade=fade, ridge=ridge, trust=trust)


def chosen(train: Sequence[Known]) -> tuple[dict[str, float], list[tuple[TogetherFit, SceneConstants]]]:
    """The settings with the best mean F1, each training scene judged by constants of the others; and these, and what
    each scene has told of itself.
    """
    best, kept = (-1.0, 0.0, 0.0, 0.0), []
    for fade, ridge in product(FADES, RIDGES):
        folds = []
        for k in train:
            others = [other for other in train if other is not k]
            crowds, truth = [other.crowd for other in others], [other.truth for other in others]
            fitted = fits(crowds, truth, fade=fade, ridge=ridge, trusts=TRUSTS)
            folds.append([(constants, constants.settle(k.crowd)) for constants in fitted])
        for trust, held in zip(TRUSTS, zip(*folds, strict=True), strict=True):
            scores = [f1(k.truth, c.posterior(k.crowd, own) > 0.5) for k, (c, own) in zip(train, held, strict=True)]
            score = (float(np.mean(scores)), fade, ridge, trust)
            if score > best:
                best, kept = score, list(held)
    return {"fade": best[1], "ridge": best[2], "trust": best[3]}, kept


def recognise(test: Known, others: list[Known], rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Floats]]:
    """Pairwise F1 beside the rivals', and calibration; and the beliefs over time that the tracking needs.

    The beliefs of a training scene come from the other training scenes, so they are as good as the test scene's.
    """
    settings, held = chosen(others)
    constants = learned(others, **settings)
    own = constants.settle(test.crowd)
    p, truth = constants.posterior(test.crowd, own), test.truth
    rule = Rule([k.walkers for k in others], [k.crowd for k in others], [k.truth for k in others])
    rival = Logistic([k.table for k in others], [k.truth for k in others])
    found = {
        "relation": p > 0.5,
        "rule": rule.found(test.walkers, test.crowd),
        "logistic": rival.found(test.table),
    }
    draws = rng.integers(0, len(test.crowd.pairs.first), (RESAMPLES, len(truth)))
    spread = _spread(truth, found, draws)
    near = test.crowd.looks.closest < 3.0
    beliefs = {k.scene.name: c.over_time(k.walkers, k.crowd, own) for k, (c, own) in zip(others, held, strict=True)}
    soon = learn_soon(list(beliefs.values()), [k.crowd.pairs for k in others], [k.truth for k in others])
    beliefs[test.scene.name] = constants.over_time(test.walkers, test.crowd, own)
    causal = beliefs[test.scene.name][test.crowd.pairs.offsets[1:] - 1]
    return {
        "pairs": len(truth),
        "together": int(truth.sum()),
        "f1": {name: f1(truth, x) for name, x in found.items()},
        "interval": {name: np.quantile(x, [0.025, 0.975]).tolist() for name, x in spread.items()},
        "ahead": {
            name: np.quantile(np.subtract(spread["relation"], spread[name]), [0.025, 0.975]).tolist()
            for name in ("rule", "logistic")
        },
        "without_friends": f1(truth, causal > 0.5),
        "second_half": second_half(test, constants, own),
        "own_labels": within(test.table, truth, seed=int(rng.integers(2**31))),
        "settings": settings,
        "soon": list(soon),
        "rule": [rule.distance, rule.difference, rule.share],
        "logistic": [rival.columns, rival.ridge, rival.cut],
        "spacing": [float(np.exp(constants.spacing)), float(np.exp(own.spacing)), own.spacing_sd, own.shift],
        "true_spacing": float(np.exp(test.crowd.looks.log_spacing[truth].mean())),
        "calibration": calibration(p[near], truth[near]),
        "calibration_logistic": calibration(rival.probability(test.table)[near], truth[near]),
    }, {name: soon.surer(p) for name, p in beliefs.items()}


def _spread(truth: Bools, found: Mapping[str, Bools], draws: NDArray[np.int64]) -> dict[str, list[float]]:
    """F1 of what each found, in pairs drawn again; ``draws (R, K)``."""
    kind = sum((x.astype(np.int64) << k for k, x in enumerate(found.values(), 1)), truth.astype(np.int64))
    kinds = np.arange(2 << len(found))
    out: dict[str, list[float]] = {name: [] for name in found}
    for d in draws:
        count = np.bincount(kind[d], minlength=len(kinds))
        for k, name in enumerate(found, 1):
            true, said = count * (kinds & 1), count * (kinds >> k & 1)
            out[name].append(float(2 * (true * (kinds >> k & 1)).sum() / max(int(true.sum()) + int(said.sum()), 1)))
    return out


def second_half(test: Known, constants: TogetherFit, own: SceneConstants) -> dict[str, float]:
    """F1 of the pairs that begin after the scene's middle, with the scene's constants from all of it, from its first
    half alone (as a filter that runs along would have them), and with those of the training scenes.
    """
    middle = int(test.walkers.begin.min() + test.walkers.end.max()) // 2
    early = constants.settle(crowd(test.walkers.until(middle)))
    late = test.crowd.pairs.begin >= middle
    settings = {"whole": own, "first": early, "none": SceneConstants(constants.spacing, constants.between, 0.0)}
    return {k: f1(test.truth[late], constants.posterior(test.crowd, c)[late] > 0.5) for k, c in settings.items()}


def calibration(p: Floats, truth: Bools, bins: int = 10) -> dict[str, Any]:
    """Expected calibration error over bins of equal width, Brier score and its skill, and the reliability curve."""
    which = np.minimum((p * bins).astype(np.int64), bins - 1)
    count = np.bincount(which, minlength=bins)
    said = np.bincount(which, p, bins) / np.maximum(count, 1)
    was = np.bincount(which, truth, bins) / np.maximum(count, 1)
    brier, base = float(((p - truth) ** 2).mean()), float(truth.mean() * (1.0 - truth.mean()))
    return {
        "pairs": len(p),
        "ece": float((np.abs(said - was) * count).sum() / max(len(p), 1)),
        "brier": brier,
        "skill": 1.0 - brier / base if base > 0 else 0.0,
        "curve": [said.tolist(), was.tolist(), count.tolist()],
    }


def hidden(test: Known, others: list[Known], beliefs: Mapping[str, Floats], rng: np.random.Generator) -> dict[str, Any]:
    """One member of a group hidden for 4.8 s with a partner in sight: squared error beside constant velocity.

    q is the one at which constant velocity does best on the training scenes; how partners count is the way that does
    best on all of them, each with what is learned from the others. Learned at every frame, judged at every sixth.
    """

    def moments(k: Known, q: float, sure: bool, every: int) -> Beside:
        walkers = follow(k.scene.tracks, FRAME, q=q)
        pairs = k.crowd.pairs
        known = np.repeat(k.truth, np.diff(pairs.offsets)).astype(np.float64)
        return hide(walkers, pairs, known if sure else beliefs[k.scene.name], k.truth, every=every)

    def alone(k: Known, q: float) -> float:
        seen = moments(k, q, True, 6)
        return float(((seen.alone - seen.truth) ** 2).sum(axis=2).mean())

    q = min(WANDERS, key=lambda q: np.mean([alone(k, q) for k in others]))
    out: dict[str, Any] = {"q": q}
    for name, sure in (("believed", False), ("told", True)):
        company = _company([accompanied(moments(k, q, sure, 1)) for k in others])
        rows = moments(test, q, sure, 6)
        members = accompanied(rows)
        said = told(members, company.lift, company.power)
        ours, plain = _errors_of(members, said, company), _errors_of(members, said, NOBODY)
        out[name] = _ratio(ours.mean(axis=1), plain.mean(axis=1), members.person[said.first], rng)
        out[name]["at_the_end"] = float(ours[:, -1].mean() / plain[:, -1].mean())
        out[name]["settings"] = [company.lift, company.power]
        if not sure:
            strangers = accompanied(rows, others=True)
            said = told(strangers, company.lift, company.power)
            out["strangers"] = [float(_errors_of(strangers, said, c).sum()) for c in (company, NOBODY)]
    return out


def _company(known: Sequence[Beside]) -> Company:
    """Learned in the way that does best on all scenes, each with what is learned from the others."""
    best, most = NOBODY, np.inf
    for lift, power in product(*COUNTS):
        said = [told(one, lift, power) for one in known]
        parts = [equations(*both) for both in zip(known, said, strict=True)]
        error = 0.0
        for i, (one, heard) in enumerate(zip(known, said, strict=True)):
            others = solve([part for j, part in enumerate(parts) if j != i], lift=lift, power=power)
            error += float(_errors_of(one, heard, others).sum())
        if error < most:
            best, most = solve(parts, lift=lift, power=power), error
    return best


def _errors_of(moments: Beside, said: Told, company: Company) -> Floats:
    """Squared errors ``(n, H)`` of the forecast by company."""
    return ((places(moments, said, company) - moments.truth[said.first]) ** 2).sum(axis=2)


def blackout(
    test: Known, others: list[Known], beliefs: Mapping[str, Floats], rng: np.random.Generator
) -> dict[str, Any]:
    """Everybody who stays is hidden for 8 s and comes back without a name: share of wrong names.

    Beliefs are corrected once more, as the windows of the training scenes tell: of those who are about to leave the
    scene there is nobody in them.
    """
    known = [_dark(k, beliefs[k.scene.name], every=2) for k in others]
    settings = learn_reunion([[(window, truth) for window, _, truth in scene] for scene in known])
    surer = learn_surer([_twos(scene, 1) for scene in known], [_twos(scene, 2) > 0 for scene in known])
    cases = [(window, surer.surer(belief), truth) for window, belief, truth in _dark(test, beliefs[test.scene.name])]
    wrong: dict[str, Floats] = {}
    for which in ("plain", "believed", "told"):
        found = [
            reunite(window, {"plain": None, "believed": belief, "told": truth}[which], settings, seed=number)
            for number, (window, belief, truth) in enumerate(cases)
        ]
        wrong[which] = np.array([float((who != np.arange(len(who))).sum()) for who in found])
    people = sum(len(window.found) for window, *_ in cases)
    out: dict[str, Any] = {"settings": list(settings), "surer": list(surer), "windows": len(cases), "people": people}
    for which in ("believed", "told"):
        out[which] = _ratio(wrong[which], wrong["plain"], np.arange(len(cases)), rng)
        out[which]["error"] = float(wrong[which].sum() / people)
    out["plain"] = float(wrong["plain"].sum() / people)
    return out


def _dark(k: Known, belief: Floats, every: int = 10, before: int = 5) -> list[tuple[Window, Floats, Floats]]:
    """Windows of 8 s in which at least three people stay, with the belief in each two and the truth."""
    w, pairs = k.walkers, k.crowd.pairs
    n, out = len(w.ids), []
    truth = np.zeros((n, n))
    truth[pairs.first[k.truth], pairs.second[k.truth]] = 1.0
    for frame in range(int(w.begin.min()) + before, int(w.end.max()) - DARK, every):
        stay = np.flatnonzero((w.begin <= frame - before) & (w.end > frame + DARK))
        if len(stay) < 3:
            continue
        row = w.offsets[stay] + frame - 1 - w.begin[stay]
        back = w.seen[row + DARK + 1]
        if not np.isfinite(back).all():
            continue
        p = np.zeros((n, n))
        now = np.flatnonzero((pairs.begin < frame) & (pairs.end >= frame))
        p[pairs.first[now], pairs.second[now]] = belief[pairs.offsets[now] + frame - 1 - pairs.begin[now]]
        both = np.ix_(stay, stay)
        window = Window(w.position[row], w.velocity[row], back, (DARK + 1) * FRAME)
        out.append((window, (p + p.T)[both], (truth + truth.T)[both]))
    return out


def _twos(cases: Sequence[tuple[Any, ...]], which: int) -> Floats:
    """One of the ``(n, n)`` tables of windows, each two people once, laid end to end."""
    return np.concatenate([case[which][np.triu_indices(len(case[which]), 1)] for case in cases])


def _ratio(ours: Floats, plain: Floats, of: NDArray, rng: np.random.Generator) -> dict[str, Any]:
    """Ratio of sums, with an interval from drawing the units ``of`` (people, windows) again."""
    units, which = np.unique(of, return_inverse=True)
    sums = np.stack([np.bincount(which, x, len(units)) for x in (ours, plain)])
    draws = sums[:, rng.integers(0, len(units), (RESAMPLES, len(units)))].sum(axis=2)
    ratio = draws[0] / np.maximum(draws[1], 1e-12)
    return {
        "n": len(ours),
        "units": len(units),
        "ratio": float(ours.sum() / max(plain.sum(), 1e-12)),
        "interval": np.quantile(ratio, [0.025, 0.975]).tolist(),
        "ours": float(ours.mean()),
        "plain": float(plain.mean()),
        "sums": [float(ours.sum()), float(plain.sum())],
    }
