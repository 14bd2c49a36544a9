"""Residual tests of whole models: they keep their level for right ones, and speak against wrong ones."""

import numpy as np
import pytest
from scipy import signal

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.prediction_error import STRUCTURES, Orders, identify
from residuum.identification.linear_models.validation import prediction_errors, residual_check
from residuum.identification.record import Record


def arx_record(seed, n=2000, holes=()):
    rng = np.random.default_rng(seed)
    u, e = rng.standard_normal((2, n))
    y = signal.lfilter([0.0, 1.0, 0.4], [1.0, -1.3, 0.6], u) + signal.lfilter(
        [0.5], [1.0, -1.3, 0.6], e
    )
    y[list(holes)] = np.nan
    return Record({"u": u, "y": y}, {"u": "V", "y": "m"}, 0.1), 0.5 * e


def fitted(seed, structure="arx", orders=None):
    record, _ = arx_record(seed)
    return identify(STRUCTURES[structure], [record], "u", "y", orders=orders or Orders(na=2, nb=2))


def test_prediction_errors_are_the_innovations_and_begin_anew_behind_gaps():
    record, e = arx_record(11, holes=range(900, 905))
    found = prediction_errors(fitted(10), record)
    known = np.isfinite(found)
    assert known.sum() > 1800
    assert np.sqrt(np.mean((found[known] - e[known]) ** 2)) < 0.05 * np.std(e)


def test_a_right_model_is_spoken_against_at_the_level_alone():
    model = fitted(0)
    checks = [residual_check(model, arx_record(seed)[0]) for seed in range(100, 160)]
    for found in ([c.whiteness for c in checks], [c.input for c in checks]):
        # 60 at 1 %: beyond with probability .0004
        assert sum(not test.passed for test in found) <= 4
    assert sum(c.model_error.falsified for c in checks) <= 6
    assert sum(c.passed for c in checks) >= 50


def test_each_wrong_model_is_told_by_the_test_that_it_fails():
    record, _ = arx_record(1)
    slow = residual_check(fitted(0, orders=Orders(na=1, nb=1)), record, first=1000)
    assert not slow.whiteness.passed
    assert not slow.passed
    cut = residual_check(fitted(0, "fir", Orders(nb=4)), record, first=1000)
    assert cut.whiteness is None  # no noise model, no claim
    assert not cut.input.passed
    assert cut.model_error.falsified
    oe = residual_check(fitted(0, "oe", Orders(nb=2, nf=2)), record, first=1000)
    assert oe.whiteness is None
    # the plant is right, its coloured noise is no fault of a method that has no model of it
    assert oe.passed


def test_a_part_too_short_for_a_test_says_nothing():
    record, _ = arx_record(1)
    assert residual_check(fitted(0), record, first=1997).input is None
    with pytest.raises(BadInput, match="must lie between 0 and 1"):
        residual_check(fitted(0), record, level=1.0)
