"""Several objects and what they are to each other (Manfredotti et al. 2011): the model in the user's words."""

from wakefold.relations.model import (
    Activity,
    ConstantVelocity,
    Coupling,
    PairEvidence,
    Relation,
    RelationalModel,
    Sampler,
    couple_velocity,
    follow_velocity,
)
from wakefold.relations.predicates import Predicate, ahead, closing, near, same_velocity, seen, slow

__all__ = [
    "Activity",
    "ConstantVelocity",
    "Coupling",
    "PairEvidence",
    "Predicate",
    "Relation",
    "RelationalModel",
    "Sampler",
    "ahead",
    "closing",
    "couple_velocity",
    "follow_velocity",
    "near",
    "same_velocity",
    "seen",
    "slow",
]
