"""Co-outer (spectral) factor: the stable, stably invertible G_o with G_o G_o~ = G G~."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from residuum.identification.errors import BadModel
from residuum.identification.linear_models.state_space import StateSpace


def co_outer_factor(system: StateSpace) -> StateSpace:
    """G_o, p × p, with G_o(z) G_o(1/z)ᵀ = G(z) G(1/z)ᵀ on the unit circle; G_o and its inverse are stable.

    With the stabilising solution X of the filter Riccati equation

        X = A X Aᵀ + B Bᵀ − K R Kᵀ,   R = D Dᵀ + C X Cᵀ,   K = (A X Cᵀ + B Dᵀ) R⁻¹,

    G_o = C (zI − A)⁻¹ K R^½ + R^½ (Anderson and Moore, Optimal Filtering, 1979, ch. 9).

    Raises
    ------
    BadModel
        G is not stable, or has a zero on the unit circle (no stably invertible factor exists).
    """
    if not system.is_stable:
        raise BadModel("co_outer_factor: the system is not stable")
    A, B, C, D = system.A, system.B, system.C, system.D
    if not system.order:
        return StateSpace.gain(linalg.sqrtm(D @ D.T).real, system.sample_time)
    try:
        X = linalg.solve_discrete_are(A.T, C.T, B @ B.T, D @ D.T, s=B @ D.T)
    except (linalg.LinAlgError, ValueError):
        raise BadModel("co_outer_factor: the system has a zero on the unit circle; add measurement noise") from None
    R = D @ D.T + C @ X @ C.T
    eigenvalues, vectors = np.linalg.eigh(R)
    root = (vectors * np.sqrt(eigenvalues)) @ vectors.T
    K = np.linalg.solve(R, (A @ X @ C.T + B @ D.T).T).T
    factor = StateSpace(A, K @ root, C, root, system.sample_time)
    if not factor.inverse().is_stable:
        raise BadModel("co_outer_factor: the system has a zero on the unit circle; add measurement noise")
    return factor
