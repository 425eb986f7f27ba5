"""Evidence of any kind, and the order it is taken in."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from wakefold.base.checks import shown
from wakefold.evidence.coarse import CoarseClass
from wakefold.evidence.fix import Fix

if TYPE_CHECKING:
    from wakefold.model.filtration import Filtration


Evidence = Fix | CoarseClass


def in_order(evidence: Sequence[Evidence], tree: Filtration) -> list[tuple[float, Evidence]]:
    """Fixes first, then coarse evidence by rising level: pairs of (level, item), level -1 for a fix.

    Raises:
        TypeError: something that is no evidence.
        ValueError: see ``CoarseClass.at_level``.
    """
    if isinstance(evidence, (Fix, CoarseClass)):
        raise TypeError("evidence is a list: put [] around the single item")
    if isinstance(evidence, str) or not isinstance(evidence, Iterable):
        raise TypeError(f"evidence is a list of Fix and CoarseClass, got {shown(evidence)}")
    out: list[tuple[float, Evidence]] = []
    for item in evidence:
        if isinstance(item, Fix):
            out.append((-1.0, item))
        elif isinstance(item, CoarseClass):
            out.append((item.at_level(tree), item))
        else:
            raise TypeError(f"evidence must be Fix or CoarseClass, got {type(item).__name__}")
    if len(out) > 1:
        out.sort(key=lambda pair: pair[0])
    return out
