"""A drive in a sampled speed loop: its controller answers the noise of the measurement, and nothing is missing."""

from pathlib import Path

import numpy as np
import pytest
from numba import njit
from scipy.signal import lfilter

from residuum.identification.discrepancy.explain import explain
from residuum.identification.physics import estimate, match, read_model
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.residual_analysis.feedback import feeds_back

DRIVE = (Path(__file__).parents[1] / "discrepancy" / "drive.yaml").read_text()
R, K, J, B = 1.7, 0.124, 0.00121, 0.00056
SAMPLE_TIME, STEPS = 0.002, 20


@njit
def driven(wanted, drive, noise, gain):
    """Speed, current and voltage of the drive: `drive`, and `gain` times what the measured speed lacks, held over the sample."""
    speed, current, voltage, w = (
        np.empty(wanted.size),
        np.empty(wanted.size),
        np.empty(wanted.size),
        0.0,
    )
    for t in range(wanted.size):
        speed[t] = w + noise[t]
        voltage[t] = drive[t] + gain * (wanted[t] - speed[t])
        current[t] = (voltage[t] - K * w) / R
        for _ in range(STEPS):
            w += SAMPLE_TIME / STEPS * (K * (voltage[t] - K * w) / R - B * w) / J
    return speed, current, voltage


def record(gain, n=15_000):
    rng = np.random.default_rng(5)
    wanted = np.interp(
        np.arange(n), np.arange(0, n + 500, 500), 120.0 * rng.standard_normal(n // 500 + 1)
    )
    drive = np.repeat(8.0 * rng.standard_normal(n // 300), 300) if gain == 0.0 else K * wanted
    noise = lfilter([1.0], [1.0, -0.8], 1.5 * rng.standard_normal(n))
    speed, current, voltage = driven(wanted, drive, noise, gain)
    channels = {"u": voltage, "speed": speed, "current": current + 0.1 * rng.standard_normal(n)}
    return Record(channels, {"u": "V", "speed": "rad/s", "current": "A"}, SAMPLE_TIME)


@pytest.mark.parametrize("gain", [0.0, 0.3])
def test_a_controller_shows_in_what_its_output_answers(gain):
    model, experiments = match(read_model(DRIVE), [record(gain)])
    found = estimate(model, experiments)
    assert feeds_back(found.model, experiments, found.residuals) == (gain > 0.0)


def test_noise_that_a_controller_answers_is_no_missing_effect():
    """Over means of three samples a lag of the speed seemed to be missing, with p = 1."""
    found = explain(read_model(DRIVE), [record(0.3)])
    assert (found.verdict, list(found.accepted), list(found.timing)) == ("adequate", [], [])
    assert found.found.validation.data.experiments[0].block == 1
    assert not found.found.validation.data.experiments[0].hold.any()


def test_noise_that_is_remembered_over_blocks_is_no_structure_of_a_complete_model():
    """Blocks of seven samples: the voltage of the block before knew how much of the noise came at its end."""
    model = read_model(DRIVE).with_values({"R": R, "K": K, "J": J, "b": B})
    assert not compare(model, [record(0.3)]).present
