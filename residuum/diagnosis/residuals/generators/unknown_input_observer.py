"""Unknown input observer: a residual that an unmeasured input d along a known direction E cannot move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import linalg

from residuum.array_types import FloatArray
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.state_space import StateSpace


@dataclass(frozen=True, eq=False)
class UnknownInputObserver:
    """z⁺ = F z + T B u + K y, x̂ = z + H y, r = y − D u − C x̂."""

    filter: StateSpace  # inputs [y; u]

    def residual(self, u: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
        """Residual, shape (n, p), from rest; u of shape (n,) or (n, q), y of shape (n,) or (n, p)."""
        return self.filter.simulate(np.column_stack([y, u]))[0]


def unknown_input_observer(system: StateSpace, E: npt.ArrayLike, measurement_noise: float = 1.0) -> UnknownInputObserver:
    """Observer of x⁺ = A x + B u + E d, y = C x, whose residual does not depend on d (Chen and Patton, 1999, ch. 3).

    H = E (C E)⁺ and T = 1 − H C remove d from the estimation error; F = T A − K₁ C is made stable by a Kalman gain. It
    exists when rank C E = rank E and the pair (C, T A) is detectable, with more outputs than unknown
    inputs. Without columns in E it is the plain full-order observer.

    Raises
    ------
    BadModel
        D ≠ 0, or the conditions of existence fail; the message says which.
    """
    A, B, C = system.A, system.B, system.C
    E = np.asarray(E, dtype=float).reshape(system.order, -1)
    if np.any(system.D):
        raise BadModel("unknown_input_observer: needs a system without direct feedthrough, D = 0")
    if E.shape[1] and np.linalg.matrix_rank(C @ E) < np.linalg.matrix_rank(E):
        raise BadModel("unknown_input_observer: rank C E < rank E; the unknown input does not reach the outputs in one step")
    if E.shape[1] >= C.shape[0]:
        raise BadModel(
            f"unknown_input_observer: {E.shape[1]} unknown inputs use up all {C.shape[0]} outputs; no residual is left"
        )
    H = E @ np.linalg.pinv(C @ E) if E.shape[1] else np.zeros((system.order, C.shape[0]))
    T = np.eye(system.order) - H @ C
    A1 = T @ A
    try:
        X = linalg.solve_discrete_are(A1.T, C.T, np.eye(system.order), measurement_noise * np.eye(C.shape[0]))
    except (linalg.LinAlgError, ValueError):
        raise BadModel("unknown_input_observer: (C, T A) is not detectable; a zero of the path from d to y is unstable") from None
    K1 = A1 @ X @ C.T @ np.linalg.inv(C @ X @ C.T + measurement_noise * np.eye(C.shape[0]))
    F = A1 - K1 @ C
    K = K1 + F @ H
    p = C.shape[0]
    return UnknownInputObserver(
        StateSpace(F, np.hstack([K, T @ B]), -C, np.hstack([np.eye(p) - C @ H, np.zeros((p, B.shape[1]))]), system.sample_time)
    )
