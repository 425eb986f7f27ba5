"""The filters of ``wakefold track``: which options each reads, and how it is made from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Any, NamedTuple

from wakefold.cli import options

if TYPE_CHECKING:
    from wakefold.filters.trail import Trail
    from wakefold.model.model import Model
    from wakefold.service.agents import Crowd
    from wakefold.service.fleet import Follower
    from wakefold.service.remarks import Remarks


class FilterName(StrEnum):
    trail = "trail"
    mhpf = "mhpf"
    bl1 = "bl1"
    bl1_coarse = "bl1+coarse"
    bl2 = "bl2"
    calibrated = "calibrated"


class Kind(NamedTuple):
    """A kind of filter.

    Attributes:
        reads: options that not all filters read, by the names of their parameters.
        make: from a model and the options that it reads, by name.
    """

    reads: frozenset[str]
    make: Callable[..., Follower | Trail]


def _trail(model: Model, levels: Any, **settings: Any) -> Trail:
    from wakefold.filters.trail import Trail

    return Trail(model, **settings)


def _mhpf(model: Model, **settings: Any) -> Follower:
    from wakefold.filters.mhpf import MHPF

    return MHPF(model, **settings)


def _bl1(model: Model, levels: Any, **settings: Any) -> Follower:
    from wakefold.filters.bootstrap import BL1

    return BL1(model, **settings)


def _bl1_coarse(model: Model, **settings: Any) -> Follower:
    return _bl1(model, coarse=True, **settings)


def _bl2(model: Model, **settings: Any) -> Follower:
    from wakefold.filters.bootstrap import BL2

    return BL2(model, **settings)


def _calibrated(model: Model, levels: Any, **settings: Any) -> Follower:
    from wakefold.filters.calibrated import Calibrated

    return Calibrated(model, **settings)


_EVERY = frozenset({"sd", "seed"})
_ALL = _EVERY | {"particles"}
_DRAWN = _ALL | {"levels", "likelihood", "depletion"}
FILTERS = {
    FilterName.trail: Kind(_EVERY | {"levels"}, _trail),
    FilterName.mhpf: Kind(_DRAWN | {"rule"}, _mhpf),
    FilterName.bl1: Kind(_DRAWN, _bl1),
    FilterName.bl1_coarse: Kind(_DRAWN, _bl1_coarse),
    FilterName.bl2: Kind(_ALL | {"likelihood"}, _bl2),
    FilterName.calibrated: Kind(_ALL | {"levels"}, _calibrated),
}
SETTINGS = frozenset().union(*(kind.reads for kind in FILTERS.values()))


def check(name: FilterName, given: Mapping[str, str]) -> None:
    """Refuse an option that is given (see ``options.given``) and that the filter does not read."""
    for setting in sorted(SETTINGS - FILTERS[name].reads):
        if setting in given:
            readers = [other.value for other, kind in FILTERS.items() if setting in kind.reads]
            options.wrong(given[setting], f"--filter {name.value} does not read it; {', '.join(readers)} do")


def follower(name: FilterName, model: Model, settings: Mapping[str, Any]) -> Follower | Trail:
    """The filter with those of the settings that it reads; what is None is as the filter has it by itself."""
    kind = FILTERS[name]
    return kind.make(model, **{k: v for k, v in settings.items() if k in kind.reads and v is not None})


def crowd(
    filter: Follower | Trail, levels: list[float], horizons: list[float], most: int, silence: float, remarks: Remarks
) -> Crowd:
    """The crowd that is followed by a filter: in columns by ``Trail``, one by one by the others."""
    from wakefold.filters.trail import Trail
    from wakefold.service.columns import Columns
    from wakefold.service.fleet import Fleet

    kind: Any = Columns if isinstance(filter, Trail) else Fleet
    return kind(filter, levels, horizons, most, silence, remarks)
