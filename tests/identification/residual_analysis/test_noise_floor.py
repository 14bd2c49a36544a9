"""The noise of an error's quieter parts: an event stands out of it, noise of any colour does not."""

import numpy as np
import pytest
from scipy.signal import lfilter, medfilt, welch

from residuum.identification.residual_analysis.noise import noise_floor
from residuum.identification.residual_analysis.noise.noise_floor import times_the_noise, times_the_quiet_noise
from residuum.identification.residual_analysis.policy.noise import AN_EVENT, BEYOND_NOISE, UNDER_STRUCTURE


@pytest.mark.parametrize("length", [64, 255, 1024])
def test_spectrum_and_running_median_are_those_of_scipy(length):
    x = np.cumsum(np.random.default_rng(length).standard_normal(5000))
    frequency, power = welch(x, nperseg=length, detrend="linear")
    found = noise_floor._spectra(noise_floor._windows(x, length)).mean(axis=0)
    own, fast = noise_floor._fast_frequencies(length, noise_floor.LOWEST_FREQUENCY)
    assert np.array_equal(own, frequency)
    assert found[fast] == pytest.approx(power[fast], rel=1e-9)
    assert np.array_equal(noise_floor._without_single_samples(x), medfilt(x, 5))


@pytest.mark.parametrize("rho", [0.0, 0.9, 0.99])
def test_noise_of_any_colour_does_not_stand_out(rho):
    rng = np.random.default_rng(7)
    for _ in range(20):
        noise = lfilter([1.0], [1.0, -rho], rng.standard_normal(6000))[2000:]
        assert times_the_quiet_noise([noise]) < 0.6 * AN_EVENT


def test_a_sensor_that_sticks_stands_out_though_its_jumps_are_fast():
    rng = np.random.default_rng(1)
    moving = 40.0 * np.sin(np.arange(4000) / 9.0)
    error = rng.standard_normal(4000)
    error[1500:1900] = moving[1500] - moving[1500:1900]
    assert times_the_quiet_noise([error]) < AN_EVENT  # 13 times the noise
    error[1500:1900] *= 3.0
    assert times_the_quiet_noise([error]) > AN_EVENT
    assert times_the_noise([error]) < 3.0 * BEYOND_NOISE


def test_single_samples_and_noise_that_rests_say_nothing():
    rng = np.random.default_rng(2)
    outliers = rng.standard_normal(4000) + 300.0 * (rng.random(4000) < 0.004)
    assert times_the_quiet_noise([outliers]) < 2.0
    resting = rng.standard_normal(4000) * np.repeat([0.0, 1.0] * 4, 500)
    assert times_the_quiet_noise([resting]) == 0.0


def test_an_error_that_swings_in_the_fast_part_is_no_noise():
    rng = np.random.default_rng(3)
    swings = lfilter([0.1], [1.0, -1.8 * np.cos(2 * np.pi * 0.03), 0.81], lfilter([0.2], [1.0, -0.8], rng.normal(size=20_000)))
    error = [20.0 * swings + rng.normal(size=20_000)]
    assert noise_floor.noise_floor(error) > 10.0
    assert noise_floor.noise_floor(error, lowest=UNDER_STRUCTURE) == pytest.approx(1.0, rel=0.3)
