"""Indicators of a stretch of vibration: RMS, kurtosis, crest factor, impulsiveness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.array_types import AnyArray
from residuum.kept_loops import njit


@dataclass(frozen=True)
class Indicators:
    """Scalars of a signal x of n samples; all but `rms`, `peak` and `mean` are free of unit and gain.

    Attributes
    ----------
    rms : √(E x²), in the signal's unit, mean included
    kurtosis : E(x − μ)⁴ / (E(x − μ)²)²; 3 for a Gaussian signal, 3.245 for the envelope of Gaussian noise; NaN when x is constant
    peak : max |x|
    crest : peak / rms; NaN for silence
    impulsiveness : peak / E|x| (impulse factor); NaN for silence
    mean : μ
    """

    rms: float
    kurtosis: float
    peak: float
    crest: float
    impulsiveness: float
    mean: float


def indicators(x: npt.ArrayLike) -> Indicators:
    """The indicators of a vector of at least one sample, in two passes with double sums (no double copy of float32).

    >>> found = indicators([1.0, -1.0, 1.0, -1.0])
    >>> found.rms, found.kurtosis, found.crest
    (1.0, 1.0, 1.0)
    """
    x = np.ascontiguousarray(x)
    if x.dtype != np.float32:
        x = x.astype(np.float64, copy=False)
    mean, square, absolute, peak = _first_pass(x)
    second, fourth = _central_moments(x, mean)
    rms = float(np.sqrt(square))
    constant = not second > 0 or float(np.ptp(x)) == 0  # rounding of the mean leaves a second moment in equal samples
    kurtosis = np.nan if constant else fourth / second**2
    return Indicators(rms, float(kurtosis), float(peak), _ratio(peak, rms), _ratio(peak, absolute), float(mean))


def _ratio(numerator: float, denominator: float) -> float:
    return float(numerator / denominator) if denominator > 0 else float("nan")


@njit(fastmath={"reassoc", "contract"})
def _first_pass(x: AnyArray) -> tuple[float, float, float, float]:
    total, square, absolute, peak = 0.0, 0.0, 0.0, 0.0
    for k in range(x.shape[0]):
        value = float(x[k])
        total += value
        square += value * value
        absolute += abs(value)
        peak = max(peak, abs(value))
    n = x.shape[0]
    return total / n, square / n, absolute / n, peak


@njit(fastmath={"reassoc", "contract"})
def _central_moments(x: AnyArray, mean: float) -> tuple[float, float]:
    second, fourth = 0.0, 0.0
    for k in range(x.shape[0]):
        square = (float(x[k]) - mean) ** 2
        second += square
        fourth += square * square
    return second / x.shape[0], fourth / x.shape[0]
