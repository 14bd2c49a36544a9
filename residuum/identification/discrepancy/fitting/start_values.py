"""First values of a candidate, kept within bounds and near where they may be believed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from residuum.identification.discrepancy.policy.trials import BASE_STEP, SHAPE_STEP, SMALL_START
from residuum.identification.physics import PhysicalModel
from residuum.identification.physics.model import find_effect


def inside_bounds(model: PhysicalModel, id: str, target: str, values: Mapping[str, float]) -> dict[str, float]:
    """The values moved to within their bounds."""
    declared = {p.name: p for p in find_effect(id).parameters(model.site(target, find_effect(id)))}
    return {n: float(np.clip(v, declared[n].lower, declared[n].upper)) for n, v in values.items() if n in declared}


def clipped_step(model: PhysicalModel, values: dict[str, float], start: dict[str, float] | None) -> PhysicalModel:
    """The model at `values`, each within its bounds.

    None is moved beyond `BASE_STEP` times a base value, nor `SHAPE_STEP` times the start of an effect without a zero.

    A size that the first-order step put at or below nothing begins at `SMALL_START` of its start.
    """
    known = model.all_parameters
    label = model.effects[-1].label
    found = {}
    for name, value in values.items():
        p = known[name]
        if name.startswith(f"{label}."):
            if start is None and p.value:
                low, high = sorted((p.value / SHAPE_STEP, p.value * SHAPE_STEP))
                value = float(np.clip(value, low, high))
            value = float(np.clip(value, p.lower, p.upper))
            short = name.removeprefix(f"{label}.")
            if start is not None and value == p.lower and p.lower == 0.0:
                value = SMALL_START * start[short]
        else:
            low, high = sorted((p.value / BASE_STEP, p.value * BASE_STEP))
            value = float(np.clip(value, max(low, p.lower), min(high, p.upper))) if p.value else value
        found[name] = value
    return model.with_values(found)
