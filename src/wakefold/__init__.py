"""Wakefold tells, at every scale at once, what a moving agent is doing."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from wakefold.base import __version__ as __version__

if TYPE_CHECKING:
    from wakefold.evidence.coarse import CoarseClass
    from wakefold.evidence.confusion import Confusion
    from wakefold.evidence.fix import Fix
    from wakefold.filters.belief import Belief
    from wakefold.filters.bootstrap import BL1, BL2
    from wakefold.filters.calibrated import Calibrated
    from wakefold.filters.hmm import GaussianHMM
    from wakefold.filters.mhpf import MHPF
    from wakefold.filters.trail import Trail
    from wakefold.forecast.score import score
    from wakefold.forecast.scores import Scores
    from wakefold.io.read import read_tracks
    from wakefold.io.write import write_tracks
    from wakefold.model.deviation import Deviation
    from wakefold.model.filtration import Filtration
    from wakefold.model.linkage.distance import frechet, frechet_matrix
    from wakefold.model.model import Model, learn, load
    from wakefold.relations.detections import Detections
    from wakefold.relations.filter import RelationalFilter
    from wakefold.relations.model import Activity, ConstantVelocity, PairEvidence, Relation, RelationalModel, Sampler
    from wakefold.relations.scene import Scene
    from wakefold.tracks.tracks import Tracks

_WHERE = {  # looked up on first use: importing the package costs no numba, pyarrow or matplotlib
    "Activity": "relations.model",
    "BL1": "filters.bootstrap",
    "BL2": "filters.bootstrap",
    "Belief": "filters.belief",
    "Calibrated": "filters.calibrated",
    "CoarseClass": "evidence.coarse",
    "Confusion": "evidence.confusion",
    "ConstantVelocity": "relations.model",
    "Detections": "relations.detections",
    "Deviation": "model.deviation",
    "Filtration": "model.filtration",
    "Fix": "evidence.fix",
    "GaussianHMM": "filters.hmm",
    "MHPF": "filters.mhpf",
    "Model": "model.model",
    "PairEvidence": "relations.model",
    "Relation": "relations.model",
    "RelationalFilter": "relations.filter",
    "RelationalModel": "relations.model",
    "Sampler": "relations.model",
    "Scene": "relations.scene",
    "Scores": "forecast.scores",
    "Tracks": "tracks.tracks",
    "Trail": "filters.trail",
    "frechet": "model.linkage.distance",
    "frechet_matrix": "model.linkage.distance",
    "learn": "model.model",
    "load": "model.model",
    "read_tracks": "io.read",
    "score": "forecast.score",
    "write_tracks": "io.write",
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
    "Trail",
    "Deviation",
    "Confusion",
    "GaussianHMM",
    "score",
    "Scores",
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
