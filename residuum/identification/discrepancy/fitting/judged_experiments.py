"""The experiments that a search judges, at the likelier input timing, and the model estimated on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structure_fits import base_structure, plain_estimate
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import Experiment, PhysicalModel, match
from residuum.identification.record import Record
from residuum.identification.residual_analysis.averaged import averaged, liveliest
from residuum.identification.residual_analysis.feedback import feeds_back
from residuum.identification.residual_analysis.input_timing import turned_timing
from residuum.identification.residual_analysis.policy.noise import NOISE_ORDER
from residuum.identification.residual_analysis.policy.records import ANSWERED, MOST_INNOVATIONS, NORMAL_MEDIAN, OUTLYING
from residuum.identification.residual_analysis.prediction_windows import in_windows
from residuum.identification.side_by_side import side_by_side
from residuum.identification.unseen_blocks.data import check_moves

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Tried:
    """One timing: experiments, the model re-estimated on them, and whether an input answers the outputs' noise."""

    experiments: list[Experiment]
    base: Structure
    answered: bool


def experiments_and_base(
    model: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None, finer: int = 1
) -> tuple[list[Experiment], Structure]:
    """Experiments of at most about `MOST_INNOVATIONS`, and the model re-estimated on them, at the likelier input timing.

    Those of a plant that is judged in windows are cut so many times `finer`.

    The two conventions differ by half a sample; the wrong one looks like a delay or a lag of that size. Where a controller
    answers the noise, inputs were held, and no means are taken (`feedback`).

    Raises
    ------
    BadRecord, BadUnit
        Records that do not fit the model, or in which nothing changes.
    NotIdentifiable
        The model diverges on them.
    """
    model, experiments = match(model, records, mapping)
    check_moves(experiments)

    timings = [experiments, turned_timing(experiments)]
    tried = side_by_side(lambda turned: _estimated(model, turned, finer), timings)
    found = [one for one in tried if not isinstance(one, NotIdentifiable)]
    if not found:
        raise next(diverges for diverges in tried if isinstance(diverges, NotIdentifiable))
    held = [one for one in found if one.answered and not any(e.hold.any() for e in one.experiments)]
    best = max(held or found, key=lambda one: one.base.log_likelihood)
    return best.experiments, best.base


def _estimated(model: PhysicalModel, turned: list[Experiment], finer: int) -> _Tried | NotIdentifiable:
    """The model re-estimated at one timing; what says that it diverges where it does."""
    reduced = in_windows(model, averaged(turned, MOST_INNOVATIONS), finer)
    try:
        plain = plain_estimate(model, reduced)
        answered = feeds_back(plain.model, reduced, plain.residuals)
        if answered and any(e.block > 1 for e in reduced):
            reduced = in_windows(model, liveliest(turned, ANSWERED * MOST_INNOVATIONS), finer)
            plain = plain_estimate(plain.model, reduced)
        settled = [_late(e, r) for e, r in zip(reduced, plain.residuals, strict=True)]
        return _Tried(settled, base_structure(model, settled, plain), answered)
    except NotIdentifiable as diverges:
        return diverges


def _late(experiment: Experiment, residuals: FloatArray) -> Experiment:
    """The experiment without the first samples of outputs whose beginning the model does not explain.

    The first sample counts with its stationary density, which has no heavy tail. Where a record begins with a transient that the
    model has no state for (a winding that is switched on), that one sample would decide over all others.
    """
    size = np.abs(residuals[:, experiment.measured])
    outlying = np.flatnonzero(experiment.measured)[size[0] > OUTLYING * np.nanmedian(size, axis=0) / NORMAL_MEDIAN]
    if not outlying.size:
        return experiment
    Y = experiment.Y.copy()
    Y[: NOISE_ORDER * experiment.block, outlying] = np.nan
    return replace(experiment, Y=Y)
