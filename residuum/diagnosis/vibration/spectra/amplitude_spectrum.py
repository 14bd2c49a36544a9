"""Amplitude spectrum of a signal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import fft

from residuum.array_types import FloatArray


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
    n = signal.shape[0]
    padded = fft.next_fast_len(n, real=True)
    x = np.zeros(padded)  # all that is held of a long signal, beside its spectrum: the rest is done in place
    x[:n] = signal
    missing = np.isnan(x)
    count = n - np.count_nonzero(missing)
    x[missing] = 0.0
    x[:n] -= x.sum() / max(1, count)
    x[missing] = 0.0
    if n > 2:
        window = np.arange(n) * (2 * np.pi / n)
        np.cos(window, out=window)
        window *= -0.5
        window += 0.5
        x[:n] *= window
        del window
    amplitude = np.abs(fft.rfft(x, overwrite_x=True))
    amplitude *= 2 / (n / 2 if n > 2 else n)  # over Σw, which is n/2 for a Hann window over whole periods
    return AmplitudeSpectrum(1 / (padded * sample_time), amplitude, 1.44 / (n * sample_time))
