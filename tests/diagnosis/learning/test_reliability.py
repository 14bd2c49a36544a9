"""Reliability tables tell right probabilities from bold ones."""

import numpy as np
import pytest

from residuum.diagnosis.learning.reliability import expected_calibration_error, reliability_table
from residuum.identification.errors import BadInput


def test_reliability_tells_right_probabilities_from_bold_ones():
    rng = np.random.default_rng(6)
    right = rng.uniform(size=4000)
    true = rng.uniform(size=4000) < right
    lines = reliability_table(right, true)
    assert (
        sum(line.n for line in lines) == 4000
        and sum(line.agrees for line in lines) >= len(lines) - 1
    )
    assert expected_calibration_error(right, true) < 0.02
    bold = right**3 / (right**3 + (1 - right) ** 3)
    assert expected_calibration_error(bold, true) > 0.08
    with pytest.raises(BadInput, match="is no probability"):
        reliability_table([1.2], [True])
    with pytest.raises(BadInput, match="n at least 1"):
        reliability_table([], [])
