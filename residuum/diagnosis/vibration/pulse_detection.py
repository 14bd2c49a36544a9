"""Short torque pulses in a speed residual: whitening by an autoregressive model and matched filters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

Signal = npt.NDArray[np.float64]


def autoregressive_whitener(x: Signal, order: int) -> Signal:
    """Coefficients [1, a₁, …, a_p] of the prediction error filter A(z) of x by Yule–Walker, shape (order + 1,).

    A x is then white as far as an order-p model goes. A ridge of 10⁻⁹ of the power keeps a noise-free x solvable.
    """
    centred = x - np.mean(x)
    n = centred.shape[0]
    spectrum = rfft(centred, next_fast_len(2 * n, real=True))
    covariance = irfft(np.abs(spectrum) ** 2)[: order + 1] / n
    covariance[0] = covariance[0] * (1.0 + 1e-9) + np.finfo(float).tiny
    return np.concatenate([[1.0], -solve_toeplitz(covariance[:-1], covariance[1:])])


def pulse_templates(widths: Sequence[float], T: float, sample_time: float) -> list[Signal]:
    """Speed of a first-order drive after a load pulse, for each width [s]: one-signed, and a drop followed by a catch-up.

    A missing tooth unloads the drive while its place passes (one-signed) and is met again with a blow (opposite sign);
    which of the two rules depends on the backlash, so both shapes are tried.
    """
    a = float(np.exp(-sample_time / T))
    templates = []
    for width in widths:
        samples = max(1, round(width / sample_time))
        tail = round(4 * T / sample_time)
        one_signed = np.concatenate([np.ones(samples), np.zeros(tail)])
        drop_and_blow = np.concatenate([np.ones(samples), -np.ones(samples), np.zeros(tail)])
        templates += [np.asarray(lfilter([1.0 - a], [1.0, -a], load)) for load in (one_signed, drop_and_blow)]
    return templates


def matched_filter(x: Signal, whitener: Signal, template: Signal) -> tuple[Signal, float]:
    """Amplitude of `template` at every start, in standard deviations, shape (n,), and that deviation [unit of x].

    Both are whitened, so that z(t) = ⟨A s(·−t), A x⟩ / (σ ‖A s‖) is standard normal where there is no pulse; σ is the robust
    (median) deviation of A x, which a few pulses do not raise.
    """
    innovation = np.asarray(lfilter(whitener, [1.0], x - np.mean(x)))
    innovation[: whitener.shape[0]] = 0.0
    shape = np.asarray(lfilter(whitener, [1.0], template))
    sigma = 1.4826 * float(np.median(np.abs(innovation))) + np.finfo(float).tiny
    length = next_fast_len(x.shape[0] + shape.shape[0], real=True)
    correlation = irfft(rfft(innovation, length) * np.conj(rfft(shape, length)), length)[: x.shape[0]]
    energy = float(np.sqrt(shape @ shape))
    return np.asarray(correlation / (sigma * energy)), sigma / energy
