"""The last question to an improvement: does it simulate better what none of it was estimated on, the end of a record?

Blocks between others are interpolated. Values that go astray outside of what was seen show at the end of a record, or on another
one, so the model is estimated without it once more, with the effects and without them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.improving.held_out import Split, rmse_aside, split
from residuum.identification.discrepancy.policy.acceptance import KEPT_RISE
from residuum.identification.physics import PhysicalModel, match
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import FEWEST_TO_CUT, data_of
from residuum.identification.unseen_blocks.search import Search
from residuum.identification.unseen_blocks.structure import fitted

FloatArray = npt.NDArray[np.float64]


def steps_that_hold(
    models: Sequence[PhysicalModel], found: Search, records: Sequence[Record], mapping: Mapping[str, str] | None
) -> int:
    """How many of the `models` after the first, each with one effect more, can be kept so that no output is simulated worse at
    the end than by the first. It is all of them where the records are too short to ask.
    """
    parts = split(records)
    if min(r.n for r in parts.training) < FEWEST_TO_CUT or not parts.testing:
        return len(models) - 1
    most = KEPT_RISE * _error(models[0], found, parts, mapping)
    for kept in reversed(range(1, len(models))):
        if not np.any(_error(models[kept], found, parts, mapping) > most):
            return kept
    return 0


def _error(model: PhysicalModel, found: Search, parts: Split, mapping: Mapping[str, str] | None) -> FloatArray:
    """RMS simulation error of each output over what is kept aside, estimated on the rest; infinite where it diverges."""
    hold = found.court.data.experiments[0].hold
    matched, experiments = match(model, parts.training, mapping)
    data = data_of(matched, [replace(e, hold=hold) for e in experiments])
    rung = next((r for r in data.rungs if r.windows == found.court.last.windows), data.rungs[-1])
    estimated = fitted(data.model, rung.parts, None, found.court.scale, steps=20, tolerance=1e-5)
    if estimated is None:
        return np.full(len(model.outputs), np.inf)
    _, aside = match(estimated.model, [record for record, _ in parts.testing], mapping)
    testing = [(replace(e, hold=hold), first) for e, (_, first) in zip(aside, parts.testing, strict=True)]
    return rmse_aside(estimated.model, testing)
