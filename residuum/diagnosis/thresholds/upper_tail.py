"""Upper prediction limits from healthy values whose upper and lower halves may scatter differently."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from residuum.array_types import FloatArray


@dataclass(frozen=True, eq=False)
class UpperTail:
    """Median of healthy values and their scatter above it.

    A peak over a random pattern is skewed: its logarithm has a long lower tail, which would inflate a standard deviation and
    with it the limit. Only what lies above the median says how far healthy values reach upwards (split-normal model).

    Attributes
    ----------
    centre : array, shape (…)
        Median.
    scatter : array, shape (…)
        √ mean (x − median)² over the values above the median.
    n : int
        Values behind them.
    """

    centre: FloatArray
    scatter: FloatArray
    n: int

    @classmethod
    def of(cls, values: npt.ArrayLike) -> UpperTail:
        """From healthy values, shape (n, …), n ≥ 3.

        >>> tail = UpperTail.of(np.random.default_rng(0).standard_normal(4000))
        >>> round(float(tail.scatter), 1), 3.0 < float(tail.limit(1e-3)) < 3.3
        (1.0, True)
        """
        x = np.asarray(values, dtype=float)
        centre = np.median(x, axis=0)
        above = np.where(x > centre, x - centre, np.nan)
        mean_square = np.nansum(above**2, axis=0) / np.maximum(np.count_nonzero(x > centre, axis=0), 1)
        return cls(np.asarray(centre), np.sqrt(mean_square), x.shape[0])

    def limit(self, rate: float) -> FloatArray:
        """Value that a further healthy one passes with probability `rate` if the upper tail is normal, shape (…).

        centre + t(1 − rate) √(1 + 2/n) scatter, t Student's with n − 1 degrees of freedom: high for few values, normal
        for many.
        """
        reach = student.isf(rate, max(1, self.n - 1)) * np.sqrt(1.0 + 2.0 / self.n)
        return np.asarray(self.centre + reach * self.scatter)
