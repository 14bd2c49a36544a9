"""Where the machine was and what its balances lacked, as the measurements of a structure's experiments show them.

A score test linearises along the model's own simulation. Where that has gone astray (an arm without its weight, an axis that a
cog holds) no derivative there points to the effect. The Kalman filter stays with the machine: along its states, the term
of an effect that is missing resembles the missing term of its balance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.physics import Experiment, PhysicalModel
from residuum.identification.physics.simulate.kalman import Filter, first_noise
from residuum.identification.unseen_blocks.following import Track, joined

FloatArray = npt.NDArray[np.float64]


def track(model: PhysicalModel, base: Structure, experiments: Sequence[Experiment], simulated: Sequence[FloatArray]) -> Track:
    """The model's smoothed states in every experiment; those `simulated`, and nothing missing, where the filter diverges."""
    kalman = Filter(model, first_noise(model, list(experiments)))
    states, lacks = [], []
    for e, x, steps, X in zip(experiments, base.initial, base.substeps, simulated, strict=True):
        found = kalman.run(e, x, substeps=None if model is not base.model else steps)
        missing = {balance: found.missing[balance].value for balance in kalman.balances}
        follows = bool(np.all(np.isfinite(found.X)) and all(np.all(np.isfinite(w)) for w in missing.values()))
        states.append(found.X if follows else X)
        lacks.append({b: missing[b] if follows and b in missing else np.zeros(e.n) for b in model.balances})
    return joined(model, experiments, states, lacks)
