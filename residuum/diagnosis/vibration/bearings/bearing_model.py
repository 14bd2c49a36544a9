"""Vibration of a bearing with a localised fault, by formula: the signal that envelope analysis assumes."""

from __future__ import annotations

from typing import Literal

import numpy as np

from residuum.array_types import AnyArray


def impact_train(
    n: int,
    sampling_rate: float,
    frequency: float,
    *,
    resonance: float,
    damping: float = 0.05,
    slip: float = 0.01,
    modulation: float = 0.0,
    modulated_at: float = 0.0,
    seed: int = 0,
) -> AnyArray:
    r"""Impacts of a passing fault that ring a resonance, unit RMS.

    .. math::
        x(t) = \sum_i (1 + m \cos 2\pi f_m t_i)(1 + 0.1 \epsilon_i) h(t - t_i), \quad t_{i+1} = t_i + (1 + s \eta_i)/f, \quad
        h(t) = e^{-2\pi\zeta f_n t} \sin 2\pi f_n t

    Parameters
    ----------
    n, sampling_rate : samples, [Hz]
    frequency : f, mean rate of the impacts [Hz]
    resonance, damping : f_n [Hz] and ζ [-]
    slip : s, random part of each interval [-] (it accumulates, so high harmonics smear)
    modulation, modulated_at : m [-] and f_m [Hz]; a load zone modulates an inner race with the shaft, a ball with the cage
    seed : of the random ε, η

    References
    ----------
    J. Antoni, R. B. Randall, J. Vib. Acoust. 125 (2003) 282–289.
    """
    rng = np.random.default_rng(seed)
    count = int(n / sampling_rate * frequency * (1 + 5 * slip)) + 8
    times = np.cumsum((1 + slip * rng.standard_normal(count)) / frequency)
    at = (times * sampling_rate).astype(int)
    strength = (1 + modulation * np.cos(2 * np.pi * modulated_at * times)) * (1 + 0.1 * rng.standard_normal(count))
    impacts = np.zeros(n)
    np.add.at(impacts, at[at < n], strength[at < n])
    t = np.arange(min(n, int(8 * sampling_rate / (2 * np.pi * damping * resonance)) + 2)) / sampling_rate
    ring = np.exp(-2 * np.pi * damping * resonance * t) * np.sin(2 * np.pi * resonance * t)
    x = np.fft.irfft(np.fft.rfft(impacts, 2 * n) * np.fft.rfft(ring, 2 * n), 2 * n)[:n]
    return np.asarray(x / np.sqrt(np.mean(x * x)))


def faulty_bearing(
    n: int,
    sampling_rate: float,
    shaft: float,
    orders: dict[str, float],
    fault: Literal["bpfi", "bpfo", "bsf", "ftf"] | None,
    *,
    snr_db: float = 0.0,
    resonance: float = 3200.0,
    seed: int = 0,
) -> AnyArray:
    """White noise of unit RMS, shaft harmonics, and (unless `fault` is None) the fault's impacts `snr_db` above the noise."""
    rng = np.random.default_rng([seed, 1])
    t = np.arange(n) / sampling_rate
    x = rng.standard_normal(n)
    for harmonic in (1, 2, 3):
        x += 0.3 / harmonic * np.cos(2 * np.pi * harmonic * shaft * t + rng.uniform(0, 2 * np.pi))
    if fault is None:
        return np.asarray(x)
    rate, modulation, modulated_at = {
        "bpfi": (orders.get("bpfi", 0.0), 0.8, shaft),
        "bpfo": (orders.get("bpfo", 0.0), 0.0, 0.0),
        "bsf": (2 * orders.get("bsf", 0.0), 0.5, orders.get("ftf", 0.4) * shaft),
        "ftf": (orders.get("ftf", 0.0), 0.0, 0.0),
    }[fault]
    train = impact_train(
        n, sampling_rate, rate * shaft, resonance=resonance, modulation=modulation, modulated_at=modulated_at, seed=seed
    )
    return np.asarray(x + 10 ** (snr_db / 20) * train)
