"""µ against closed forms."""

import numpy as np
import pytest

from benchmarks.peers.structured_singular_value import mu_bounds
from residuum.identification.errors import BadInput


def test_mu_of_robust_performance_is_the_sum_condition():
    """Multiplicative uncertainty and performance: M has rank one and µ = |W_S S| + |W_T T|, (2.8) of the source."""
    rng = np.random.default_rng(0)
    for _ in range(5):
        G, K = rng.normal(size=2) @ [1, 1j], rng.normal(size=2) @ [1, 1j]
        W_S, W_T = rng.uniform(0.1, 2, 2)
        S = 1 / (1 + G * K)
        low, high = mu_bounds([[-W_T * G * K * S, -W_T * K * S], [W_S * G * S, W_S * S]])
        expected = W_S * abs(S) + W_T * abs(G * K * S)
        assert low == pytest.approx(expected, rel=1e-3) and high == pytest.approx(
            expected, rel=1e-3
        )


def test_mu_bounds_enclose_and_agree_for_three_blocks_and_ignore_scaling():
    rng = np.random.default_rng(1)
    for _ in range(4):
        M = rng.normal(size=(3, 3)) + 1j * rng.normal(size=(3, 3))
        low, high = mu_bounds(M)
        assert np.abs(np.linalg.eigvals(M)).max() <= low * (1 + 1e-6) and high <= np.linalg.norm(
            M, 2
        ) * (1 + 1e-9)
        assert low == pytest.approx(high, rel=0.01)
        d = np.array([1e-3, 1.0, 1e2])
        assert mu_bounds(d[:, None] * M / d)[1] == pytest.approx(high, rel=1e-3)
    with pytest.raises(BadInput, match="square"):
        mu_bounds(np.ones((2, 3)))
