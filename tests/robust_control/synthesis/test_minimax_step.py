"""The quadratic programme of one minimax step against a general solver."""

import numpy as np
import pytest
from scipy.optimize import minimize

from residuum.robust_control.synthesis.structured_synthesis import minimax_step


def general_solver(c, A, H, low, high):
    m, n = A.shape
    return minimize(
        lambda x: x[-1] + 0.5 * x[-1] ** 2 + 0.5 * x[:-1] @ H @ x[:-1],
        np.r_[np.zeros(n), 0.0],
        jac=lambda x: np.r_[H @ x[:-1], 1 + x[-1]],
        bounds=[*zip(low, high, strict=True), (None, None)],
        constraints={
            "type": "ineq",
            "fun": lambda x: x[-1] - c - A @ x[:-1],
            "jac": lambda x: np.c_[-A, np.ones(m)],
        },
        method="SLSQP",
        options={"ftol": 1e-13, "maxiter": 500},
    ).fun


@pytest.mark.parametrize("seed", range(20))
def test_the_step_is_the_minimum(seed):
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 7)), int(rng.integers(1, 50))
    c = rng.normal(size=m)
    c -= c.max()
    A, L = (
        rng.normal(size=(m, n)) * rng.choice([0.1, 1.0, 10.0]),
        rng.normal(size=(n, n)) * rng.choice([0.1, 1.0]),
    )
    H, low, high = L @ L.T + 1e-6 * np.eye(n), -rng.uniform(0, 1, n), rng.uniform(0, 1, n)
    d, multipliers, t = minimax_step(c, A, H, low, high)
    assert t + 0.5 * t * t + 0.5 * d @ H @ d <= general_solver(c, A, H, low, high) + 1e-7
    assert np.all(low <= d) and np.all(d <= high) and t == pytest.approx((c + A @ d).max())
    assert np.all(multipliers >= 0) and multipliers.sum() == pytest.approx(1 + t, abs=1e-6)


def test_a_curvature_that_rounding_made_singular_gives_a_step():
    direction = np.array([1.0, 1e-9, -1.0])
    H = 1e8 * np.outer(direction, direction)
    d, multipliers, t = minimax_step(np.zeros(2), np.eye(2, 3), H, -np.ones(3), np.ones(3))
    assert np.isfinite(d).all() and np.isfinite(multipliers).all() and t < 0.0
