"""Held values: parameters that a model holds fixed, where the records ask for another value.

A mass that is a tenth too large looks like an elasticity or a load. An estimate of what is free cannot mend it, and the likeliest
effect stands in for it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from residuum.identification.physics import PhysicalModel
from residuum.identification.unseen_blocks.policy import HELD_REACH

HELD = "value"
"""In the place of an effect's id: a parameter that the model fixes is free."""


@dataclass(frozen=True)
class HeldValue:
    """A parameter's value in the model, where it is fixed, and the one that the records ask for, with its standard deviation.

    Of the parameters in `indistinguishable_from` another value would do as much (a mass, or the area that drives it).
    """

    name: str
    held: float
    value: float
    std: float
    unit: str
    indistinguishable_from: tuple[str, ...]


def freed(model: PhysicalModel, names: Iterable[str]) -> PhysicalModel:
    """The model with these of its fixed parameters free, within reach of their values."""
    known = dict(model.parameters)
    for name in names:
        p = known[name]
        low, high = sorted(((1.0 - HELD_REACH) * p.value, (1.0 + HELD_REACH) * p.value))
        known[name] = replace(p, fixed=False, lower=max(low, p.lower), upper=min(high, p.upper))
    return replace(model, parameters=known)
