"""A cause of size zero explains nothing: it is none, and what it was said to explain has an unknown cause."""

import numpy as np
import pytest

from residuum.diagnosis.model_based.causes import Cause, of_some_size
from residuum.diagnosis.model_based.hypotheses import Hypothesis


def cause(kind, name, size, probability, std=0.1, **more):
    sizes = np.atleast_1d(np.asarray(size, float))
    return Cause(
        Hypothesis(kind, name, "joint"), probability, sizes, np.full(len(sizes), std), 0, **more
    )


def told(listed):
    return [
        (c.hypothesis.label if c.hypothesis else "unknown", round(c.probability, 6))
        for c in of_some_size(listed)
    ]


@pytest.mark.parametrize("std", [0.1, 0.0, np.nan])
def test_a_cause_of_size_zero_is_an_unknown_one(std):
    listed = [
        cause("effect", "coulomb-friction", 0.0, 0.7, std),
        cause("sensor", "offset", 0.4, 0.3),
    ]
    assert told(listed) == [("unknown", 0.7), ("offset@joint", 0.3)]


def test_it_joins_what_is_unknown_already_and_is_alike_to_nothing():
    listed = [
        cause("sensor", "offset", 0.4, 0.6, alike=("gain@joint",), beside=("gain@joint",)),
        Cause(None, 0.1, np.zeros(0), np.zeros(0), 0),
        cause("sensor", "gain", 1e-9, 0.3),
    ]
    assert told(listed) == [("offset@joint", 0.6), ("unknown", 0.4)]
    assert of_some_size(listed)[0].alike == of_some_size(listed)[0].beside == ()


def test_a_value_of_zero_and_a_sensor_that_sticks_at_zero_are_causes():
    listed = [
        cause("parameter", "offset", 0.0, 0.5),
        cause("sensor", "stuck", 0.0, 0.3),
        cause("effect", "ripple", [0.0, 0.2], 0.2),
    ]
    assert of_some_size(listed) == listed
