"""Stamps that were only rounded are even; stamps that are not even are refused with their row."""

import numpy as np
import pytest

from residuum.identification.errors import BadRecord
from residuum.identification.record_formats.even_time import even_columns, resampled


def held(time):
    return even_columns(np.stack([time, np.zeros(len(time))]), "x.csv", resample=False)[0]


@pytest.mark.parametrize(
    ("step", "decimals"), [(0.00325, 3), (0.00325, 4), (1 / 30, 2), (1 / 12800, 5), (3.3333, 0)]
)
def test_even_stamps_that_were_rounded_to_their_decimals_are_even(step, decimals):
    for begin in (0.0, 123.4567, 1.7e9):
        assert held(np.round(begin + step * np.arange(4000), decimals)) == pytest.approx(
            step, rel=1e-3
        )


def test_even_stamps_of_so_many_significant_digits_are_even():
    assert held(np.array([float(f"{0.00325 * k:.6g}") for k in range(4000)])) == pytest.approx(
        0.00325, rel=1e-5
    )


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


@pytest.mark.parametrize("samples_too", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_samples_whose_stamps_are_a_little_late_stay_beside_each_other(seed, samples_too):
    """An input's step and what answers it at once are parted by a line between two samples, which a model sees as an effect."""
    rng = np.random.default_rng(seed)
    n, step = 400, 0.01
    at = step * np.arange(n) + 0.05 * step * rng.standard_normal(n)
    at -= at[0]
    voltage = rng.choice([-4.0, 4.0, 7.0], n)
    taken = at / step if samples_too else np.arange(n)
    slow = np.sin(taken / 6.0)
    found, signals, told = resampled(at, np.stack([voltage, voltage / 2.0, slow]), "r.csv")
    assert found == pytest.approx(step, rel=1e-3) and signals.shape[1] == n
    np.testing.assert_array_equal(signals[:2], [voltage, voltage / 2.0])
    assert (
        "kept at its even instant, at most" in told[0][0]
        and "kept at its even instant" in told[1][0]
    )
    if samples_too:  # then the slow signal is read off between its samples
        line = np.polyfit(np.arange(n), at, 1)
        np.testing.assert_allclose(
            signals[2][1:-1], np.sin(np.polyval(line, np.arange(n)) / step / 6.0)[1:-1], atol=0.005
        )
        assert "error about" in told[2][0]
    else:
        np.testing.assert_array_equal(signals[2], slow)


def test_a_stamp_half_a_step_late_is_not_taken_for_its_even_instant():
    n, step = 200, 0.01
    at = step * np.arange(n)
    at[77:] += 0.5 * step
    _, _, told = resampled(at, np.sign(np.sin(np.arange(n)))[None], "r.csv")
    assert "late" in told[0][0]
