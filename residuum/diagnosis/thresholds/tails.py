"""Laws of healthy values and of their tails, and the limits that follow from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import optimize, stats
from scipy.stats import t as student

from residuum.array_types import AnyArray, FloatArray

# Upper limits of indicators, from what healthy data showed.


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
        """From positive indicators, shape (n, …), n ≥ 2; scatter is the larger of standard and
        quantile-based deviation.
        """
        logs = np.log(np.asarray(observations, dtype=float))
        quantiles = np.quantile(logs, [0.05, 0.5, 0.95], axis=0)
        by_quantiles = (quantiles[2] - quantiles[0]) / 3.29
        return cls(
            logs.mean(axis=0), np.maximum(logs.std(axis=0, ddof=1), by_quantiles), logs.shape[0]
        )

    def upper(self, false_alarm: float, least_change: float | AnyArray = 1.0) -> AnyArray:
        """Limit that one further healthy observation passes with probability `false_alarm`.

        exp(mean + t_{n−1}(1 − false_alarm) √(1 + 1/n) scatter): Student's prediction limit of a
        log-normal indicator, exact for normal logarithms, high for few observations; never below
        `least_change` times the healthy median, because a significant change of a few percent is no
        fault.
        """
        reach = student.isf(false_alarm, self.n - 1) * np.sqrt(1 + 1 / self.n) * self.scatter
        return np.asarray(np.exp(self.mean + np.maximum(reach, np.log(least_change))))

    def deviation(self, observation: npt.ArrayLike) -> AnyArray:
        """Healthy standard deviations above the mean (of the logarithm)."""
        with np.errstate(divide="ignore"):
            logs = np.log(np.asarray(observation, dtype=float))
        return np.asarray((logs - self.mean) / np.maximum(self.scatter, 1e-6))


# Upper prediction limits from healthy values whose upper and lower halves may scatter
# differently.


@dataclass(frozen=True, eq=False)
class UpperTail:
    """Median of healthy values and their scatter above it.

    A peak over a random pattern is skewed: its logarithm has a long lower tail, which would inflate
    a standard deviation and with it the limit. Only what lies above the median says how far healthy
    values reach upwards (split-normal model).

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
        mean_square = np.nansum(above**2, axis=0) / np.maximum(
            np.count_nonzero(x > centre, axis=0), 1
        )
        return cls(np.asarray(centre), np.sqrt(mean_square), x.shape[0])

    def limit(self, rate: float) -> FloatArray:
        """Value that a further healthy one passes with probability `rate` if the upper tail is
        normal, shape (…).

        centre + t(1 − rate) √(1 + 2/n) scatter, t Student's with n − 1 degrees of freedom: high for
        few values, normal for many.
        """
        reach = student.isf(rate, max(1, self.n - 1)) * np.sqrt(1.0 + 2.0 / self.n)
        return np.asarray(self.centre + reach * self.scatter)


# The far tail of a noise, taken from healthy samples instead of from the form of a distribution.

# in a tail: fewer scatter, more reach to where the hazard bends
_SAMPLES = (1000, 500, 250, 100, 50)
_LARGEST_SHARE = 0.05
_FITS = 0.1  # Cramér–von Mises probability above which a fitted tail is not doubted
# samples that a fitted tail expects beyond a level: what it says of the far end is held against
# their number
_FARTHEST = 10
_LIKELY = (5, 16)  # of a Poisson count of 10, with a probability of 94 %
_STEP = 1e-3  # for the density of the law that a tail is held against
_PARAMETERS = 3  # of a tail: its share, its hazard and its growth


@dataclass(frozen=True)
class HazardTail:
    """P(|x| > start + y) = share · exp(−a y − ½ c y²): a hazard a + c y that does not fall.

    One form for every tail that is not heavier than exponential: c = 0 is Laplace noise, c = 1/σ² a
    Gaussian one, and the sum of a noise with bounds and a small Gaussian error of standard
    deviation s has c = 1/s² beyond the bound.

    Attributes
    ----------
    start : float
        Where it begins, in the unit of x.
    share : float
        P(|x| > start).
    hazard, growth : float
        a ≥ 0 [1/unit] and c ≥ 0 [1/unit²], not both zero.

    Examples
    --------
    >>> tail = HazardTail(2.0, 0.01, 3.0, 0.0)
    >>> round(float(np.exp(tail.log_probability(3.0))), 6), round(float(tail.level(1e-4)), 3)
    (0.000498, 3.535)
    """

    start: float
    share: float
    hazard: float
    growth: float

    def log_probability(self, x: npt.ArrayLike) -> FloatArray:
        """ln P(|x| > x) for x ≥ start, any shape."""
        y = np.asarray(x, dtype=float) - self.start
        return np.asarray(np.log(self.share) - self.hazard * y - 0.5 * self.growth * y**2)

    def level(self, probability: npt.ArrayLike) -> FloatArray:
        """What |x| passes with this probability ≤ share, any shape."""
        nats = np.log(self.share / np.asarray(probability, dtype=float))
        return np.asarray(
            self.start
            + 2.0 * nats / (self.hazard + np.sqrt(self.hazard**2 + 2.0 * self.growth * nats))
        )


