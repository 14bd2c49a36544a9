"""Residual evaluation of the gate actuator: band-pass, envelope, spectrum modulus, F₁ and F₂ (Valceschini, section 7.5.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len
from scipy.signal import butter, hilbert, sosfiltfilt

Signal = npt.NDArray[np.float64]
BAND = (0.5, 10.0)  # Hz
ENVELOPE_HARMONICS = 3
_NEIGHBOURHOOD = 0.05  # of each harmonic, either side
_ZERO_PADDING = 8


@dataclass(frozen=True, eq=False)
class EnvelopeSpectrum:
    """Modulus θ(f) of the envelope's amplitude spectrum.

    `frequency` [Hz] and `modulus` (unit of the residual), shape (n,); the mean of the envelope is taken off. The grid is
    finer than 1/duration (zero padding), because F₂ sums over a neighbourhood that is narrower than one bin of a
    ten-second record.
    """

    frequency: Signal
    modulus: Signal
    resolution: float

    def at(self, frequency: float) -> float:
        """θ(f), interpolated on the fine grid."""
        return float(np.interp(frequency, self.frequency, self.modulus))

    def around(self, frequency: float, relative: float = _NEIGHBOURHOOD) -> float:
        """Sum of θ over f(1 ± relative), in bins of 1/duration so that zero padding does not change it."""
        inside = np.abs(self.frequency - frequency) <= relative * frequency
        fine = self.frequency[1] - self.frequency[0]
        return float(np.sum(self.modulus[inside]) * fine / self.resolution)


def residual_envelope(residual: Signal, sample_time: float, band: tuple[float, float] = BAND) -> Signal:
    """|analytic signal| of the residual band-passed to `band` [Hz] (Butterworth of order 2, forward and backward), shape (n,).

    The filter runs over the whole movement, before the flat part is cut out, so its transient stays in the ramps.
    """
    sos = butter(2, band, btype="bandpass", fs=1.0 / sample_time, output="sos")
    narrow = np.asarray(sosfiltfilt(sos, residual, padlen=min(residual.shape[0] - 1, round(1.0 / sample_time))))
    length = next_fast_len(narrow.shape[0])
    return np.abs(np.asarray(hilbert(narrow, length)))[: narrow.shape[0]]


def envelope_spectrum(envelope: Signal, sample_time: float) -> EnvelopeSpectrum:
    """θ(f) of an envelope, scaled so that a sine of amplitude a shows as a.

    >>> t = np.arange(0, 10, 0.01)
    >>> spectrum = envelope_spectrum(2.0 + 0.5 * np.cos(2 * np.pi * 1.55 * t), 0.01)
    >>> abs(spectrum.at(1.55) - 0.5) < 0.02
    True
    """
    n = envelope.shape[0]
    length = next_fast_len(_ZERO_PADDING * n, real=True)
    modulus = np.abs(np.fft.rfft(envelope - np.mean(envelope), length)) * (2.0 / n)
    return EnvelopeSpectrum(
        np.asarray(np.fft.rfftfreq(length, sample_time)), np.asarray(modulus, dtype=float), 1.0 / (n * sample_time)
    )


def fault_indicators(
    spectrum: EnvelopeSpectrum, fault_frequency: float, harmonics: int = ENVELOPE_HARMONICS
) -> tuple[float, float]:
    """F₁ = Σₖ θ(k f) and F₂ = Σₖ Σ_{0.95 k f ≤ j ≤ 1.05 k f} θ(j) of (7.6), k = 1 … harmonics, f the fault frequency [Hz]."""
    orders = [k * fault_frequency for k in range(1, harmonics + 1)]
    return sum(map(spectrum.at, orders)), sum(map(spectrum.around, orders))
