"""What other values of a model, within their doubt, would take away of its error: no structure.

Values that were estimated by least squares beside coloured noise are not the likeliest ones. What
they miss follows the model's own signals, as the error of a missing effect does, and is smooth
where the innovations of the noise are small: a test for structure sees it. So the error is tested
at the likeliest values (generalised least squares beside noise of its own colour) where these lie
within the doubt of estimated ones, H⁻¹ JᵀΓJ H⁻¹. Values further away are wrong, and their error is
structured. First states are always estimated on the records themselves.

Reference: A. C. Aitken, Proc. R. Soc. Edinb. 55 (1936) 42; W. K. Newey, K. D. West, Econometrica 55
(1987) 703.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.recursive_filter import all_pole
from residuum.identification.physics import Estimate, Experiment, PhysicalModel, Simulator
from residuum.identification.residual_analysis.noise import ColouredNoise
from residuum.identification.residual_analysis.policy import NOISE_ORDER, STRUCTURE_LEVEL
from residuum.identification.residual_analysis.structured_error import lasting_noise


def at_likeliest_values(
    model: PhysicalModel, experiments: Sequence[Experiment], simulation: Estimate
) -> list[FloatArray]:
    """Residuals of a simulation with the model's values and estimated first states, less what
    likelier ones within their doubt take away; (n, outputs) an experiment, NaN where missing. To
    first order in the values, each output's by itself.

    Notes
    -----
    Fails where two outputs contradict each other about one value within its doubt by one of them
    alone: either takes its own. The doubt is that of the estimate, and not of its difference from
    the likeliest values, which is less: a generous bound.
    """
    slopes = [
        _slopes(model, *run)
        for run in zip(experiments, simulation.initial, simulation.substeps, strict=True)
    ]
    residuals = [residual.copy() for residual in simulation.residuals]
    if not slopes[0].shape[-1]:  # nothing is free
        return residuals
    measured = np.any([np.isfinite(r).any(axis=0) for r in residuals], axis=0)
    for o in np.flatnonzero(measured).tolist():
        errors = [
            _Slope(r[:, o], J[:, o], len(model.free))
            for r, J in zip(residuals, slopes, strict=True)
        ]
        for r, change in zip(residuals, _changes(errors), strict=True):
            r[:, o] -= change
    return residuals


@dataclass(frozen=True, eq=False)
class _Slope:
    """One output's error e in an experiment, and its slopes J by the values, the first `values` of
    them, and the first states.
    """

    e: FloatArray
    J: FloatArray
    values: int

    def whitened(self, noise: ColouredNoise) -> _Slope:
        e, J = noise.innovations(self.e), noise.innovations(self.J)
        # a missing sample takes those with it whose innovations it is part of
        known = np.isfinite(e) & np.isfinite(J).all(axis=1)
        return _Slope(e[known], J[known], self.values)

    def of_states(self, wanted: FloatArray) -> FloatArray:
        """Least-squares coefficients of the first states for `wanted`."""
        return np.asarray(np.linalg.lstsq(self.J[:, self.values :], wanted, rcond=None)[0])

    def without_states(self) -> tuple[FloatArray, FloatArray]:
        """e and the slopes by the values, less what the first states take up."""
        wanted = np.column_stack([self.e, self.J[:, : self.values]])
        projected = wanted - self.J[:, self.values :] @ self.of_states(wanted)
        return projected[:, 0], projected[:, 1:]


def _slopes(
    model: PhysicalModel, experiment: Experiment, x0: FloatArray, substeps: int
) -> FloatArray:
    """Slopes of the outputs by the free values and first states, (n, outputs, values + states);
    zero where not measured.
    """
    simulator = Simulator(model)
    names = [*model.free, *(f"initial:{name}" for name in simulator.free_states)]
    run = simulator.run_vectors(experiment, x0, simulator.p(), slopes=names, substeps=substeps)
    # slopes that overflow tell no likelier value, and take nothing of the error away
    if run.dY is None or not np.isfinite(run.dY).all():
        return np.zeros((*experiment.Y.shape, len(names)))
    return run.dY


def _changes(errors: Sequence[_Slope]) -> list[FloatArray]:
    """What the likeliest values and first states change of one output's error, an array an
    experiment.
    """
    missing = [np.where(np.isfinite(slope.e), 0.0, np.nan) for slope in errors]
    changes = missing
    # twice: the noise is that of what the likelier values leave, and they are likelier beside it
    for _ in range(2):
        try:
            noise = lasting_noise(
                [slope.e - change for slope, change in zip(errors, changes, strict=True)],
                NOISE_ORDER,
            )
        except BadInput:  # too short to tell a colour
            return missing
        white = [slope.whitened(noise) for slope in errors]
        by = _values(errors, white, noise)
        changes = [
            slope.J @ np.r_[by, w.of_states(w.e - w.J[:, : by.size] @ by)]
            for slope, w in zip(errors, white, strict=True)
        ]
    return changes


def _values(errors: Sequence[_Slope], white: Sequence[_Slope], noise: ColouredNoise) -> FloatArray:
    """By how much the likeliest values differ; zero where that is beyond the doubt of values that
    were estimated.
    """
    # generalised least squares: H = Σ JᵀJ and g = Σ Jᵀe of whitened slopes and errors
    projected = [slope.without_states() for slope in white]
    H, g = sum(J.T @ J for _, J in projected), sum(J.T @ e for e, J in projected)
    change = np.asarray(np.linalg.lstsq(H, g, rcond=None)[0])
    squares, spread = np.zeros_like(H), np.zeros_like(H)
    for slope in errors:
        known = np.isfinite(slope.e)
        _, J = _Slope(slope.e[known], slope.J[known], slope.values).without_states()
        # JᵀΓJ with Γ = σ² A⁻¹A⁻ᵀ, the covariance of the noise: A⁻ᵀJ filters J backwards in time
        backwards = all_pole(np.r_[1.0, noise.a], J[::-1])
        squares += J.T @ J
        spread += noise.innovation_variance * backwards.T @ backwards
    # (change)ᵀ (H⁻¹ S H⁻¹)⁻¹ (change)
    far = float(squares @ change @ np.linalg.lstsq(spread, squares @ change, rcond=None)[0])
    rank = max(int(np.linalg.matrix_rank(H)), 1) if change.size else 1
    return change if far <= chdtri(rank, STRUCTURE_LEVEL) else np.zeros_like(change)
