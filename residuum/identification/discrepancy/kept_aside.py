"""Records, or the end of one, that are kept aside from the search and counted at its end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import PhysicalModel, Settings, Simulator, estimate, match
from residuum.identification.record import Record

Array = npt.NDArray[np.float64]
IN_TURN = "every block in turn"
"""What is kept aside, in words, where the judge's blocks are all."""
_STATES = Settings(iterations=20, tolerance=1e-4)


@dataclass(frozen=True, eq=False)
class Split:
    """`training` records, and `testing` ones each with the sample from which it counts (0: the whole record); none where the
    judge's own blocks are what is kept aside.
    """

    training: list[Record]
    testing: list[tuple[Record, int]]

    @property
    def aside(self) -> str:
        """What is kept aside, in words."""
        spans = [(r.t0 + first * r.sample_time, r.t0 + r.n * r.sample_time, Path(r.source).name) for r, first in self.testing]
        return ", ".join(f"{start:.4g} to {end:.4g} s of {name or 'the record'}" for start, end, name in spans) or IN_TURN


def split(records: Sequence[Record]) -> Split:
    """Several records: every third is kept aside (of two, the second). One: what comes after its note `split: 0.7`, else
    nothing.
    """
    if len(records) > 1:
        testing = [k for k in range(len(records)) if k % 3 == 2] or [len(records) - 1]
        return Split([r for k, r in enumerate(records) if k not in testing], [(records[k], 0) for k in testing])
    (record,) = records
    if record.split is None:
        return Split([record], [])
    first = int(record.n * record.split)
    return Split([record.window(0, first)], [(record, first)])


def error_on(model: PhysicalModel, parts: Split, mapping: Mapping[str, str] | None, hold: Array) -> Array:
    """RMS simulation error of each output over the samples that count; ∞ where the model diverges, NaN where none was measured.

    First states come from the samples before those that count, or where all count from the record itself.
    """
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
