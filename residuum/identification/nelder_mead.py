"""The least value of a function of a few variables, without derivatives."""

from __future__ import annotations

from collections.abc import Callable

from scipy.optimize import minimize

from residuum.array_types import FloatArray


def nelder_mead(
    function: Callable[[FloatArray], float], simplex: FloatArray, evaluations: int
) -> FloatArray:
    """The best point that SciPy finds in so many evaluations from the corners `simplex`, shape
    (variables + 1, variables).

    >>> import numpy as np
    >>> nelder_mead(lambda x: float((x[0] - 1.0) ** 2 + x[1] ** 2), np.vstack([np.zeros(2), np.eye(2)]), 100).round(3).tolist()
    [1.0, 0.0]

    References
    ----------
    J. A. Nelder, R. Mead, *A simplex method for function minimization*, Comput. J. 7 (1965) 308.
    """
    options = {"maxfev": evaluations, "initial_simplex": simplex}
    best: FloatArray = minimize(function, simplex[0], method="Nelder-Mead", options=options).x
    return best
