"""Runs filters over scenarios and scores them: one job is one method under one setting, all scenarios of it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wakefold.base.types import Floats
from wakefold.evidence.coarse import CoarseClass
from wakefold.evidence.confusion import Confusion
from wakefold.evidence.evidence import Evidence
from wakefold.evidence.fix import Fix
from wakefold.experiments.mhpf.rasters import TANKERS
from wakefold.experiments.mhpf.scenarios import Observed, Scenario, Setting, chosen
from wakefold.experiments.registry import Job, Size
from wakefold.filters.belief import Belief
from wakefold.filters.bootstrap import BL1, BL2
from wakefold.filters.calibrated import Calibrated
from wakefold.filters.mhpf import MHPF
from wakefold.model.deviation import Deviation
from wakefold.model.model import Model

NEAR = 0.33  # of the range of tree distances: the ball to come within
LAST = 5  # distances that are averaged before they are compared with it


class Method(NamedTuple):
    """A filter by name.

    Attributes:
        filter: "mhpf", "bl1", "bl1+coarse", "bl2" or "calibrated".
        likelihood: "log", "gaussian" or "student".
        rule: of mhpf.
    """

    filter: str
    likelihood: str = "log"
    rule: str = ""

    @property
    def name(self) -> str:
        """For tables."""
        titles = {"mhpf": "MHPF", "bl1": "BL1", "bl1+coarse": "BL1+coarse", "bl2": "BL2", "calibrated": "calibrated"}
        title = titles[self.filter]
        return " ".join(part for part in (title, self.rule, self.likelihood) if part)


class Known(NamedTuple):
    """What the calibrated filter has learned beforehand; None for what it is to learn itself, or not to know."""

    deviation: Deviation | None = None
    confusion: Confusion | None = None


def make(method: Method, model: Model, particles: int, seed: int, known: Known | None = None) -> Any:
    """The filter a method names; ``known`` is what the calibrated one has learned beforehand."""
    settings: dict[str, Any] = {"likelihood": method.likelihood, "seed": seed}
    match method.filter:
        case "mhpf":  # of all sets, as the papers have it, so that the stack's estimate is the papers'
            return MHPF(model, particles, rule=method.rule, levels="all", **settings)  # type: ignore[arg-type]
        case "bl1" | "bl1+coarse":
            return BL1(model, particles, coarse=method.filter == "bl1+coarse", **settings)
        case "bl2":
            return BL2(model, particles, **settings)
        case "calibrated":
            known = known or Known()
            return Calibrated(model, particles, deviation=known.deviation, confusion=known.confusion, seed=seed)
    raise ValueError(f"no filter {method.filter!r}")


class Scores(NamedTuple):
    """Scores of one method under one setting, each ``(scenarios, repetitions)``.

    Attributes:
        mse: mean over time of the squared distance of the estimate from the truth, base set; square plane units.
        mse_stack: the same, mean of the whole stack; NaN where it is not asked for.
        distance: mean over time of the tree distance of the most probable track to the truth; NaN for BL2.
        excess: the same, over the best attainable: the least such distance of any track the filter knows.
        converged: share of the trial after which the excess, averaged over five steps, stays within a third of the
            range; 1 where that never happens.
        recoveries: in a run.
    """

    mse: Floats
    mse_stack: Floats
    distance: Floats
    excess: Floats
    converged: Floats
    recoveries: Floats


def job(setting: Setting, method: Method, size: Size, stack: bool = False) -> Job:
    """A method under a setting; ``stack`` asks MHPF for the estimate from the whole stack, at four times the cost."""
    scenarios = size.tanker_scenarios if setting.data.startswith(TANKERS) else size.scenarios
    if method.filter == "calibrated":  # its noise is its own, so no run differs from another by the model's
        setting = setting._replace(kappa=0.0)
    stack = stack and method.filter == "mhpf"  # the others have but one set
    spec = {
        "setting": setting._asdict(),
        "method": method._asdict(),
        "scenarios": scenarios,
        "repetitions": size.repetitions,
        "particles": size.particles,
        "seed": size.seed,
        "stack": stack,
    }
    dear = (4.0 if stack else 1.0) * (2.0 if setting.data.startswith(TANKERS) else 1.0)
    return Job("mhpf.simulate:run", spec, dear * scenarios * size.repetitions / 250)


def scores(result: dict[str, Any]) -> Scores:
    """Scores from the result of a job."""
    return Scores(*(np.array(result[name], dtype=np.float64) for name in Scores._fields))


def run(spec: dict[str, Any]) -> dict[str, Any]:
    """Scores of a method under a setting, plain JSON; None where there is no score."""
    setting, method, seed = Setting(**spec["setting"]), Method(**spec["method"]), spec["seed"]
    rows = []
    for truth in chosen(setting.data, spec["scenarios"], seed):
        scenario = _scenario(setting, truth)
        known = knowledge(setting, truth, seed) if method.filter == "calibrated" else None
        f = make(method, scenario.model, spec["particles"], seed, known)
        # A proper likelihood is matched to the noise, so its mean is taken off; the papers' weight knows of no mean.
        offset = 0.0 if f.likelihood == "log" else scenario.offset
        rows.append(
            [
                follow(f, scenario, _given(_seen(setting), truth, seed, r, offset), f"{truth}/{r}", spec["stack"])
                for r in range(spec["repetitions"])
            ]
        )
    table = np.array(rows)  # (scenarios, repetitions, scores)
    return {
        name: [[None if np.isnan(x) else float(x) for x in row] for row in table[:, :, k]]
        for k, name in enumerate(Scores._fields)
    }


# A worker meets the same scenario again with another method.
_scenario = lru_cache(maxsize=64)(Scenario)


def knowledge(setting: Setting, truth: int, seed: int) -> Known:
    """Learned from the training tracks, by simulation as if no report were wrong; the same for all noises κ."""
    alike = setting._replace(kappa=0.0, lead_in=None, wrong=0.0, epsilon="default", coarse=float(setting.coarse > 0.0))
    return Known(_deviation_of(alike, truth), _confusion(alike, truth, seed) if setting.coarse else None)


def _deviation_of(setting: Setting, truth: int) -> Deviation:
    return _deviation(setting.data, setting.linkage, setting.psi, truth if setting.truth == "out" else None)


@lru_cache(maxsize=64)
def _deviation(data: str, linkage: str, psi: float, without: int | None) -> Deviation:
    setting = Setting(data, "in" if without is None else "out", 0.0, psi, linkage=linkage)
    return Deviation.learn(Scenario(setting, without or 0).model)


@lru_cache(maxsize=64)
def _confusion(setting: Setting, truth: int, seed: int) -> Confusion:
    scenario = _scenario(setting, truth)
    assert scenario.reporter is not None
    return Confusion.learn(scenario.model, scenario.reporter, deviation=_deviation_of(setting, truth), seed=seed)


def _seen(setting: Setting) -> Setting:
    """What observations depend on: not how agents move in the model. Making them takes as long as a quick job."""
    return setting._replace(kappa=0.0, epsilon="default")


@lru_cache(maxsize=512)
def _observed(setting: Setting, truth: int, seed: int, repetition: int) -> list[Observed]:
    return _scenario(setting, truth).observations(seed, repetition)


@lru_cache(maxsize=1024)
def _given(setting: Setting, truth: int, seed: int, repetition: int, offset: float) -> list[list[Evidence]]:
    return [evidence(observed, offset) for observed in _observed(setting, truth, seed, repetition)]


def evidence(observed: Observed, offset: Floats | float = 0.0) -> list[Evidence]:
    """What a filter is given; ``offset`` is the known mean error of a fix."""
    out: list[Evidence] = [] if observed.fix is None else [Fix(observed.fix - offset)]
    if observed.report is not None:
        out.append(CoarseClass(observed.report.class_, level=observed.report.level))
    return out


def follow(f: Any, scenario: Scenario, given: Sequence[list[Evidence]], agent: str, stack: bool) -> tuple[float, ...]:
    """Scores of one run, in the order of ``Scores``; ``given`` is the evidence at each step."""
    belief, beliefs, squares_stack = f.start(at="begin", agent=agent), [], []
    for items, at in zip(given, scenario.path[1:], strict=True):
        belief = f.step(belief, items, dt=1.0)
        beliefs.append(belief)
        squares_stack.append(_square(belief.mean("stack"), at) if stack else np.nan)
    weights = _weights(beliefs)
    away = [w[: len(b.points)] @ b.points for w, b in zip(weights, beliefs, strict=True)] - scenario.path[1:]
    squares = [float(gap @ gap) for gap in away]
    distance = scenario.away[_likeliest(beliefs, weights, len(scenario.away))] if f.single else np.array([np.nan])
    excess = distance - scenario.away.min()
    late = arrival(excess, NEAR * scenario.reach)
    scored = (np.mean(squares), np.mean(squares_stack), distance.mean(), excess.mean(), late, belief.recoveries)
    return tuple(float(x) for x in scored)


def _weights(beliefs: Sequence[Belief]) -> Floats:
    """``(T, N)`` weights of the particles of beliefs, filled up with zeros: all at once, a third of a step's time."""
    logs = np.full((len(beliefs), max(len(b.log_weights) for b in beliefs)), -np.inf)
    for row, b in zip(logs, beliefs, strict=True):
        row[: len(b.log_weights)] = b.log_weights
    weights = np.exp(logs - logs.max(axis=1, keepdims=True))
    return weights / weights.sum(axis=1, keepdims=True)


def _likeliest(beliefs: Sequence[Belief], weights: Floats, tracks: int) -> NDArray[np.int64]:
    """``(T,)`` most probable tracks. ``Belief.map`` would merge duplicates of a track too, at ten times the cost."""
    cells = np.zeros(weights.shape, dtype=np.int64)
    for row, b in zip(cells, beliefs, strict=True):
        row[: len(b.classes)] = b.classes
    cells += tracks * np.arange(len(beliefs))[:, None]
    return np.bincount(cells.ravel(), weights.ravel(), len(beliefs) * tracks).reshape(-1, tracks).argmax(axis=1)


def arrival(excess: Floats, near: float) -> float:
    """Share of a trial after which the mean of the last few excess distances stays within ``near``; 1 for never."""
    if np.isnan(excess).any():
        return np.nan
    sums = np.cumsum(np.concatenate([[0.0], excess]))
    ends = np.arange(1, len(sums))
    begins = np.maximum(ends - LAST, 0)
    outside = np.flatnonzero((sums[ends] - sums[begins]) / (ends - begins) > near)
    return 0.0 if not len(outside) else float(outside[-1] + 1) / len(excess)


def _square(estimate: Floats, at: Floats) -> float:
    away = estimate - at
    return float(away @ away)
