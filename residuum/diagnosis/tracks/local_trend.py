r"""A value over irregular times as a local random walk: level and slope, with changes at known times and covariates.

    y_k = l(t_k) + xᵀ_k β + e_k,        e_k ~ N(0, s_k² + σ²)
    dl = b dt + q_l dw₁,   db = q_b dw₂

with the exact covariance of the walk over any pause h (Q = q_l² [h 0; 0 0] + q_b² [h³/3 h²/2; h²/2 h]). At a change the
level's or the slope's variance is opened. σ, q_l and q_b are not known: many filters run side by side, one a triple, and
each is weighed by its marginal likelihood, so that bands hold what is uncertain in them too.

Reference: A. C. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, chapters 2.3 and 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray

_OWN_SCATTER = np.geomspace(0.3, 2.2, 9)
"""σ, in units of the scatter between neighbours."""
_LEVEL_WALK = (0.0, 0.3, 1.0)
"""q_l √(mean pause), in units of the same."""
_SLOPE_WALK = (0.0, 0.003, 0.02)
"""q_b (mean pause)^1.5, in units of the same."""
_WALK_IS_RARE = (0.25, 0.05)
"""Prior weight of each step up in the size of a level's and of a slope's walk."""
_FEW = ((0.4, 0.7, 1.0, 1.5), (0.0, 0.3), (0.0,))
"""σ, q_l and q_b of the filters that places of changes are sought with."""
_OPEN = 10.0
"""Standard deviation of what is opened (level, and level over the record's length), in units of the values' span."""


@dataclass(frozen=True)
class Change:
    """At sample `at` the level (`level`), the slope (`slope`) or both (`renewal`) are opened: what was mended wears anew."""

    at: int
    kind: str


@dataclass(frozen=True, eq=False)
class LocalTrend:
    """Where the value stands at the last sample.

    Attributes
    ----------
    log_likelihood : float
        Marginal, over all filters.
    weight : array, shape (filters,)
    mean : array, shape (filters, 2 + covariates)
        Level, slope, β.
    covariance : array, shape (filters, 2 + covariates, 2 + covariates)
    level_walk, slope_walk : array, shape (filters,)
        q_l and q_b of each filter.
    """

    log_likelihood: float
    weight: FloatArray
    mean: FloatArray
    covariance: FloatArray
    level_walk: FloatArray
    slope_walk: FloatArray

    @property
    def state(self) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance of level, slope and β over all filters."""
        mean = self.weight @ self.mean
        away = self.mean - mean
        return mean, np.einsum("f,fij->ij", self.weight, self.covariance + away[:, :, None] * away[:, None, :])


def neighbours_scatter(y: FloatArray) -> float:
    """Standard deviation of one value, from differences of neighbours (what moves slowly hardly counts)."""
    step = np.abs(np.diff(y))
    return float(max(np.median(step) / 0.9539, 1e-9 * max(float(np.ptp(y)), 1e-300), 1e-300))


def local_trend(
    t: FloatArray, y: FloatArray, std: FloatArray, x: FloatArray, alternatives: Sequence[Sequence[Change]]
) -> LocalTrend:
    """Filter a value to its last sample; alternative lists of changes are weighed by their likelihood.

    Parameters
    ----------
    t, y, std : array, shape (n,)
        Times (rising), values and their standard deviations as each window tells them.
    x : array, shape (n, covariates)
        What the value moves with, centred.
    alternatives : sequence of sequences of Change
    """
    each = side_by_side(t, y, std, x, alternatives)
    likely = np.array([trend.log_likelihood for trend in each])
    share = np.exp(likely - likely.max())
    share /= share.sum()
    names = ("mean", "covariance", "level_walk", "slope_walk")
    joined = {name: np.concatenate([getattr(trend, name) for trend in each]) for name in names}
    weight = np.concatenate([part * trend.weight for part, trend in zip(share, each, strict=True)])
    return LocalTrend(float(likely.max() + np.log(np.mean(np.exp(likely - likely.max())))), weight, **joined)


def likelihoods(
    t: FloatArray, y: FloatArray, std: FloatArray, x: FloatArray, alternatives: Sequence[Sequence[Change]]
) -> FloatArray:
    """Marginal log-likelihood of several lists of changes at once, by few filters: to compare them with each other only."""
    return np.array([trend.log_likelihood for trend in side_by_side(t, y, std, x, alternatives, _FEW)])


_ALL = (tuple(_OWN_SCATTER.tolist()), _LEVEL_WALK, _SLOPE_WALK)


def side_by_side(
    t: FloatArray,
    y: FloatArray,
    std: FloatArray,
    x: FloatArray,
    alternatives: Sequence[Sequence[Change]],
    sizes: tuple[Sequence[float], Sequence[float], Sequence[float]] = _ALL,
) -> list[LocalTrend]:
    """The same for several lists of changes at once; `sizes` are the relative σ, q_l and q_b of the filters."""
    scatter, pause = neighbours_scatter(y), float(np.mean(np.diff(t)))
    filters = np.array(list(product(*sizes)))
    rare, rarer = _WALK_IS_RARE
    prior = np.array([rare ** sizes[1].index(a) * rarer ** sizes[2].index(b) for _, a, b in filters])
    own, q_level, q_slope = (filters * scatter / [1.0, np.sqrt(pause), pause**1.5]).T
    span = max(float(np.ptp(y)), scatter)
    opened = np.array([(_OPEN * span) ** 2, (_OPEN * span / max(float(t[-1] - t[0]), pause)) ** 2])
    count = len(alternatives)
    m = np.zeros((count, len(filters), 2 + x.shape[1]))
    m[:, :, 0] = y[0]
    P = np.zeros((*m.shape, m.shape[2]))
    covariate = (_OPEN * span / np.maximum(np.max(np.abs(x), axis=0, initial=0.0), 1e-300)) ** 2
    P[:, :] = np.diag(np.concatenate([opened, covariate]))
    log_likelihood = np.zeros((count, len(filters)))
    opens = _opens(alternatives, len(t))
    for k in range(len(t)):
        if k:
            _predict(m, P, t[k] - t[k - 1], q_level, q_slope)
            P[:, :, 0, 0] += opens[:, k, 0, None] * opened[0]
            P[:, :, 1, 1] += opens[:, k, 1, None] * opened[1]
        log_likelihood += _update(m, P, y[k], std[k] ** 2 + own**2, x[k])
    return [_weighed(log_likelihood[a], prior, m[a], P[a], q_level, q_slope) for a in range(count)]


def _opens(alternatives: Sequence[Sequence[Change]], n: int) -> npt.NDArray[np.bool_]:
    """Whether level and slope are opened, shape (alternatives, n, 2)."""
    opens = np.zeros((len(alternatives), n, 2), dtype=bool)
    for number, changes in enumerate(alternatives):
        for change in changes:
            opens[number, change.at] |= (change.kind != "slope", change.kind != "level")
    return opens


def _predict(m: FloatArray, P: FloatArray, h: float, q_level: FloatArray, q_slope: FloatArray) -> None:
    m[..., 0] += h * m[..., 1]
    P[..., 0, :] += h * P[..., 1, :]
    P[..., :, 0] += h * P[..., :, 1]
    P[..., 0, 0] += q_level**2 * h + q_slope**2 * h**3 / 3.0
    P[..., 0, 1] += q_slope**2 * h**2 / 2.0
    P[..., 1, 0] += q_slope**2 * h**2 / 2.0
    P[..., 1, 1] += q_slope**2 * h


def _update(m: FloatArray, P: FloatArray, y: float, variance: FloatArray, x: FloatArray) -> FloatArray:
    """Take one value; its log-likelihood by each filter."""
    row = np.concatenate([[1.0, 0.0], x])
    Pr = P @ row
    S = Pr @ row + variance
    e = y - m @ row
    gain = Pr / S[..., None]
    m += gain * e[..., None]
    P -= gain[..., :, None] * Pr[..., None, :]
    return np.asarray(-0.5 * (np.log(2.0 * np.pi * S) + e**2 / S))


def _weighed(
    log_likelihood: FloatArray, prior: FloatArray, m: FloatArray, P: FloatArray, q_level: FloatArray, q_slope: FloatArray
) -> LocalTrend:
    raised = log_likelihood + np.log(prior / prior.sum())
    top = float(raised.max())
    weight = np.exp(raised - top)
    total = float(weight.sum())
    return LocalTrend(top + float(np.log(total)), weight / total, m.copy(), P.copy(), q_level, q_slope)
