"""Upper limits of indicators, from what healthy data showed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from residuum.array_types import AnyArray


@dataclass(frozen=True, eq=False)
class HealthyBand:
    """Mean and scatter of the logarithm of positive indicators over n healthy observations.

    Attributes
    ----------
    mean, scatter : arrays of one shape, natural logarithms
    n : int
        Observations behind them.
    """

    mean: AnyArray
    scatter: AnyArray
    n: int

    @classmethod
    def of(cls, observations: npt.ArrayLike) -> HealthyBand:
        """From positive indicators, shape (n, …), n ≥ 2; scatter is the larger of standard and quantile-based deviation."""
        logs = np.log(np.asarray(observations, dtype=float))
        quantiles = np.quantile(logs, [0.05, 0.5, 0.95], axis=0)
        by_quantiles = (quantiles[2] - quantiles[0]) / 3.29
        return cls(logs.mean(axis=0), np.maximum(logs.std(axis=0, ddof=1), by_quantiles), logs.shape[0])

    def upper(self, false_alarm: float, least_change: float | AnyArray = 1.0) -> AnyArray:
        """Limit that one further healthy observation passes with probability `false_alarm`.

        exp(mean + t_{n−1}(1 − false_alarm) √(1 + 1/n) scatter): Student's prediction limit of a log-normal indicator, exact for
        normal logarithms, high for few observations; never below `least_change` times the healthy median, because
        a significant change of a few percent is no fault.
        """
        reach = student.isf(false_alarm, self.n - 1) * np.sqrt(1 + 1 / self.n) * self.scatter
        return np.asarray(np.exp(self.mean + np.maximum(reach, np.log(least_change))))

    def deviation(self, observation: npt.ArrayLike) -> AnyArray:
        """Healthy standard deviations above the mean (of the logarithm)."""
        with np.errstate(divide="ignore"):
            logs = np.log(np.asarray(observation, dtype=float))
        return np.asarray((logs - self.mean) / np.maximum(self.scatter, 1e-6))
