"""The search without derivatives takes SciPy's steps, evaluation by evaluation."""

import numpy as np
import pytest
from scipy.optimize import minimize

from residuum.identification.nelder_mead import nelder_mead


def valley(x):
    return float(np.sum(100.0 * (x[1:] - x[:-1] ** 2) ** 2) + np.sum((1.0 - x) ** 2))


@pytest.mark.parametrize("evaluations", [3, 7, 30, 60, 61, 62, 63, 2000])
def test_takes_the_same_steps_as_scipy(evaluations):
    rng = np.random.default_rng(evaluations)
    for _ in range(20):
        simplex = 2.0 * rng.standard_normal((4, 3))
        options = {"maxfev": evaluations, "initial_simplex": simplex}
        theirs = minimize(valley, simplex[0], method="Nelder-Mead", options=options).x
        assert np.array_equal(nelder_mead(valley, simplex, evaluations), theirs)
