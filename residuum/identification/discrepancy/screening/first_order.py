"""What a linearised model promises: least squares with re-estimated noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.fitting.whitened_least_squares import NormalEquations, Stacked
from residuum.identification.discrepancy.policy.likelihood import FLAT_DIRECTION, HOPELESS_NOISE
from residuum.identification.discrepancy.policy.trials import FALLEN, PROMISING_GAIN, WORTH_A_PASS
from residuum.identification.physics.estimation.least_squares import solve_scaled
from residuum.identification.residual_analysis.noise.innovations import Noises, fit_noises, pointwise_log_likelihood

FloatArray = npt.NDArray[np.float64]

_Fitted = tuple[FloatArray, FloatArray, list[FloatArray], Noises]
"""Step, pointwise log-likelihood, residuals and their noise after it."""


def first_order_fit(
    base: Structure,
    residuals: list[FloatArray],
    by_parameters: list[FloatArray],
    by_states: list[FloatArray],
    equations: NormalEquations | None = None,
    *,
    may_fall: bool = True,
    ridge: float = FLAT_DIRECTION,
) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """Linear least squares with re-estimated noise: (step of the parameters, pointwise log-likelihood after it, residuals).

    The better of two beginnings: the base's noise (its normal `equations`, where they are known), and white noise where that
    takes the errors below the base's (not tried where they cannot fall). Where neither comes near the base, and where neither
    gains anything, the noise is left as it was: no colour makes up for that, and the base's was the best. Directions with less
    than `ridge` of the largest scaled curvature are left alone.
    """

    stacked = Stacked.of(residuals, by_parameters, by_states)

    def solved(equations: NormalEquations) -> tuple[FloatArray, list[FloatArray]]:
        step, initial = equations.step(ridge=ridge)
        return step, stacked.after(step, initial)

    def judged(step: FloatArray, rest: list[FloatArray], near: Noises | None) -> _Fitted:
        colour = fit_noises(rest, drifting=base.drifting, near=near, reading=base.reading)
        return step, pointwise_log_likelihood(rest, colour), rest, colour

    step, rest = solved(stacked.normal_equations(base.noises) if equations is None else equations)
    white = tuple(None if noise is None else replace(noise, a=np.zeros(0)) for noise in base.noises)
    step_in_white, rest_in_white = solved(stacked.normal_equations(white)) if may_fall else (step, rest)
    fallen = may_fall and _error_ratio(rest_in_white, base.residuals) < FALLEN
    if not fallen:
        pointwise = pointwise_log_likelihood(rest, base.noises)
        gained = pointwise.sum() - base.log_likelihood
        if gained < -HOPELESS_NOISE or 0.0 <= gained < PROMISING_GAIN:
            return step, pointwise, rest
    best = judged(step, rest, base.noises)
    if fallen:
        best = max(best, judged(step_in_white, rest_in_white, None), key=lambda found: found[1].sum())
    if abs(best[1].sum() - base.log_likelihood) > WORTH_A_PASS:
        best = max(best, judged(*solved(stacked.normal_equations(best[3])), best[3]), key=lambda found: found[1].sum())
    return best[:3]


def base_may_fall(base: Structure) -> bool:
    """Whether the error of an output stands above its innovations, which nothing mends."""
    known = [o for o, noise in enumerate(base.noises) if noise is not None]
    errors = [r[:, known] for r in base.residuals]
    noises = [noise for noise in base.noises if noise is not None]
    innovations = [np.stack([n.innovations(v) for n, v in zip(noises, r.T, strict=True)], axis=1) for r in errors]
    return _error_ratio(innovations, errors) < FALLEN


def _error_ratio(after: list[FloatArray], before: list[FloatArray]) -> float:
    """The smallest, over the outputs, of the ratios of the mean square errors' roots."""
    power = [sum(np.nansum(r**2, axis=0) for r in rest) for rest in (after, before)]
    return float(np.sqrt(np.nanmin(power[0] / np.where(power[1] > 0, power[1], np.nan))))


def information_on(equations: NormalEquations, leading: int) -> float:
    """Information on parameter `leading` after those before it are free; 0 where there is none."""
    H = equations.information()
    if leading == len(H):
        return 0.0
    absorbed = solve_scaled(H[:leading, :leading], H[:leading, leading : leading + 1], FLAT_DIRECTION)
    return float(H[leading, leading] - H[leading, :leading] @ absorbed[:, 0])
