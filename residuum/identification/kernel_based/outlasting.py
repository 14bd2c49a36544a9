"""What an impulse response of finite length cuts off, and the longer one that a bound on the error
must be drawn from.

A response of m coefficients says nothing of those after them. Where it has not decayed by then, its
posterior knows neither the part that is missing nor how the missing part moved the rest, and a
bound that is drawn from it alone lies below the true error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray

NEGLIGIBLE = 0.5
"""What the last fifth may add to a frequency response, in standard deviations of that response."""
_GROWTH = 1.5  # from one length that is tried to the next
_LONGEST = 600  # coefficients of all inputs together, at most
_ROWS_A_COEFFICIENT = 3  # at least
_LAST = 5  # a fifth of the coefficients is what decay is judged by
Posterior = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class Longer:
    """Mean (M,) and covariance (M, M) of a longer response, and whether what it still cuts off is
    negligible.
    """

    mean: FloatArray
    covariance: FloatArray
    negligible: bool


def outlasting(mean: FloatArray, covariance: FloatArray) -> float:
    """max_ω L(ω)/s(ω): L = |Σ_k g_k e^{−jωk}| over the last fifth of the coefficients, s² = φᴴ Σ φ
    of all of them.

    A response that decays has a last fifth larger than what follows it, so a small ratio says that
    what was cut off is lost in what is uncertain anyway. Fails for a response that begins anew
    after the last coefficient.

    >>> g = 0.5 ** np.arange(40)
    >>> outlasting(g, 1e-4 * np.eye(40)) < 1e-3, outlasting(np.ones(40), 1e-4 * np.eye(40)) > 100
    (True, True)
    """
    m = len(mean)
    # four points or more a coefficient, so that the maximum over ω lies near one of them
    points = 1 << (4 * m).bit_length()
    last = np.fft.rfft(mean[m - max(1, m // _LAST) :], points)
    # φᴴ Σ φ is a cosine series: its coefficients are the sums along the diagonals of Σ
    apart = np.abs(np.subtract.outer(np.arange(m), np.arange(m)))
    diagonals = np.bincount(apart.ravel(), weights=covariance.ravel(), minlength=m)
    variance = np.fft.rfft(diagonals, points).real
    return float(np.max(np.abs(last) / np.sqrt(np.maximum(variance, np.finfo(float).tiny))))


def longer_response(
    first: Posterior, order: int, rows: int, fit: Callable[[int], Posterior], n_inputs: int = 1
) -> Longer | None:
    """The response by which what `order` cuts off is negligible; None when nothing is left at
    `order` itself.

    Of several inputs, the stacked responses to all of them, of one length; the one that lasts
    longest decides.

    Parameters
    ----------
    first : mean (n_inputs·p,) and covariance (n_inputs·p, n_inputs·p)
        The fit at hand, p ≥ order coefficients an input.
    rows : int
        Rows of the regression: a third as many coefficients, and 600, are the most that are tried,
        of all inputs together.
    fit : callable
        Number of coefficients an input → their mean and covariance.
    """
    mean, covariance = first
    if _outlasting(mean, covariance, order, n_inputs) <= NEGLIGIBLE:
        return None
    most = min(rows // _ROWS_A_COEFFICIENT, _LONGEST) // n_inputs
    while _outlasting(mean, covariance, len(mean) // n_inputs, n_inputs) > NEGLIGIBLE:
        length = min(round(_GROWTH * len(mean) / n_inputs), most)
        if length <= len(mean) // n_inputs:
            return Longer(mean, covariance, negligible=False)
        mean, covariance = fit(length)
    return Longer(mean, covariance, negligible=True)


def _outlasting(mean: FloatArray, covariance: FloatArray, m: int, n_inputs: int) -> float:
    """The largest `outlasting` of the inputs' responses, each cut after m coefficients."""
    p = len(mean) // n_inputs
    parts = [slice(j * p, j * p + m) for j in range(n_inputs)]
    return max(outlasting(mean[part], covariance[part, part]) for part in parts)
