"""Residual tests: is the residual white, and is it free of the input, with the colour of the noise accounted for?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import linalg, stats

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.kernel_based.gram import regression_sums
from residuum.identification.linear_models.autoregression import autocovariance, fit_autoregression, whitened
from residuum.identification.linear_models.excitation import excitation_order


@dataclass(frozen=True, eq=False)
class ResidualTest:
    """Correlations with the band that a good model keeps them in, and the joint test of all lags.

    Attributes
    ----------
    lags, correlation : array, shape (k,)
    band : float
        Half width of the two-sided band of a single correlation at the level of the test.
    statistic, degrees_of_freedom, p_value : float, int, float
        χ² statistic of all lags together.
    level : float
        False-alarm rate of the joint test.
    noise_order : int
        Order of the autoregression that whitened the residual (0 = none).
    """

    lags: npt.NDArray[np.int_]
    correlation: FloatArray
    band: float
    statistic: float
    degrees_of_freedom: int
    p_value: float
    level: float
    noise_order: int

    @property
    def passed(self) -> bool:
        """Whether the joint test finds nothing."""
        return self.p_value >= self.level


def whiteness_test(residual: npt.ArrayLike, *, lags: int = 25, n_parameters: int = 0, level: float = 0.01) -> ResidualTest:
    """Ljung–Box test: Q = n(n+2) Σ r_k²/(n−k) is χ² with `lags` − `n_parameters` degrees of freedom if the residual is white.

    A prediction error should pass; a simulation error need not (output noise may be coloured).

    Ljung, Box, Biometrika 65 (1978) 297–303. Missing samples are skipped, which keeps the test slightly conservative.

    Parameters
    ----------
    residual : array, shape (n,)
    lags : int
    n_parameters : int
        Parameters of a noise model that were estimated from the same data.
    level : float

    >>> whiteness_test(np.random.default_rng(0).standard_normal(500)).passed
    True
    """
    _check(lags, level)
    if lags <= n_parameters:
        raise BadInput(f"whiteness test: {lags} lags must exceed the {n_parameters} estimated parameters")
    covariance = autocovariance(residual, lags)
    if not covariance[0] > 0:
        raise NotIdentifiable("whiteness test: the residual is constant")
    n = int(np.count_nonzero(~np.isnan(np.asarray(residual, dtype=float))))
    correlation, k = covariance[1:] / covariance[0], np.arange(1, lags + 1)
    statistic = float(n * (n + 2) * np.sum(correlation**2 / (n - k)))
    band = float(stats.norm.isf(level / 2)) / math.sqrt(n)
    freedom = lags - n_parameters
    return ResidualTest(k, correlation, band, statistic, freedom, float(stats.chi2.sf(statistic, freedom)), level, 0)


def input_correlation_test(
    residual: npt.ArrayLike,
    input: npt.ArrayLike,
    *,
    lags: int = 25,
    first_lag: int = 0,
    level: float = 0.01,
    coloured: bool = True,
) -> ResidualTest:
    """Does the residual still contain the input? Regression of ε on u(t − first_lag) … u(t − first_lag − lags + 1).

    With coloured noise the correlations of ε and u scatter more than 1/√n, and a test that ignores it rejects good
    models. Both signals are therefore filtered with A(q), the autoregression of ε, which leaves their relation
    unchanged and the noise white: the explained sum of squares over σ² is then χ² in the rank of the input's Gram
    matrix, whatever the colour of the input. Söderström, Stoica, System Identification (1989), section 11.2.

    Fails (reports too small a p-value) when parameters were fitted to the same data with more freedom than n can bear; use
    validation data then.

    Parameters
    ----------
    residual, input : array, shape (n,)
        NaN = missing; rows that touch one are left out.
    lags, first_lag : int
        A negative first_lag also looks for feedback from ε to u.
    level : float
    coloured : bool
        False: the noise is taken to be white.

    >>> rng = np.random.default_rng(0)
    >>> u, e = rng.standard_normal((2, 1000))
    >>> input_correlation_test(e, u).passed, input_correlation_test(e + 0.3 * u, u).passed
    (True, False)
    """
    _check(lags, level)
    residual, u = np.asarray(residual, dtype=float), np.asarray(input, dtype=float)
    A = fit_autoregression(residual)[0] if coloured else np.ones(1)
    residual, u = whitened(residual, A), whitened(u, A)
    if first_lag < 0:
        u, residual, delay = u[-first_lag:], residual[:first_lag], 0
    else:
        delay = first_lag
    sums = regression_sums([u], residual, lags, delay).centred()
    if sums.degrees_of_freedom <= 2 * lags:
        raise NotIdentifiable(f"input correlation test: {sums.rows} complete rows for {lags} lags; needs more than twice as many")
    eigenvalues, vectors = linalg.eigh(sums.gram)
    rank = excitation_order(sums.gram)
    projected = (vectors.T @ sums.cross)[len(eigenvalues) - rank :]
    explained = float(np.sum(projected**2 / eigenvalues[len(eigenvalues) - rank :])) if eigenvalues[-1] > 0 else 0.0
    freedom = sums.degrees_of_freedom - rank
    statistic = explained / max((sums.energy - explained) / freedom, np.finfo(float).tiny)
    correlation = sums.cross / np.sqrt(np.maximum(np.diag(sums.gram) * sums.energy, np.finfo(float).tiny))
    band = float(stats.norm.isf(level / 2)) / math.sqrt(sums.degrees_of_freedom)
    p_value = float(stats.f.sf(statistic / rank, rank, freedom)) if rank else 1.0
    return ResidualTest(first_lag + np.arange(lags), correlation, band, statistic, rank, p_value, level, len(A) - 1)


def _check(lags: int, level: float) -> None:
    if lags < 1 or not 0 < level < 1:
        raise BadInput(f"residual test: {lags} lags and level {level}; needs lags ≥ 1 and a level between 0 and 1")
