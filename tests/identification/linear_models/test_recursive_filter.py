"""The filter of one's own past is SciPy's."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.identification.linear_models.recursive_filter import all_pole


@pytest.mark.parametrize("shape", [(500,), (500, 3), (1,)])
@pytest.mark.parametrize("order", [0, 1, 12])
def test_agrees_with_scipy(order, shape):
    rng = np.random.default_rng(order)
    A, x = np.atleast_1d(np.poly(rng.uniform(-0.9, 0.9, order))), rng.standard_normal(shape)
    given = x.copy()
    assert np.array_equal(all_pole(A, x), lfilter([1.0], A, x, axis=0))
    assert np.array_equal(x, given)


def test_walks_backwards_and_over_every_other_sample():
    x = np.random.default_rng(1).standard_normal(100)
    assert np.array_equal(all_pole([1.0, -0.8], x[::-2]), lfilter([1.0], [1.0, -0.8], x[::-2]))
