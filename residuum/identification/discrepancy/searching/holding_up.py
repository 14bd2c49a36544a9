"""Whether an effect holds up on data that were not used for its estimation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structure_comparison import mean_ratio, simulates_no_worse
from residuum.identification.discrepancy.fitting.structures import Structure, times_its_innovations
from residuum.identification.discrepancy.improving.held_out import cross_checked
from residuum.identification.discrepancy.policy.acceptance import (
    FIRST_RISE,
    LATER_FALL,
    OF_THE_READING,
    PLAIN_GAIN,
    PLAINLY_LESS,
    READING_FALL,
)
from residuum.identification.discrepancy.searching.evidence import tempered_gain
from residuum.identification.discrepancy.searching.search_state import Search
from residuum.identification.physics import Experiment, Key
from residuum.identification.residual_analysis.policy.noise import SLOW
from residuum.identification.side_by_side import side_by_side

FloatArray = npt.NDArray[np.float64]


def holds_up(found: Search, key: Key, better: Structure, experiments: Sequence[Experiment]) -> bool:
    """Whether the effect raises neither the simulation error nor that on data which were not used for the estimation.

    An unmeasured disturbance can let the likelihood win by the fast part of the error alone, while what the user sees grows.
    Where the end of the record shows what the rest never did (a tank that runs over), its beginning has a say.
    """
    plain = tempered_gain(better, found.best) > PLAIN_GAIN
    doubted = 1.0 if plain else LATER_FALL
    rise = doubted if found.accepted or times_its_innovations(better) > SLOW else FIRST_RISE
    if not simulates_no_worse(better, found.best, rise):
        return False
    if _is_the_readings(found.best, better):
        return False
    errors = held_out_errors(found.best, better, experiments)
    if errors is None:
        return True
    found.held_out[key] = errors
    ratio = mean_ratio(errors[1], errors[0])
    if ratio < (doubted if found.accepted else FIRST_RISE):
        return True
    other = held_out_errors(found.best, better, experiments, end=False)
    if other is None or np.sqrt(ratio * mean_ratio(other[1], other[0])) > PLAINLY_LESS:
        return False
    found.held_out[key] = other
    return True


def held_out_errors(
    before: Structure, after: Structure, experiments: Sequence[Experiment], *, end: bool = True
) -> tuple[FloatArray, FloatArray] | None:
    """`cross_checked` errors of two structures; None where one has none."""
    errors = side_by_side(lambda structure: cross_checked(structure, experiments, end=end), (before, after))
    return None if errors[0] is None or errors[1] is None else (errors[0], errors[1])


def _is_the_readings(before: Structure, better: Structure) -> bool:
    """Whether what falls is the error of outputs that are read coarsely, and falls little.

    A machine that stands, or turns at few speeds, errs there by up to half a step, always the same: any effect may take that up.
    """
    read = before.rmse**2 < OF_THE_READING * before.reading
    ratio = better.rmse / before.rmse
    return bool(read.any() and not np.any(ratio < np.where(read, READING_FALL, LATER_FALL)))
