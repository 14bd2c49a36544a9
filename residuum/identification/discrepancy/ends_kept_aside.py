"""The last question to an improvement: does it simulate better what none of it was estimated on, the end of a record, or of
several the most different one?

Blocks between others are interpolated. Values that go astray outside of what was seen show at the end of a record, or on another
one, so the model is estimated without it once more, with the effects and without them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from residuum.identification.discrepancy.kept_aside import Split, matched_at, rmse_aside, split, testing_of
from residuum.identification.discrepancy.policy import KEPT_RISE
from residuum.identification.physics import PhysicalModel
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import data_of, long_enough
from residuum.identification.unseen_blocks.structure import fitted
from residuum.identification.unseen_blocks.tried import Search


def first_that_holds(
    base: PhysicalModel,
    models: Sequence[PhysicalModel],
    found: Search,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
) -> int | None:
    """The first of the `models` that leaves no more error than `base` where data are kept aside: at the end, and on the most
    different record; nor over whole records, where they were judged in windows. None where none does; the first of all where the
    records are too short to ask.
    """
    asked = _kept_aside(records)
    if found.court.last.windows > 1:  # whose first states hide where a model goes in the long run
        asked.append(Split(list(records), [(record, 0) for record in records]))
    asked = [parts for parts in asked if parts.testing and long_enough([r.n for r in parts.training])]
    most = [KEPT_RISE * _error(base, found, parts, mapping) for parts in asked]
    for number, model in enumerate(models):
        if all(_error(model, found, parts, mapping) <= limit for parts, limit in zip(asked, most, strict=True)):
            return number
    return None


def _kept_aside(records: Sequence[Record]) -> list[Split]:
    """The usual part, and of several records the one that goes furthest beyond the others, where the usual part is not that."""
    usual = split(records)
    if len(records) < 2:
        return [usual]
    most = max(records, key=lambda record: _beyond(record, [other for other in records if other is not record]))
    if [record for record, _ in usual.testing] == [most]:
        return [usual]
    return [usual, Split([record for record in records if record is not most], [(most, 0)])]


def _beyond(record: Record, others: Sequence[Record]) -> float:
    """By how much a record's signals leave the range of the same signals of the others, in units of that range, at most."""
    far = 0.0
    for name, values in record.channels.items():
        known = [other.channels[name] for other in others if name in other.channels]
        there = np.concatenate(known) if known else np.empty(0)
        if np.isfinite(values).any() and np.isfinite(there).any():
            low, high = float(np.nanmin(there)), float(np.nanmax(there))
            out = max(low - float(np.nanmin(values)), float(np.nanmax(values)) - high)
            far = max(far, out / max(high - low, 1e-300))
    return far


def _error(model: PhysicalModel, found: Search, parts: Split, mapping: Mapping[str, str] | None) -> float:
    """Simulation error over what is kept aside, estimated on the rest, the outputs in units of the first model's errors; infinite
    where it diverges.
    """
    hold, scale = found.court.data.experiments[0].hold, found.court.scale
    data = data_of(*matched_at(model, parts.training, mapping, hold))
    estimated = fitted(data.model, data.rung(found.court.last.windows), None, scale, steps=20, tolerance=1e-5)
    if estimated is None:
        return np.inf
    return scale.error(rmse_aside(estimated.model, testing_of(estimated.model, parts, mapping, hold)))
