"""Which data a model is estimated from, which are kept aside to judge it, and its error on those."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structure_fits import fit_structure
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.policy.likelihood import AGAIN_STEPS, STATES_ALONE
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import Experiment, PhysicalModel, Simulator, estimate
from residuum.identification.record import Record
from residuum.identification.residual_analysis.policy.records import FEWEST_TO_SPLIT, STANDS_STILL, TRAINING_SHARE

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Split:
    """`training` records, and `testing` ones each with the sample from which it counts (0: the whole record)."""

    training: list[Record]
    testing: list[tuple[Record, int]]

    @property
    def aside(self) -> str:
        """What is kept aside, in words."""
        spans = [(r.t0 + first * r.sample_time, r.t0 + r.n * r.sample_time, Path(r.source).name) for r, first in self.testing]
        return ", ".join(f"{start:.4g} to {end:.4g} s of {name or 'the record'}" for start, end, name in spans)


def split(records: Sequence[Record], *, end: bool = True) -> Split:
    """Several records: every third is kept aside (of two, the second). One: its end, by its note `split: 0.7` or 30 %; or as
    much of its beginning.

    A part in which the record stands still judges nothing: then the beginning is kept aside, or the middle.
    """
    if len(records) > 1:
        testing = [k for k in range(len(records)) if k % 3 == 2] or [len(records) - 1]
        return Split([r for k, r in enumerate(records) if k not in testing], [(records[k], 0) for k in testing])
    record = records[0]
    first = int(record.n * (record.split or TRAINING_SHARE))
    aside, middle = record.n - first, first // 2
    spans = [(first, record.n), (0, aside)] if end else [(0, aside), (first, record.n)]
    wanted = spans[:1] if record.split is not None else [*spans, (middle, middle + aside)]
    begin, stop = next((span for span in wanted if _moves(record, *span)), wanted[0])
    if stop == record.n:
        return Split([record.window(0, begin)], [(record, begin)])
    rest = [record.window(0, begin), record.window(stop, record.n)] if begin else [record.window(stop, record.n)]
    return Split(rest, [(record.window(begin, stop), 0)])


def _moves(record: Record, begin: int, stop: int) -> bool:
    """Whether every channel that changes in the record does so in this part of it too."""
    with np.errstate(invalid="ignore"):
        for values in record.channels.values():
            whole, part = np.nanstd(values), np.nanstd(values[begin:stop]) if np.isfinite(values[begin:stop]).any() else 0.0
            if whole > 0.0 and part < STANDS_STILL * whole:
                return False
    return True


def split_experiments(
    experiments: Sequence[Experiment], *, end: bool = True
) -> tuple[list[Experiment], list[tuple[Experiment, int]], list[int], list[int]]:
    """Experiments to estimate from, those to judge by with the sample from which each counts, and the numbers of both.

    Of three or more every third is kept aside, the last of them or the first; of fewer 30 % of each, its end or its beginning.
    """
    if len(experiments) >= 3:
        left_out = 2 if end else 0
        kept = [k for k in range(len(experiments)) if k % 3 != left_out]
        aside = list(range(left_out, len(experiments), 3))
        return [experiments[k] for k in kept], [(experiments[k], 0) for k in aside], kept, aside
    kept = [k for k, e in enumerate(experiments) if e.n >= FEWEST_TO_SPLIT]
    long = [experiments[k] for k in kept]
    firsts = [int(TRAINING_SHARE * e.n) for e in long]
    if end:
        testing = list(zip(long, firsts, strict=True))
        return [e.window(0, first) for e, first in testing], testing, kept, kept
    asides = [e.n - first for e, first in zip(long, firsts, strict=True)]
    training = [
        replace(e, Y=np.where(np.arange(e.n)[:, None] < aside, np.nan, e.Y)) for e, aside in zip(long, asides, strict=True)
    ]
    return training, [(e.window(0, aside), 0) for e, aside in zip(long, asides, strict=True)], kept, kept


def held_out_rmse(
    structure: Structure, testing: Sequence[tuple[Experiment, int]], initial: Sequence[FloatArray] | None = None
) -> FloatArray:
    """`rmse_aside` of a structure's model."""
    return rmse_aside(structure.model, testing, initial)


def rmse_aside(
    model: PhysicalModel, testing: Sequence[tuple[Experiment, int]], initial: Sequence[FloatArray] | None = None
) -> FloatArray:
    """RMS simulation error of each output over the samples that count; ∞ where the model diverges.

    Initial states come from the samples before those that count, or where all count from the experiment itself; they are sought
    from `initial` on. One of which none counts (the first that would is its end) lends what its effects remember to the one that
    follows it.
    """
    simulator, experiments = Simulator(model), [e for e, _ in testing]
    seen = [replace(e, Y=np.where(np.arange(e.n)[:, None] < first, e.Y, np.nan)) if first else e for e, first in testing]
    try:
        start = estimate(model, seen, free=(), initial=initial, settings=STATES_ALONE)
    except NotIdentifiable:
        return np.full(len(model.outputs), np.inf)
    runs = simulator.run_each(experiments, start.initial, simulator.p(), substeps=start.substeps)
    joined = np.concatenate([(e.Y - run.Y)[first:] for (e, first), run in zip(testing, runs, strict=True)])
    count = np.isfinite(joined).sum(axis=0)
    return np.where(count > 0, np.sqrt(np.nansum(joined**2, axis=0) / np.maximum(count, 1)), np.nan)


def cross_checked(structure: Structure, experiments: Sequence[Experiment], *, end: bool = True) -> FloatArray | None:
    """`held_out_rmse` of a structure re-estimated on the other part of its experiments; None when that cannot be done."""
    training, testing, kept, aside = split_experiments(experiments, end=end)
    if not training:
        return None
    if Simulator(structure.model).remembers and any(b.follows(a) for a, b in pairwise(experiments)):
        training, testing = _in_sequence(experiments, kept)
        kept = aside = list(range(len(experiments)))
    initial = [structure.initial[k] for k in kept]
    again = fit_structure(structure.model, training, initial, iterations=AGAIN_STEPS, second_start=False)
    return None if again is None else held_out_rmse(again, testing, [structure.initial[k] for k in aside])


def _in_sequence(experiments: Sequence[Experiment], kept: Sequence[int]) -> tuple[list[Experiment], list[tuple[Experiment, int]]]:
    """As `split_experiments`, of windows through which effects remember: those kept aside are there, unmeasured."""
    training = [e if k in kept else replace(e, Y=np.full_like(e.Y, np.nan)) for k, e in enumerate(experiments)]
    testing = [(e, e.n if k in kept else 0) for k, e in enumerate(experiments)]
    return training, testing
