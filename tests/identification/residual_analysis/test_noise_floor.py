"""The noise floor of an error, under what swings and what drifts."""

import numpy as np
import pytest
from scipy.signal import lfilter, welch

from residuum.identification.residual_analysis import noise
from residuum.identification.residual_analysis.noise import floor_under_drift
from residuum.identification.residual_analysis.policy import UNDER_STRUCTURE


@pytest.mark.parametrize("length", [64, 255, 1024])
def test_spectrum_is_that_of_scipy(length):
    x = np.cumsum(np.random.default_rng(length).standard_normal(5000))
    frequency, power = welch(x, nperseg=length, detrend="linear")
    found = noise._spectra(noise._windows(x, length)).mean(axis=0)
    own, fast = noise._fast_frequencies(length, noise.LOWEST_FREQUENCY)
    assert np.array_equal(own, frequency)
    assert found[fast] == pytest.approx(power[fast], rel=1e-9)


def test_an_error_that_swings_in_the_fast_part_is_no_noise():
    rng = np.random.default_rng(3)
    swings = lfilter(
        [0.1],
        [1.0, -1.8 * np.cos(2 * np.pi * 0.03), 0.81],
        lfilter([0.2], [1.0, -0.8], rng.normal(size=20_000)),
    )
    error = [20.0 * swings + rng.normal(size=20_000)]
    assert noise.noise_floor(error) > 10.0
    assert noise.noise_floor(error, lowest=UNDER_STRUCTURE) == pytest.approx(1.0, rel=0.3)


def drawn(noise, error, rng):
    """An error of a drawn length, noise and size: (samples, true RMS of the noise)."""
    n, sigma = int(rng.choice([2000, 6000, 12_000])), 10.0 ** rng.uniform(-2.0, 1.0)
    rho = rng.choice([0.3, 0.6, 0.9]) if noise == "coloured" else 0.0
    v = sigma * lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], rng.standard_normal(n + 2000))[2000:]
    steps = np.repeat(rng.standard_normal(12), -(-n // 12))[:n]
    shape = {
        "none": lambda: np.zeros(n),
        "ramp": lambda: np.linspace(-1.0, 1.0, n),
        "drift": lambda: np.cumsum(np.cumsum(rng.standard_normal(n))),
        "walk": lambda: np.cumsum(rng.standard_normal(n)),
        "steps": lambda: steps,
        "lagged steps": lambda: lfilter([0.05], [1.0, -0.95], steps),
        "lagged noise": lambda: lfilter([4e-4], [1.0, -1.96, 0.9604], rng.standard_normal(n)),
    }[error]()
    x = v + sigma * 10.0 ** rng.uniform(0.3, 2.0) * (shape - shape.mean()) / max(
        shape.std(), 1e-300
    )
    coarse = 2.0 * sigma
    return (
        (coarse * np.round(x / coarse), np.hypot(sigma, coarse / np.sqrt(12.0)))
        if noise == "quantised"
        else (x, sigma)
    )


@pytest.mark.parametrize("noise", ["white", "coloured", "quantised"])
def test_the_noise_under_a_drifting_error_is_a_size_within_a_fifth_or_a_bound(noise):
    rng, told = np.random.default_rng(57), []
    for error in ["none", "ramp", "drift", "walk", "steps", "lagged steps", "lagged noise"] * 2:
        x, sigma = drawn(noise, error, rng)
        floor = floor_under_drift([x])
        assert (
            floor.rms > 0.9 * sigma if floor.at_most else floor.rms == pytest.approx(sigma, rel=0.2)
        ), error
        told.append(not floor.at_most)
    # slow noise and the tail of a walk are alike
    assert sum(told) >= (4 if noise == "coloured" else 11)


def test_without_a_fast_part_the_noise_is_nought_and_of_few_samples_a_bound():
    assert floor_under_drift([np.zeros(500)]).rms == 0.0
    few = floor_under_drift([np.random.default_rng(1).standard_normal(40)])
    assert few.at_most and few.rms == pytest.approx(1.0, rel=0.3)
