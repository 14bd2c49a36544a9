"""Stamps that were only rounded are even; stamps that are not even are refused with their row."""

import numpy as np
import pytest

from residuum.identification.errors import BadRecord
from residuum.identification.record_formats.even_time import even_columns


def held(time):
    return even_columns(np.stack([time, np.zeros(len(time))]), "x.csv", resample=False)[0]


@pytest.mark.parametrize(("step", "decimals"), [(0.00325, 3), (0.00325, 4), (1 / 30, 2), (1 / 12800, 5), (3.3333, 0)])
def test_even_stamps_that_were_rounded_to_their_decimals_are_even(step, decimals):
    for begin in (0.0, 123.4567, 1.7e9):
        assert held(np.round(begin + step * np.arange(4000), decimals)) == pytest.approx(step, rel=1e-3)


def test_even_stamps_of_so_many_significant_digits_are_even():
    assert held(np.array([float(f"{0.00325 * k:.6g}") for k in range(4000)])) == pytest.approx(0.00325, rel=1e-5)


@pytest.mark.parametrize("moved", [0.01, -0.01, 0.02])
def test_one_stamp_beside_its_place_by_a_unit_of_the_last_decimal_is_refused(moved):
    time = np.round(0.1 * np.arange(100), 2)
    time[51] += moved
    with pytest.raises(BadRecord, match=r"row 5[12]: time step .* differs"):
        held(np.round(time, 2))


def test_jitter_is_refused_however_many_decimals_it_has():
    rng = np.random.default_rng(5)
    with pytest.raises(BadRecord, match="differs"):
        held(0.01 * np.arange(500) + rng.uniform(-1e-3, 1e-3, 500))
    with pytest.raises(BadRecord, match="differs"):
        held(np.round(0.01 * np.arange(500) + rng.uniform(-2e-3, 2e-3, 500), 3))
