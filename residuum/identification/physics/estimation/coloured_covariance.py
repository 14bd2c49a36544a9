"""How far estimated parameters can be trusted where the noise has a colour.

Least squares on coloured noise still finds the parameters, but σ²·H⁻¹ counts every sample as news:
at ρ = 0.95 its standard deviations are six times too small. With J the weighted derivatives
(initial states eliminated) and Γ the noise's autocovariance the covariance is H⁻¹ (Jᵀ Γ J) H⁻¹.
Autoregressive noise A v = e has Γ = σ² (AᵀA)⁻¹, so that Jᵀ Γ J holds the products of the
derivatives filtered by 1/A backwards in time. Rows of priors are news each: they add P to H and σ²P
to the middle.

Reference: W. K. Newey, K. D. West, Econometrica 55 (1987) 703; L. Ljung, *System Identification*,
1999, 9.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import NotIdentifiable
from residuum.identification.linear_models.autoregression import fit_autoregression
from residuum.identification.linear_models.recursive_filter import all_pole
from residuum.identification.physics.estimation.estimation import Estimate
from residuum.identification.physics.estimation.gauss_newton import Fit
from residuum.identification.physics.estimation.least_squares import covariance_of, solve_scaled
from residuum.identification.physics.simulate.experiment import Experiment
from residuum.identification.physics.simulate.simulation import Simulator

Array = npt.NDArray[np.float64]


def with_coloured_noise(result: Estimate, experiments: Sequence[Experiment]) -> Estimate:
    """The estimate with its covariance for noise of the residuals' own colour (unfiltered
    simulation error).
    """
    return (
        replace(result, covariance=coloured_covariance(result, experiments))
        if result.parameters
        else result
    )


def coloured_covariance(result: Estimate | Fit, experiments: Sequence[Experiment]) -> Array:
    """Covariance of estimated parameters for noise of the residuals' own colour, infinite along
    flat directions.
    """
    slopes = [_reduced_slopes(result, k, e) for k, e in enumerate(experiments)]
    q = len(result.parameters)
    H = np.zeros((q, q))
    spread = np.zeros((q, q))
    for o in map(int, np.flatnonzero(result.weights > 0)):
        A, variance = _colour([r[:, o] for r in result.residuals])
        for J in slopes:
            # A⁻ᵀJ, the derivatives filtered backwards in time: Jᵀ Γ J = σ² (A⁻ᵀJ)ᵀ(A⁻ᵀJ).
            filtered = all_pole(A, J[::-1, o])
            H += J[:, o].T @ J[:, o]
            spread += variance * result.weights[o] ** 2 * filtered.T @ filtered
    H += np.diag(result.priors.precisions)
    # A prior is news of its own: P in H, σ²P in the middle.
    spread += np.diag(result.priors.precisions) * _variance(result)
    # Variance 1: that of the noise stands in the middle already.
    inverse, _ = covariance_of(H, 1.0, result.parameters, result.theta)
    open_ = np.isinf(np.diag(inverse))
    # Infinity times zero would spoil the other parameters.
    finite = np.where(np.isfinite(inverse), inverse, 0.0)
    covariance = finite @ spread @ finite
    covariance[open_, open_] = np.inf
    return covariance


def _variance(result: Estimate | Fit) -> float:
    """Of a weighted error that is noise, as priors are weighed beside it."""
    return result.problem.unit.variance if isinstance(result, Fit) else 1.0


def _reduced_slopes(result: Estimate | Fit, number: int, experiment: Experiment) -> Array:
    """Weighted derivatives of the outputs by the parameters, less what the initial states take up;
    zero where missing.
    """
    simulator = Simulator(result.model)
    states = [f"initial:{name}" for name in simulator.free_states]
    names = [*result.parameters, *states]
    x0 = result.initial[number]
    steps = result.substeps[number]
    run = simulator.run_vectors(experiment, x0, simulator.p(), slopes=names, substeps=steps)
    dY = np.zeros((*experiment.Y.shape, len(names))) if run.dY is None else run.dY
    known = np.isfinite(experiment.Y)
    J = np.where(known[:, :, None], dY * result.weights[:, None], 0.0)
    flat = J.reshape(-1, len(names))
    own = flat[:, len(result.parameters) :]
    wanted = flat[:, : len(result.parameters)]
    # What the first states can imitate tells nothing of the parameters.
    projected = wanted - own @ solve_scaled(own.T @ own, own.T @ wanted)
    return np.asarray(projected.reshape(*experiment.Y.shape, -1))


def _colour(residuals: Sequence[Array]) -> tuple[Array, float]:
    """Autoregression of one output's residuals, no product taken across two experiments; white
    where they are too few.
    """
    # NaN between two experiments: no product is taken across.
    joined = np.concatenate([part for r in residuals for part in (r, [np.nan])])
    try:
        return fit_autoregression(joined)
    except NotIdentifiable:
        return np.ones(1), float(np.nanmean(joined**2))
