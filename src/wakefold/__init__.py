"""Wakefold tells, at every scale at once, what a moving agent is doing."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from wakefold.belief import Belief
    from wakefold.confusion import Confusion
    from wakefold.detections import Detections
    from wakefold.deviation import Deviation
    from wakefold.distance import frechet, frechet_matrix
    from wakefold.evidence import CoarseClass, Fix
    from wakefold.filters.bootstrap import BL1, BL2
    from wakefold.filters.calibrated import Calibrated
    from wakefold.filters.hmm import GaussianHMM
    from wakefold.filters.mhpf import MHPF
    from wakefold.filters.relational import RelationalFilter
    from wakefold.filtration import Filtration
    from wakefold.io import read_tracks, write_tracks
    from wakefold.model import Model, learn, load
    from wakefold.relations import Activity, ConstantVelocity, PairEvidence, Relation, RelationalModel, Sampler
    from wakefold.scene import Scene
    from wakefold.tracks import Tracks

_WHERE = {  # looked up on first use: importing the package costs no numba, pyarrow or matplotlib
    "Activity": "relations",
    "BL1": "filters.bootstrap",
    "BL2": "filters.bootstrap",
    "Belief": "belief",
    "Calibrated": "filters.calibrated",
    "CoarseClass": "evidence",
    "Confusion": "confusion",
    "ConstantVelocity": "relations",
    "Detections": "detections",
    "Deviation": "deviation",
    "Filtration": "filtration",
    "Fix": "evidence",
    "GaussianHMM": "filters.hmm",
    "MHPF": "filters.mhpf",
    "Model": "model",
    "PairEvidence": "relations",
    "Relation": "relations",
    "RelationalFilter": "filters.relational",
    "RelationalModel": "relations",
    "Sampler": "relations",
    "Scene": "scene",
    "Tracks": "tracks",
    "frechet": "distance",
    "frechet_matrix": "distance",
    "learn": "model",
    "load": "model",
    "read_tracks": "io",
    "write_tracks": "io",
}
__all__ = [  # noqa: RUF022 (by subject)
    "read_tracks",
    "write_tracks",
    "Tracks",
    "frechet",
    "frechet_matrix",
    "Filtration",
    "Model",
    "learn",
    "load",
    "Fix",
    "CoarseClass",
    "Belief",
    "MHPF",
    "BL1",
    "BL2",
    "Calibrated",
    "Deviation",
    "Confusion",
    "GaussianHMM",
    "ConstantVelocity",
    "Sampler",
    "Relation",
    "PairEvidence",
    "Activity",
    "RelationalModel",
    "Detections",
    "RelationalFilter",
    "Scene",
]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'wakefold' has no attribute {name!r}")
    value = getattr(import_module(f"wakefold.{_WHERE[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_WHERE})
