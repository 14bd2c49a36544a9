"""The last question to an improvement: does it simulate better what none of it was estimated on, the end of a record?

Blocks between others are interpolated. Values that go astray outside of what was seen show at the end of a record, or on another
one, so the model is estimated without it once more, with the effects and without them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.held_out import Split, split
from residuum.identification.discrepancy.policy.acceptance import KEPT_RISE
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import PhysicalModel, Settings, Simulator, estimate, match
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import FEWEST_SAMPLES, data_of
from residuum.identification.unseen_blocks.search import Search
from residuum.identification.unseen_blocks.structure import fitted

FloatArray = npt.NDArray[np.float64]
_STATES = Settings(iterations=20, tolerance=1e-4)


def steps_that_hold(
    models: Sequence[PhysicalModel], found: Search, records: Sequence[Record], mapping: Mapping[str, str] | None
) -> int:
    """How many of the `models` after the first, each with one effect more, can be kept so that no output is simulated worse at
    the end than by the first; all of them where the records are too short to ask.
    """
    parts = split(records)
    if min(r.n for r in parts.training) < FEWEST_SAMPLES or not parts.testing:
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
    return _left(estimated.model, parts, mapping, hold)


def _left(model: PhysicalModel, parts: Split, mapping: Mapping[str, str] | None, hold: FloatArray) -> FloatArray:
    """First states come from the samples before those that count, or where all count from the record itself."""
    simulator, left = Simulator(model), []
    for record, first in parts.testing:
        _, (e,) = match(model, [record], mapping)
        e = replace(e, hold=hold)
        seen = replace(e, Y=np.where(np.arange(e.n)[:, None] < first, e.Y, np.nan)) if first else e
        try:
            start = estimate(model, [seen], free=(), settings=_STATES)
        except NotIdentifiable:
            return np.full(len(model.outputs), np.inf)
        run = simulator.run_each([e], start.initial, simulator.p(), substeps=start.substeps)
        left.append(run.errors[first:])
    joined = np.concatenate(left)
    count = np.isfinite(joined).sum(axis=0)
    return np.where(count > 0, np.sqrt(np.nansum(joined**2, axis=0) / np.maximum(count, 1)), np.nan)
