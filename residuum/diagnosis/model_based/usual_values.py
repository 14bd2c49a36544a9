"""The values that a healthy machine has under a window's conditions: a window is followed with them, not with the model's.

A warm winding's resistance is not the model's. Held against the model's value a window tells the difference to first order only,
and everything that happens beside it is told with slopes along the wrong track.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.detection import Group
from residuum.diagnosis.model_based.healthy_scatter import HealthyScatter
from residuum.diagnosis.model_based.hypotheses import Hypothesis
from residuum.identification.physics import PhysicalModel

Array = npt.NDArray[np.float64]


def usual_values(
    model: PhysicalModel, listed: Sequence[Hypothesis], groups: Sequence[Group], scatter: HealthyScatter, conditions: Array
) -> tuple[dict[str, float], Array]:
    """The model's values with those that are usual under these conditions, and how far each size was moved, in its unit."""
    values, mean, moved = dict(model.values), scatter.mean(conditions) * scatter.scale, np.zeros(len(scatter.scale))
    for h, group in zip(listed, groups, strict=True):
        column, at = h.columns[0], group.sizes[0]
        if column.acts_on.startswith("parameter:") and mean[at]:
            name = column.acts_on.removeprefix("parameter:")
            there = float(np.clip(values[name] + mean[at], column.lower, column.upper))
            values[name], moved[at] = there, there - values[name]
    return values, moved