def fit_hazard_tail(excess: FloatArray) -> tuple[float, float]:
    """a and c of greatest likelihood for what the tail's samples exceed its start by, shape (k,),
    all positive.

    Σ ln(a + c y) − a Σ y − ½ c Σ y² is concave; along its ridge a Σ y + ½ c Σ y² = k, so only c is
    searched for.
    """
    total, half_square, k = float(np.sum(excess)), 0.5 * float(np.sum(excess**2)), len(excess)

    def hazard(growth: float) -> float:
        return max(0.0, (k - growth * half_square) / total)

    def cost(growth: float) -> float:
        return -float(
            np.sum(np.log(np.maximum(hazard(growth) + growth * excess, np.finfo(float).tiny)))
        )

    most = k / half_square
    minimum = optimize.minimize_scalar(
        cost, bounds=(0.0, most), method="bounded", options={"xatol": 1e-6 * most}
    )
    growth = float(minimum.x) if minimum.fun < cost(0.0) else 0.0
    return hazard(growth), growth


def differing_tail(
    sizes: npt.ArrayLike, log_tail: Callable[[FloatArray], FloatArray]
) -> HazardTail | None:
    """The tail of healthy samples where it is not that of a law; None while the samples do not
    contradict the law.

    The most of the largest samples (1000 … 50, never more than 5 % of all) that a tail of
    non-falling hazard fits are taken where the likelihood of all samples, each known to lie below
    its start or where it lies, beats that of the law by the tail's three parameters in BIC.

    Parameters
    ----------
    sizes : array, shape (n,)
        |x| of independent samples. Dependent ones make the choice readier than BIC means it to be.
    log_tail : function
        ln P(|x| > ·) of the law.

    It fails where the noise reaches further than its healthy samples show: beyond the largest of
    them the hazard is extrapolated.

    Source: the form is the linear hazard rate of reliability theory (Bain, Technometrics 16, 1974);
    the choice of the share by a test of fit follows Bader, Yan and Zhang, Annals of Applied
    Statistics 12, 2018.
    """
    ascending = np.sort(np.abs(np.asarray(sizes, dtype=float)))
    n = len(ascending)
    for k in _SAMPLES:
        if k > _LARGEST_SHARE * n:
            continue
        start = float(ascending[n - k - 1])
        excess = ascending[n - k :] - start
        if excess[0] < 0.0 or float(np.sum(excess)) == 0.0:
            continue
        tail = HazardTail(start, k / n, *fit_hazard_tail(excess))
        nats = tail.hazard * excess + 0.5 * tail.growth * excess**2
        if not _fits(nats):
            continue
        gain = _log_likelihood(tail, excess, n) - _law_log_likelihood(
            log_tail, start, ascending[n - k :], n
        )
        if gain > 0.5 * _PARAMETERS * np.log(n):
            return tail
    return None


def _fits(nats: FloatArray) -> bool:
    """Whether a fitted tail's integrated hazards at its samples are exponential, as a whole and at
    the far end.
    """
    far = int(np.count_nonzero(nats > np.log(len(nats) / _FARTHEST)))
    return bool(
        _LIKELY[0] <= far <= _LIKELY[1] and stats.cramervonmises(nats, "expon").pvalue >= _FITS
    )


def _log_likelihood(tail: HazardTail, excess: FloatArray, n: int) -> float:
    hazard = np.log(np.maximum(tail.hazard + tail.growth * excess, np.finfo(float).tiny))
    below = (n - len(excess)) * float(np.log1p(-tail.share))
    return below + float(np.sum(hazard + tail.log_probability(tail.start + excess)))


def _law_log_likelihood(
    log_tail: Callable[[FloatArray], FloatArray], start: float, above: FloatArray, n: int
) -> float:
    inside, outside = log_tail(above - _STEP), log_tail(above + _STEP)
    hazard = np.maximum((inside - outside) / (2.0 * _STEP), np.finfo(float).tiny)
    below = (n - len(above)) * float(np.log1p(-np.exp(log_tail(np.array([start]))[0])))
    return below + float(np.sum(np.log(hazard) + log_tail(above)))
