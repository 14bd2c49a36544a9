"""Parity space residual: a combination of the last b + 1 outputs and inputs that the unknown state cannot move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import linalg, signal

from residuum.array_types import FloatArray
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.state_space import StateSpace


@dataclass(frozen=True, eq=False)
class ParityResidual:
    """r(t) = v (y_b(t) − H_u u_b(t)), oldest sample first; the weights on the last b + 1 samples of y and of u."""

    on_y: FloatArray
    on_u: FloatArray

    def residual(self, u: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
        """Residual, shape (n,); NaN in the first b samples."""
        r = signal.lfilter(self.on_y[::-1], [1.0], y) - signal.lfilter(self.on_u[::-1], [1.0], u)
        r[: len(self.on_y) - 1] = np.nan
        return np.asarray(r)


def parity_space(system: StateSpace, b: int, process_noise: float = 0.0, measurement_noise: float = 1.0) -> ParityResidual:
    """The parity vector that is most sensitive to a sensor offset for its noise; (1.60)–(1.70) of the source.

    Of all v with v H_o = 0 it maximises (v 1)²/(v R v), R the covariance of white noise on the input (variance
    `process_noise`) and on the output (`measurement_noise`) over the window. Scaled to unit variance.

    Parameters
    ----------
    system : StateSpace
        One input, one output.
    b : int
        Window b ≥ order of the system.

    Raises
    ------
    BadModel
        b is smaller than the order, or there is more than one input or output.
    """
    if system.D.shape != (1, 1):
        raise BadModel("parity_space: needs one input and one output")
    if b < system.order:
        raise BadModel(f"parity_space, b: is {b}; must be at least the order of the system, {system.order}")
    observability = np.vstack([system.C @ np.linalg.matrix_power(system.A, k) for k in range(b + 1)])
    response = system.impulse_response(b + 1)[:, 0, 0]
    H_u = linalg.toeplitz(response, np.zeros(b + 1))
    null = linalg.null_space(observability.T).T
    covariance = null @ (process_noise * H_u @ H_u.T + measurement_noise * np.eye(b + 1)) @ null.T
    direction = np.linalg.solve(covariance, null @ np.ones(b + 1))
    v = direction @ null / np.sqrt(direction @ covariance @ direction)
    return ParityResidual(v, v @ H_u)
