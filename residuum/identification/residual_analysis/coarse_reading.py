"""Outputs that are read in steps so coarse that most samples repeat the one before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.physics import Experiment
from residuum.identification.residual_analysis.policy.records import COARSE_EVENNESS, COARSE_REPEATS


def reading_variances(experiments: Sequence[Experiment]) -> FloatArray:
    """q²/12 of each output that lies on stairs of step q and mostly repeats itself, 0 of the others, shape (outputs,).

    Between two steps such an output says nothing new. Its error would pass for noise that is nearly integrated, which no slow
    error of a model can be told from.
    """
    changes = np.concatenate([np.diff(e.Y, axis=0) for e in experiments])
    return np.array([_step(each) ** 2 / 12.0 for each in changes.T])


def _step(changes: FloatArray) -> float:
    """The smallest change, if most samples do not change and the others by whole numbers of it; else 0."""
    known = np.abs(changes[np.isfinite(changes)])
    moving = known[known > 0.0]
    if not moving.size or moving.size > (1.0 - COARSE_REPEATS) * known.size:
        return 0.0
    steps = moving / np.min(moving)
    return float(np.min(moving)) if np.max(np.abs(steps - np.round(steps))) < COARSE_EVENNESS else 0.0
