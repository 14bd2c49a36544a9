"""How much an input excites: the rank of its normalised Gram matrix."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from residuum.array_types import FloatArray

# Below this ratio of eigenvalues a direction of the regressor is rounding, not signal.
SMALLEST_RATIO = 1e-12


def excitation_order(gram: FloatArray) -> int:
    """Number of coefficients that data with the Gram matrix ΦᵀΦ, shape (p, p), can tell apart.

    A constant supports 1, a sine 2, white noise all p. Eigenvalues below 1e-12 of the largest do
    not count. The eigenvalues are computed only when a condition estimate says that it matters.

    >>> excitation_order(np.ones((5, 5))), excitation_order(np.eye(5))
    (1, 5)
    """
    L, info = lapack.dpotrf(gram, lower=1)
    if (
        info == 0
        and lapack.dpocon(L, np.abs(gram).sum(axis=0).max(), uplo="L")[0]
        > len(gram) * SMALLEST_RATIO
    ):
        return len(gram)
    eigenvalues = np.linalg.eigvalsh(gram)
    return int(
        np.count_nonzero(eigenvalues > SMALLEST_RATIO * max(eigenvalues[-1], np.finfo(float).tiny))
    )
