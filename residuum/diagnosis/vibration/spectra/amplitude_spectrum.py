"""Amplitude spectrum of a signal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import fft

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AmplitudeSpectrum:
    """Amplitudes [unit of the signal] at 0, step, 2·step … [Hz]; `resolution` is the window's half-power width [Hz]."""

    step: float
    amplitude: FloatArray
    resolution: float


def amplitude_spectrum(signal: npt.NDArray[Any], sample_time: float) -> AmplitudeSpectrum:
    """Amplitude spectrum |X(f)|: a sine of amplitude A at a bin shows as A.

    Mean removed, Hann window w, X = 2 |FFT(w x)| / Σw. Missing samples count as the mean. The length is padded to
    one the FFT likes, so a long prime-length window costs no more than its neighbour.

    >>> t = np.arange(1000) / 1000
    >>> float(amplitude_spectrum(3 * np.sin(2 * np.pi * 50 * t), 1e-3).amplitude.max().round(2))
    3.0
    """
    x = np.asarray(signal, dtype=np.float64)
    present = ~np.isnan(x)
    x = np.where(present, x - (x[present].mean() if present.any() else 0.0), 0.0)
    n = x.shape[0]
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n) / n) if n > 2 else np.ones(n)
    padded = fft.next_fast_len(n, real=True)
    amplitude = 2 * np.abs(fft.rfft(x * window, padded)) / window.sum()
    return AmplitudeSpectrum(1 / (padded * sample_time), amplitude, 1.44 / (n * sample_time))
