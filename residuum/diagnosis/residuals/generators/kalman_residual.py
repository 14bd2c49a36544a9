"""Kalman innovation: the residual of a stationary Kalman predictor, scaled to unit variance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import linalg

from residuum.array_types import FloatArray
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.state_space import StateSpace


@dataclass(frozen=True, eq=False)
class KalmanResidual:
    """S^(−½) (y − C x̂ − D u) with x̂⁺ = A x̂ + B u + K (y − C x̂ − D u), one output; white of variance 1 while healthy."""

    predictor: StateSpace  # inputs [y; u]

    def residual(self, u: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
        """Innovation, shape (n,), from rest."""
        return self.predictor.simulate(np.column_stack([y, u]))[0][:, 0]


def kalman_residual(system: StateSpace, process_noise: float, measurement_noise: float) -> KalmanResidual:
    """Stationary Kalman predictor for white noise on the input and on the output.

    Parameters
    ----------
    system : StateSpace
        One input, one output.
    process_noise, measurement_noise : float
        Variances [input unit²], [output unit²]; the process noise stands for the model error.

    Raises
    ------
    BadModel
        No stabilising solution of the Riccati equation (an undetectable mode).
    """
    A, B, C, D = system.A, system.B, system.C, system.D
    R = np.atleast_2d(measurement_noise)
    try:
        X = linalg.solve_discrete_are(A.T, C.T, process_noise * B @ B.T + 1e-12 * np.eye(len(A)), R)
    except (linalg.LinAlgError, ValueError):
        raise BadModel("kalman_residual: a mode of the system cannot be seen at the output") from None
    S = C @ X @ C.T + R
    K = A @ X @ C.T @ np.linalg.inv(S)
    scale = 1.0 / np.sqrt(S)
    return KalmanResidual(
        StateSpace(A - K @ C, np.hstack([K, B - K @ D]), -scale @ C, np.hstack([scale, -scale @ D]), system.sample_time)
    )
