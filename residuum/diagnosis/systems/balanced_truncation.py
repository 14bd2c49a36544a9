"""Model reduction by balanced truncation, with its guaranteed error bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from residuum.array_types import FloatArray
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.state_space import StateSpace


@dataclass(frozen=True, eq=False)
class ReducedSystem:
    """The truncated system, the Hankel singular values, and the bound 2 Σ_{i>r} σ_i on ‖G − G_r‖_∞."""

    system: StateSpace
    hankel_singular_values: FloatArray
    error_bound: float


def balanced_truncation(system: StateSpace, tolerance: float, *, order: int | None = None) -> ReducedSystem:
    """Least order r whose error bound 2 Σ_{i>r} σ_i is at most `tolerance` (absolute), or the given `order`.

    Square-root form (Tombs and Postlethwaite, 1987): it needs no balancing of the full system, so nearly
    uncontrollable states do no harm. The bound is Enns' and Glover's (1984); the reduced system is stable.

    Raises
    ------
    BadModel
        The system is not stable.
    """
    if not system.is_stable:
        raise BadModel("balanced_truncation: the system is not stable")
    if not system.order:
        return ReducedSystem(system, np.zeros(0), 0.0)
    controllability = _root(linalg.solve_discrete_lyapunov(system.A, system.B @ system.B.T))
    observability = _root(linalg.solve_discrete_lyapunov(system.A.T, system.C.T @ system.C))
    U, sigma, Vt = np.linalg.svd(observability.T @ controllability)
    tails = 2.0 * np.concatenate([np.cumsum(sigma[::-1])[::-1], [0.0]])
    r = int(np.argmax(tails <= tolerance)) if order is None else min(order, len(sigma))
    r = min(r, int(np.sum(sigma > sigma[0] * 1e-14))) if sigma[0] > 0 else 0
    scale = 1.0 / np.sqrt(sigma[:r])
    left, right = (observability @ U[:, :r] * scale).T, controllability @ Vt[:r].T * scale
    reduced = StateSpace(left @ system.A @ right, left @ system.B, system.C @ right, system.D, system.sample_time)
    return ReducedSystem(reduced, np.asarray(sigma), float(tails[r]))


def _root(gramian: FloatArray) -> FloatArray:
    eigenvalues, vectors = np.linalg.eigh((gramian + gramian.T) / 2.0)
    return np.asarray(vectors * np.sqrt(np.maximum(eigenvalues, 0.0)))
