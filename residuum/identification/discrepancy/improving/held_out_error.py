"""The error on data kept aside, by which effects that were found are kept or dropped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structures import Structure, innovation_scales
from residuum.identification.discrepancy.fitting.unseen_errors import blocks_of, remaining_of, unseen
from residuum.identification.discrepancy.improvement import Step
from residuum.identification.discrepancy.improving.held_out import Split, held_out_rmse
from residuum.identification.physics import Experiment, PhysicalModel, match
from residuum.identification.record import Record
from residuum.identification.residual_analysis.prediction_windows import in_windows

FloatArray = npt.NDArray[np.float64]


class HeldOutError:
    """Simulation error on the data that were kept aside, on one output: the one whose error stands highest above its noise."""

    def __init__(
        self,
        parts: Split,
        experiments: Sequence[Experiment],
        base: Structure,
        mapping: Mapping[str, str] | None,
        finer: int,
    ) -> None:
        self.testing = _reduced(base.model, parts.testing, mapping, experiments, finer)
        self.blocks = blocks_of(experiments)
        self.before = None if self.blocks is None else unseen(base, self.blocks)
        self.o = int(np.nanargmax(base.rmse / innovation_scales(base.noises)))
        self.output = list(base.model.outputs)[self.o]
        self.unit = base.model.outputs[self.output].unit

    def error(self, structure: Structure) -> float:
        """RMS over the held-out samples; their records' first states come from what precedes them, or from themselves."""
        return float(self.errors(structure)[self.o])

    def step(self, added: str | None, structure: Structure, error: float | None = None) -> Step:
        """The line of a history; its `error` where it is known already."""
        remaining = None
        if self.blocks is not None and self.before is not None:
            remaining = remaining_of(self.before, unseen(structure, self.blocks), structure, self.blocks)
        return Step(added, self.error(structure) if error is None else error, remaining=remaining)

    def errors(self, structure: Structure) -> FloatArray:
        """The same of every output; NaN where one is never measured."""
        return held_out_rmse(structure, self.testing)


def _reduced(
    model: PhysicalModel,
    testing: Sequence[tuple[Record, int]],
    mapping: Mapping[str, str] | None,
    like: Sequence[Experiment],
    finer: int,
) -> list[tuple[Experiment, int]]:
    """Held-out records with the training experiments' input timing, blocks and windows, and their first held-out sample."""
    model, experiments = match(model, [record for record, _ in testing], mapping)
    found = []
    for e, (_, first) in zip(experiments, testing, strict=True):
        timed = replace(e, hold=like[0].hold, block=like[0].block)
        parts = in_windows(model, [timed], finer)
        later = [(part, 0) for part in parts if round((part.t0 - timed.t0) / timed.sample_time) >= first]
        found += [(timed, first)] if len(parts) == 1 else later
    return found
