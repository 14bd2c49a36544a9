"""The search without derivatives: the least value of a curved valley, and what it gives when its evaluations are spent."""

import numpy as np
import pytest

from residuum.identification.nelder_mead import nelder_mead


def valley(x):
    return float(np.sum(100.0 * (x[1:] - x[:-1] ** 2) ** 2) + np.sum((1.0 - x) ** 2))


@pytest.mark.parametrize("seed", range(5))
def test_it_finds_the_end_of_a_curved_valley(seed):
    simplex = np.random.default_rng(seed).standard_normal((3, 2))
    assert nelder_mead(valley, simplex, 2000) == pytest.approx([1.0, 1.0], abs=1e-2)


@pytest.mark.parametrize("evaluations", [3, 7, 60])
def test_spent_evaluations_leave_the_best_point_so_far(evaluations):
    tried = []

    def told(x):
        tried.append((valley(x), x.copy()))
        return tried[-1][0]

    found = nelder_mead(
        told, 2.0 * np.random.default_rng(evaluations).standard_normal((4, 3)), evaluations
    )
    assert len(tried) == evaluations
    assert valley(found) == min(value for value, _ in tried)
