"""Errors of a known colour come out white, of size one."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.diagnosis.model_based.window_fit import Whitening


def test_an_autoregression_is_taken_out():
    rng = np.random.default_rng(0)
    errors = [
        np.column_stack(
            [lfilter([0.3], [1.0, -0.9], rng.standard_normal(2000)), rng.standard_normal(2000)]
        )
        for _ in range(6)
    ]
    found = Whitening.of(errors)
    assert found.filters[0, 1] == pytest.approx(-0.9, abs=0.03) and found.sigma == pytest.approx(
        [0.3, 1.0], rel=0.05
    )
    white = found.white(errors[0], np.ones((2000, 2), dtype=bool))
    assert white.std(axis=0) == pytest.approx([1.0, 1.0], abs=0.1)
    assert abs(
        np.corrcoef(white[1:, 0], white[:-1, 0])[0, 1]
    ) < 0.07 and found.inflation == pytest.approx([1.0, 1.0], abs=0.15)


def test_nothing_is_weighed_where_nothing_was_measured():
    found = Whitening.plain(np.array([2.0]))
    known = np.array([[True], [False], [True]])
    assert found.white(np.array([[2.0], [np.nan], [4.0]]), known).ravel().tolist() == [
        1.0,
        0.0,
        2.0,
    ]
