"""Records matched once: experiments at the likelier input timing, blocks, and windows from short to
the whole record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadRecord
from residuum.identification.physics import Experiment, PhysicalModel, match, windows
from residuum.identification.physics.estimation.gauss_newton import Cells
from residuum.identification.record import Record
from residuum.identification.residual_analysis.feedback import each_turned, turned_timing
from residuum.identification.residual_analysis.followed import check_followed
from residuum.identification.residual_analysis.lower_rate import at_lower_rate
from residuum.identification.unseen_blocks.policy import (
    BLIND,
    BLOCK_SAMPLES,
    BLOCKS,
    FEWEST_TO_JUDGE,
    FOLDS,
    WINDOW_SAMPLES,
    WINDOWS_A_RECORD,
)

Integers = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Horizon:
    """All records in so many `windows` each; `block` (rows,) is each row's block, `experiment`
    (parts,) where a part lies.
    """

    windows: int
    parts: list[Experiment]
    block: Integers
    experiment: Integers

    @property
    def starts(self) -> Integers:
        """First row of each part, and the end of the last one."""
        return np.cumsum([0, *(part.n for part in self.parts)])

    @cached_property
    def cells(self) -> Cells:
        """The rows of each window in each block."""
        return Cells.of(self.parts, self.block)

    def thinned(self, samples: int, errors: FloatArray | None = None) -> tuple[Horizon, list[int]]:
        """About so many samples of the parts, and which parts those are: evenly, or, where these
        hold little of the errors (parts,), those that hold most.
        """
        stride = max(1, round(sum(part.n for part in self.parts) / samples))
        chosen = np.arange(len(self.parts))[::stride]
        # a stop that the machine meets in few windows shows in none of those chosen evenly
        if errors is not None:
            above_least = errors - errors.min()
            if np.mean(above_least[chosen]) < BLIND * np.mean(above_least):
                chosen = np.sort(np.argsort(-errors)[: len(chosen)])
        rows = np.isin(np.repeat(np.arange(len(self.parts)), np.diff(self.starts)), chosen)
        parts = [self.parts[k] for k in chosen]
        thinned = Horizon(self.windows, parts, self.block[rows], self.experiment[chosen])
        return thinned, chosen.tolist()


@dataclass(frozen=True, eq=False)
class Data:
    """Records in a model's terms.

    Attributes
    ----------
    model : PhysicalModel
        With the optional inputs that the records lack marked absent.
    experiments : list of Experiment
    measured : array, shape (outputs,)
    spread : array, shape (outputs,)
        Standard deviation of each output; 1 where it was not measured or stands still.
    horizons : tuple of Horizon
        From the shortest windows to whole records.
    fold : array, shape (blocks,)
        Which blocks are left out together.
    finer : Data or None
        At the rate of the records, where this is at a lower one.
    """

    model: PhysicalModel
    experiments: list[Experiment]
    measured: npt.NDArray[np.bool_]
    spread: FloatArray
    horizons: tuple[Horizon, ...]
    fold: Integers
    finer: Data | None = None

    @property
    def blocks(self) -> int:
        """How many there are."""
        return len(self.fold)

    def horizon(self, windows: int) -> Horizon:
        """The horizon with so many windows a record; whole records, where these are too short for
        so many.
        """
        return next(
            (horizon for horizon in self.horizons if horizon.windows == windows), self.horizons[-1]
        )

    def times_of(self, block: int) -> tuple[float, float]:
        """Begin and end of a block [s], in its record's time."""
        per_experiment = self.blocks // len(self.experiments)
        e, k = self.experiments[block // per_experiment], block % per_experiment
        return tuple(
            e.t0 + e.sample_time * np.ceil(e.n * edge / per_experiment) for edge in (k, k + 1)
        )

    def rows(self, horizon: Horizon) -> Integers:
        """Of each row of a horizon the row among all experiments, one after the other."""
        # a window knows where it begins by its time alone
        begins = np.cumsum([0, *(e.n for e in self.experiments)])
        indices = []
        for part, number in zip(horizon.parts, horizon.experiment, strict=True):
            e = self.experiments[number]
            indices.append(
                begins[number] + round((part.t0 - e.t0) / e.sample_time) + np.arange(part.n)
            )
        return np.concatenate(indices)


def matched(
    model: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None
) -> Data:
    """The records matched to the model.

    Raises
    ------
    BadRecord, BadUnit
        Records that do not fit the model, in which nothing changes, or too short for blocks.
    NotIdentifiable
        The model is unstable along a record, so that no simulation of it stays there.
    """
    model, experiments = match(model, records, mapping)
    check_moves(experiments)
    if not long_enough([e.n for e in experiments]):
        e = min(experiments, key=lambda e: e.n)
        least = f"at least {FEWEST_TO_JUDGE} in all and {FOLDS} in each record are needed"
        raise BadRecord(
            f"record {e.source!r}: {e.n} samples; {least}, to keep parts aside that judge what the"
            " rest explains"
        )
    check_followed(model, experiments)
    return data_of(model, experiments)


def long_enough(samples: Sequence[int]) -> bool:
    """Whether parts of records with so many samples can be kept aside."""
    return sum(samples) >= FEWEST_TO_JUDGE and min(samples) >= FOLDS


def data_of(model: PhysicalModel, experiments: list[Experiment]) -> Data:
    """Blocks and windows of experiments."""
    Y = np.concatenate([e.Y for e in experiments])
    measured = np.isfinite(Y).any(axis=0)
    # a unit for each output; of one that stands still any unit does
    spread = np.ones(Y.shape[1])
    spread[measured] = np.nanstd(Y[:, measured], axis=0)
    spread[~(spread > 0.0)] = 1.0
    # windows as short as the shortest record allows, and whole records in any case
    shortest = min(e.n for e in experiments)
    per_experiment, fold = folds_of(len(experiments), shortest)
    horizons = tuple(
        _horizon(experiments, k, per_experiment)
        for k in WINDOWS_A_RECORD
        if shortest // k >= WINDOW_SAMPLES or k == WINDOWS_A_RECORD[-1]
    )
    return Data(model, experiments, measured, spread, horizons, fold)


def folds_of(count: int, shortest: int) -> tuple[int, Integers]:
    """How many blocks each of so many experiments has, the shortest with so many samples, and which
    blocks are left out together (blocks,).
    """
    # so many in all, a multiple of the folds in each experiment, none shorter than a block may be
    blocks = BLOCKS if count == 1 else FOLDS * -(-BLOCKS // (FOLDS * count))
    blocks = max(FOLDS, min(blocks, FOLDS * (shortest // (FOLDS * BLOCK_SAMPLES))))
    block = np.arange(blocks * count)
    # Whole records are left out where there are several. Else every fourth block: each fold sees
    # all times of the record.
    return (blocks, (block // blocks if count >= FOLDS - 1 else block) % FOLDS)


def _horizon(experiments: Sequence[Experiment], count: int, blocks: int) -> Horizon:
    parts: list[Experiment] = []
    block, at = [], []
    for number, e in enumerate(experiments):
        shortest = -(
            -e.n // WINDOWS_A_RECORD[0]
        )  # so that every window begins where a shorter one does
        for part in (
            windows(e, shortest * (WINDOWS_A_RECORD[0] // count))
            if count > 1
            else [replace(e, block=1)]
        ):
            row = round((part.t0 - e.t0) / e.sample_time) + np.arange(part.n)
            block.append(np.minimum(row * blocks // e.n, blocks - 1) + number * blocks)
            parts.append(part)
            at.append(number)
    return Horizon(count, parts, np.concatenate(block), np.array(at))


def check_moves(experiments: Sequence[Experiment]) -> None:
    """Raise BadRecord where no signal of any experiment changes."""
    if not any(map(_changes, experiments)):
        raise BadRecord(
            f"record {experiments[0].source!r}: no input and no output changes in it; standstill"
            " explains nothing"
        )


def _changes(experiment: Experiment) -> bool:
    """Whether any signal of it does."""
    signals = [*experiment.U.T, *experiment.Y[:, experiment.measured].T]
    return any(np.nanmax(signal) > np.nanmin(signal) for signal in signals)


# Data at a lower rate that loses nothing.


def coarser(data: Data) -> Data:
    """The data at the lowest rate 1/2, 1/4, … of theirs that loses nothing and leaves enough
    samples, else themselves.
    """
    experiments, step = at_lower_rate(data.model, data.experiments)
    return data if step == 1 else replace(data_of(data.model, experiments), finer=data)


def turned(data: Data) -> Data:
    """The data at the other input timing: inputs that were held move evenly, and those that moved
    are held.
    """
    return _timed(data, turned_timing((data.finer or data).experiments))


def one_turned(data: Data) -> list[Data]:
    """The data with one of several inputs turned, each once."""
    return [
        _timed(data, experiments) for experiments in each_turned((data.finer or data).experiments)
    ]


def _timed(data: Data, experiments: list[Experiment]) -> Data:
    records = data_of(data.model, experiments)
    return coarser(records) if data.finer else records
