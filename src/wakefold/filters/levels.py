"""The answer of a belief at one level: its classes and their probabilities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from wakefold.base.types import Floats, Ints

if TYPE_CHECKING:
    from wakefold.model.filtration import Filtration


class LevelRow(NamedTuple):
    """One class of a level."""

    class_: int
    size: int
    probability: float


@dataclass(frozen=True, eq=False, repr=False)
class LevelTable:
    """The classes alive at a level and their probabilities (they sum to 1), the likeliest first.

    Attributes:
        level: metres.
        classes: ``(K,)`` class ids.
        sizes: ``(K,)`` number of tracks of each.
        probability: ``(K,)``.
    """

    tree: Filtration
    level: float
    classes: Ints
    sizes: Ints
    probability: Floats

    def members(self, class_: int) -> Ints:
        """Indices of the tracks of a class."""
        return self.tree.members(class_)

    def __len__(self) -> int:
        return len(self.classes)

    def __iter__(self) -> Iterator[LevelRow]:
        for c, size, p in zip(self.classes, self.sizes, self.probability, strict=True):
            yield LevelRow(int(c), int(size), float(p))

    def _lines(self, most: int = 12) -> list[tuple[str, str, str]]:
        shown = [(str(r.class_), str(r.size), f"{r.probability:.4f}") for r in list(self)[:most] if r.probability > 0]
        rest = len(self) - len(shown)
        return [*shown, ("…", f"{rest} more", f"{self.probability[len(shown) :].sum():.4f}")] if rest else shown

    def __repr__(self) -> str:
        rows = [("class", "tracks", "probability"), *self._lines()]
        return f"level {self.level:g}\n" + "\n".join(f"{a:>8} {b:>10} {c:>12}" for a, b, c in rows)

    def _repr_html_(self) -> str:
        body = "".join(f"<tr><td>{a}</td><td>{b}</td><td>{c}</td></tr>" for a, b, c in self._lines())
        head = "<tr><th>class</th><th>tracks</th><th>probability</th></tr>"
        return f"<table><caption>level {self.level:g} m</caption>{head}{body}</table>"
