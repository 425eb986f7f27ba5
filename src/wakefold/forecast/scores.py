"""What a scoring found: numbers for people and for programs, with intervals over tracks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from textwrap import wrap
from typing import Any

import numpy as np

from wakefold.base.remember import Remembers
from wakefold.base.types import Floats, Ints
from wakefold.base.wording import counted, duration_text, number_text
from wakefold.forecast import classes
from wakefold.forecast.methods import CONSTANT_VELOCITY
from wakefold.forecast.questions import Questions
from wakefold.forecast.samples import Judged

RESAMPLES, BLOCKS = 1000, 2000  # of the tracks, for an interval; of so many tracks at most
INTERVAL = (0.05, 0.95)


@dataclass(frozen=True, eq=False)
class Scores(Remembers):
    """How well each method answered the same questions; made by ``wakefold.score``.

    Attributes:
        asked: the questions.
        terms: how they were asked, in plain types.
        judged: scores of each answer, by method.
        unanswered: ``(H,)`` by method: how many answers it did not give. Constant velocity's stand for them.
        levels: ``(L,)`` of the classes, metres.
        classes: by method that tells classes, ``(T, 3, L, 3)``, see ``wakefold.forecast.classes.Ledger``.
        speed: questions, of places and of classes, answered in a second of one core, by method; NaN if not measured.
        settings: what was chosen for each method on past tracks held back, in plain types.
        notes: what should be known of the numbers.
        again: by method, what answers more questions ``(Q, H, S, d)``.
        seed: of the intervals.
        unit: of lengths.
    """

    asked: Questions
    terms: Mapping[str, Any]
    judged: Mapping[str, Judged]
    unanswered: Mapping[str, Ints]
    levels: tuple[float, ...]
    classes: Mapping[str, Floats]
    speed: Mapping[str, float]
    settings: Mapping[str, Mapping[str, Any]]
    again: Mapping[str, Callable[[Questions], Floats]]
    notes: tuple[str, ...] = ()
    seed: int = 0
    unit: str = "m"

    @property
    def methods(self) -> list[str]:
        """The best first: by the energy score over that of constant velocity, in the geometric mean of the horizons."""

        def worth(name: str) -> float:
            ratio = self.ratio(name)
            ratio = ratio[ratio > 0]
            return float(np.log(ratio).mean()) if len(ratio) else np.inf

        return sorted(self.judged, key=worth)

    def mean(self, method: str, what: str = "error", than: str | None = None) -> Floats:
        """``(H,)`` mean "error" or "energy" of a method, or how much more it is than that of another.

        NaN for a horizon for which nothing was asked. Two methods are compared on the questions that both were asked.
        """
        values = self._values(method, what, than)
        known = np.isfinite(values)
        number = known.sum(axis=0)
        total = np.where(known, values, 0.0).sum(axis=0)
        return np.divide(total, number, out=np.full(len(number), np.nan), where=number > 0)

    def interval(self, method: str, what: str = "error", than: str | None = None) -> Floats:
        """``(H, 2)`` 90 % interval of ``mean``, by a bootstrap over tracks: answers about one are not independent."""
        values = self._values(method, what, than)
        known, draws = np.isfinite(values), self._draws
        sums, counts = (np.zeros((draws.shape[1], values.shape[1])) for _ in range(2))
        block = self.asked.track * draws.shape[1] // len(self.asked.fixes)
        np.add.at(sums, block, np.where(known, values, 0.0))
        np.add.at(counts, block, known)
        with np.errstate(divide="ignore", invalid="ignore"):
            means = (draws @ sums) / (draws @ counts)
        out = np.full((values.shape[1], 2), np.nan)
        for h in range(len(out)):
            if len(good := means[np.isfinite(means[:, h]), h]):
                out[h] = np.quantile(good, INTERVAL)
        return out

    def _values(self, method: str, what: str, than: str | None) -> Floats:
        values = getattr(self.judged[method], what)
        return values if than is None else values - getattr(self.judged[than], what)

    @cached_property
    def _draws(self) -> Floats:
        """``(RESAMPLES, T)`` how often each track is drawn; of very many, each of as many blocks of tracks."""
        tracks = min(len(self.asked.fixes), BLOCKS)
        rng = np.random.default_rng(self.seed)
        return rng.multinomial(tracks, np.full(tracks, 1.0 / tracks), RESAMPLES).astype(np.float64)

    def ratio(self, method: str) -> Floats:
        """``(H,)`` mean energy score of a method over that of constant velocity, for the questions it was asked."""
        mine = self.mean(method, "energy")
        plain = mine - self.mean(method, "energy", CONSTANT_VELOCITY)
        return np.divide(mine, plain, out=np.full(len(mine), np.nan), where=plain > 0)

    def best(self, h: int, but: str | None = None) -> str | None:
        """The method, or of all but one, that has the least ``ratio`` for the h-th horizon."""
        ratios = {name: self.ratio(name)[h] for name in self.judged if name != but}
        ratios = {name: ratio for name, ratio in ratios.items() if np.isfinite(ratio)}
        return min(ratios, key=lambda name: ratios[name]) if ratios else None

    def to_dict(self) -> dict[str, Any]:
        """All numbers in plain types, ready for JSON: metres and seconds.

        Under "methods" stand for each horizon the mean and median error, the energy score, the shares of truths in the
        50 % and 90 % regions, the number of questions and of answers not given, the 90 % interval of the mean, and
        under "more than" the difference from constant velocity and from the best other method, with its interval.
        """
        asked = self.asked
        about = {**self.terms, "tracks": len(asked.fixes), "fixes": len(asked.fixes.points), "moments": len(asked)}
        about["horizons"] = {f"{h:g}": int(n) for h, n in zip(asked.horizons, asked.asked, strict=True)}
        return {
            "questions": about,
            "methods": {name: self._rows(name) for name in self.methods},
            "classes": {
                name: {f"{b:g}": classes.summary(found[:, :, k]) for k, b in enumerate(self.levels)}
                for name, found in self.classes.items()
            },
            "speed": {name: float(f"{value:.4g}") for name, value in self.speed.items() if np.isfinite(value)},
            "settings": {name: dict(setting) for name, setting in self.settings.items()},
            "notes": list(self.notes),
        }

    def _rows(self, name: str) -> dict[str, dict[str, Any]]:
        """What ``to_dict`` tells of one method."""
        found, out, interval = self.judged[name], {}, self.interval(name)
        for h, seconds in enumerate(self.asked.horizons):
            known = np.isfinite(found.error[:, h])
            if not known.any():
                continue
            others = [other for other in (CONSTANT_VELOCITY, self.best(h, but=name)) if other not in (None, name)]
            out[f"{seconds:g}"] = {
                "mean": float(found.error[known, h].mean()),
                "median": float(np.median(found.error[known, h])),
                "energy": float(found.energy[known, h].mean()),
                "cover50": float(found.within(0.5)[known, h].mean()),
                "cover90": float(found.within(0.9)[known, h].mean()),
                "n": int(known.sum()),
                "unanswered": int(self.unanswered[name][h]),
                "interval": interval[h].tolist(),
                "more than": {other: self._more(name, str(other), h) for other in others},
            }
        return out

    def _more(self, name: str, other: str, h: int) -> dict[str, list[float]]:
        """How much more error and energy a method has than another, and the ends of the 90 % interval."""
        return {
            what: [float(self.mean(name, what, other)[h]), *self.interval(name, what, other)[h].tolist()]
            for what in ("error", "energy")
        }

    # For people

    def table(self) -> str:
        """A few lines that say which method is best, and a table for each horizon and level."""
        found = self.to_dict()
        lines = [line for sentence in (*self.verdict(), self.said()) for line in wrap(sentence, 110)]
        wide = max(map(len, [*self.methods, *self.classes])) + 4
        for h in np.flatnonzero(self.asked.asked).tolist():
            lines += self._of_horizon(h, found["methods"], wide)
        lines += self._of_classes(found["classes"], wide)
        if speed := found["speed"]:
            each = (f"{name} {number_text(speed[name])}" for name in self.methods if name in speed)
            lines += ["", *wrap(f"questions a second of one core: {', '.join(each)}", 110)]
        return "\n".join(lines + [f"note: {note}" for note in self.notes])

    def _of_horizon(self, h: int, found: dict[str, Any], wide: int) -> list[str]:
        seconds, number = self.asked.horizons[h], int(self.asked.asked[h])
        head = f"{'method':<{wide}}{'mean':>10}{'median':>10}{'energy':>10}{'50 %':>7}{'90 %':>7}{'no answer':>11}"
        lines, few = ["", f"in {duration_text(seconds)}: {counted(number, 'question')}", head], []
        rows = {name: row for name in self.methods if (row := found[name].get(f"{seconds:g}"))}
        for name, row in sorted(rows.items(), key=lambda each: self.ratio(each[0])[h]):
            mark = ""
            if row["n"] < number:
                mark = " *"
                few.append(f"{row['n']:,}")
            numbers = "".join(f"{number_text(row[what], 3):>10}" for what in ("mean", "median", "energy"))
            cover = "".join(f"{row[what]:>7.2f}" for what in ("cover50", "cover90"))
            lines.append(f"{name + mark:<{wide}}{numbers}{cover}{row['unanswered'] or '':>11}")
        if few:
            lines.append(f"* was asked {few[0]} of them only, and has its place by constant velocity's score on these")
        return lines

    def said(self) -> str:
        """What the numbers are."""
        return (
            f"Mean and median error and energy score in {self.unit}, share of truths in the 50 % and the 90 % region; "
            f"{self.terms['asks']}."
        )

    def verdict(self) -> list[str]:
        """Sentences: which method is best at which horizons by its energy score, and by how much."""
        places: dict[str, list[int]] = {}
        for h in np.flatnonzero(self.asked.asked).tolist():
            places.setdefault(str(self.best(h)), []).append(h)
        sentences = []
        for name, rows in places.items():
            against = []
            for h in rows:
                if (other := self.best(h, but=name)) is None:
                    continue
                share = 1.0 - self.ratio(name)[h] / self.ratio(other)[h]
                doubt = "" if self.interval(name, "energy", other)[h, 1] < 0 else " (which may be chance)"
                against.append(f"{share:.0%} below that of {other}{doubt} in {duration_text(self.asked.horizons[h])}")
            when = ", ".join(duration_text(self.asked.horizons[h]) for h in rows)
            sentences.append(f"Best in {when}: {name}{', its energy score ' if against else ''}{', '.join(against)}.")
        return sentences

    def _of_classes(self, found: dict[str, Any], wide: int) -> list[str]:
        lines, shares = [], [f"{100 * share:.0f}" for share in classes.SHARES]
        head = "".join(f"{f'{share}%: -log p':>16}{'right':>8}{'cal.':>8}" for share in shares)
        for level in (f"{b:g}" for b in self.levels):
            lines += ["", f"class of the whole track at {level} {self.unit}, after a share of it"]
            lines.append(f"{'method':<{wide}}{head}")
            rows = {name: levels[level] for name, levels in found.items() if levels[level]}
            for name, row in sorted(rows.items(), key=lambda each: each[1].get("50", {}).get("nll", np.inf)):
                cells = [row.get(share) for share in shares]
                text = "".join(
                    f"{c['nll']:>16.2f}{c['accuracy']:>8.0%}{c['ece']:>8.2f}" if c else f"{'':>32}" for c in cells
                )
                few = any(cell and cell["n"] < len(self.asked.fixes) for cell in cells)
                lines.append(f"{name + ' *' * few:<{wide}}{text}")
        return lines
