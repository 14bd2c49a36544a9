"""Whether inputs were held over their sample or moved evenly to the next one: what the data say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.physics import Estimate, Experiment
from residuum.identification.residual_analysis.policy.noise import NOISE_ORDER
from residuum.identification.residual_analysis.structured_error import lasting_noise
from residuum.identification.side_by_side import side_by_side

FloatArray = npt.NDArray[np.float64]


def turned_timing(experiments: Sequence[Experiment]) -> list[Experiment]:
    """Inputs that were held now move evenly, and those that moved are held."""
    return [replace(e, hold=1.0 - e.hold) for e in experiments]


def at_likelier_timing(
    experiments: Sequence[Experiment], fitted: Callable[[list[Experiment]], Estimate]
) -> tuple[list[Experiment], Estimate]:
    """What is fitted with inputs held over their samples or moving evenly between them, whichever leaves the smaller innovations.

    The two conventions differ by half a sample. A good record shows the wrong one as a structured error of its own, and as
    parameters that lie many standard deviations beside the truth. Where noise is slow the error itself does not tell them apart:
    half a sample is fast.
    """

    def tried(turned: list[Experiment]) -> tuple[list[Experiment], Estimate] | NotIdentifiable:
        try:
            return turned, fitted(turned)
        except NotIdentifiable as diverges:
            return diverges

    first, other = side_by_side(tried, [list(experiments), turned_timing(experiments)])
    if isinstance(first, NotIdentifiable):
        raise first
    return (
        first
        if isinstance(other, NotIdentifiable) or innovations_of(first[1].residuals) <= innovations_of(other[1].residuals)
        else other
    )


def innovations_of(residuals: Sequence[FloatArray]) -> float:
    """Logarithm of the variance of residuals' innovations, summed over the outputs that were measured."""
    outputs = range(residuals[0].shape[1])
    logarithms = [np.log(max(innovation_variance([r[:, o] for r in residuals]), 1e-300)) for o in outputs]
    return float(np.nansum(logarithms))


def innovation_variance(residuals: Sequence[FloatArray]) -> float:
    """Of one output's residuals; their own where they are too few to tell a colour, NaN where they were not measured."""
    try:
        return lasting_noise(residuals, NOISE_ORDER).innovation_variance
    except BadInput:
        known = np.concatenate([r[np.isfinite(r)] for r in residuals])
        return float(np.mean(known**2)) if known.size else np.nan
