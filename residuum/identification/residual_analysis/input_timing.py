"""Whether inputs were held over their sample or moved evenly to the next one: what the data say."""

from __future__ import annotations

from collections.abc import Callable, Sequence

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
    return [e.turned(np.ones(len(e.hold), dtype=bool)) for e in experiments]


def each_turned(experiments: Sequence[Experiment]) -> list[list[Experiment]]:
    """The other timing of one input alone, once for each of several that change; of a single one nothing more than all turned."""
    changes = np.any([np.ptp(e.U, axis=0) > 0 for e in experiments], axis=0)
    if changes.sum() < 2:
        return []
    return [[e.turned(np.arange(len(changes)) == k) for e in experiments] for k in np.flatnonzero(changes)]


def at_likelier_timing(
    experiments: Sequence[Experiment], fitted: Callable[[list[Experiment]], Estimate]
) -> tuple[list[Experiment], Estimate]:
    """What is fitted with inputs held over their samples or moving evenly between them, whichever leaves the smaller innovations.

    The two conventions differ by half a sample. A good record shows the wrong one as a structured error of its own, and as
    parameters that lie many standard deviations beside the truth. Where noise is slow the error itself does not tell them apart:
    half a sample is fast. All inputs are turned at once, then each of several for itself: one may be a controller's, which holds,
    and another a measured one.
    """

    def tried(turned: list[Experiment]) -> tuple[list[Experiment], Estimate] | NotIdentifiable:
        try:
            return turned, fitted(turned)
        except NotIdentifiable as diverges:
            return diverges

    first, other = side_by_side(tried, [list(experiments), turned_timing(experiments)])
    if isinstance(first, NotIdentifiable):
        raise first
    best = _likelier([first, other])
    return _likelier([best, *side_by_side(tried, each_turned(best[0]))])


def _likelier(tried: Sequence[tuple[list[Experiment], Estimate] | NotIdentifiable]) -> tuple[list[Experiment], Estimate]:
    fits = [each for each in tried if not isinstance(each, NotIdentifiable)]
    return min(fits, key=lambda fit: innovations_of(fit[1].residuals))


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
