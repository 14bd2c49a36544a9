r"""How a healthy machine's sizes scatter from window to window, as the sums of healthy windows show it.

Each window w has sizes b_w = b̄ + δ_w, δ_w ~ N(0, D) with D diagonal, and the innovations r_w = J_w b_w + noise of variance
one. So its sums g_w = J_wᵀ r_w have the mean A_w b̄ and the covariance A_w + A_w D A_w. What the model leaves over when the
machine is healthy is so described in the sizes of everything that may be missing or may change: it raises the limit
of what resembles it, in windows whose operation shows it, and of nothing else. b̄ and D are estimated by expectation and
maximisation.

Reference: N. M. Laird, J. H. Ware, Biometrics 38 (1982) 963.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.window_statistics import WindowStatistics

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

ROUNDS = 100
_FIRST = 0.1
"""Variance that every size begins with, in units of what one healthy window tells of it alone."""
_OWN = 1e-3
"""Share of its information that a size must have beyond the sizes before it, to scatter by itself."""


@dataclass(frozen=True, eq=False)
class HealthyScatter:
    """Mean and scatter of the sizes over healthy windows, in units of `scale`.

    Attributes
    ----------
    scale : array, shape (m,)
        Standard deviation with which a healthy window alone tells each size.
    own : array of int, shape (k,)
        Sizes that scatter by themselves; all others resemble those.
    mean : array, shape (m,)
        b̄.
    covariance : array, shape (m, m)
        Of the sizes of one further window: D, and the doubt of b̄.
    windows : int
    """

    scale: Array
    own: Integers
    mean: Array
    covariance: Array
    windows: int

    def judged(self, statistics: WindowStatistics) -> Judged:
        """A window's sums in these units, about the healthy mean, weighted by what is usual when healthy."""
        scaled = statistics.scaled(self.scale).about(self.mean)
        weights = self.weights(statistics)
        left = weights @ np.column_stack([scaled.A, scaled.g])
        m = len(self.mean)
        information = scaled.A - scaled.A @ left[:, :m]
        noise = weights @ information
        single = information - scaled.A @ noise
        score = scaled.g - scaled.A @ left[:, m]
        return Judged(score, 0.5 * (information + information.T), np.diag(single).copy(), self.scale, self.windows)

    def weights(self, statistics: WindowStatistics) -> Array:
        """S (1 + A S)⁻¹ in these units, S the covariance: what a projection on J becomes on its way through Σ⁻¹."""
        at = self.own
        A = statistics.A[np.ix_(at, at)] * self.scale[at][:, None] * self.scale[at]
        S = self.covariance[np.ix_(at, at)]
        weights = np.zeros((len(self.mean), len(self.mean)))
        inner = np.linalg.solve(np.eye(len(at)) + S @ A, S)
        weights[np.ix_(at, at)] = 0.5 * (inner + inner.T)
        return weights


@dataclass(frozen=True, eq=False)
class Judged:
    """Score and information of every size in a window, both weighted by Σ⁻¹, Σ = 1 + J S Jᵀ.

    `score` u = Jᵀ Σ⁻¹ (r − J b̄), `information` I = Jᵀ Σ⁻¹ J; `noise` is that part of I's diagonal that single samples account
    for, the rest the scatter between windows, which is known from `windows` of them.
    """

    score: Array
    information: Array
    noise: Array
    scale: Array
    windows: int

    @property
    def freedom(self) -> Array:
        """Degrees of freedom of each size's variance (Welch and Satterthwaite), shape (m,)."""
        total = np.maximum(np.diag(self.information), 1e-300)
        between = np.clip(1.0 - self.noise / total, 1e-6, 1.0)
        return np.asarray((self.windows - 1) / between**2)


def healthy_scatter(
    windows: Sequence[WindowStatistics], rounds: int = ROUNDS, start: HealthyScatter | None = None
) -> HealthyScatter:
    """Mean and scatter of every size over healthy windows; `start` saves rounds where a similar set was done."""
    scale = unit_of_each(windows) if start is None else start.scale
    scaled = [w.scaled(scale) for w in windows]
    own = own_sizes(np.mean([w.A for w in scaled], axis=0)) if start is None else start.own
    A, g = np.array([w.of(own).A for w in scaled]), np.array([w.g[own] for w in scaled])
    k = len(own)
    variance = np.full(k, _FIRST) if start is None else np.maximum(np.diag(start.covariance)[own], 1e-6)
    prior, mean, doubt = np.full(k, 1.0), np.zeros(k), np.eye(k)
    for _ in range(rounds):
        mean, doubt = _mean(A, g, variance, prior)
        prior = mean**2 + np.diag(doubt)
        rest = g - A @ mean
        # posterior of δ_w: covariance (A + D⁻¹)⁻¹ = D − D (1 + A D)⁻¹ A D, mean D (1 + A D)⁻¹ (g − A b̄)
        solved = np.linalg.solve(np.eye(k) + A * variance, np.concatenate([rest[:, :, None], A], axis=2))
        deviation = variance * solved[:, :, 0]
        left = variance - variance * np.einsum("wii->wi", solved[:, :, 1:]) * variance
        variance = np.mean(deviation**2 + np.maximum(left, 0.0), axis=0)
    mean, doubt = _mean(A, g, variance, prior)
    m = len(scale)
    full_mean, covariance = np.zeros(m), np.zeros((m, m))
    full_mean[own] = mean
    covariance[np.ix_(own, own)] = np.diag(variance * len(windows) / max(len(windows) - 1, 1)) + doubt
    return HealthyScatter(scale, own, full_mean, covariance, len(windows))


def unit_of_each(windows: Sequence[WindowStatistics]) -> Array:
    """Standard deviation with which a usual window alone tells each size; 1 where none does."""
    information = np.mean([np.diag(w.A) for w in windows], axis=0)
    return np.where(information > 0.0, 1.0 / np.sqrt(np.where(information > 0.0, information, 1.0)), 1.0)


def own_sizes(correlation: Array) -> Integers:
    """Sizes, in their order, whose information is not nearly that of the ones before (a Cholesky factorisation tells)."""
    left = correlation.copy()
    kept = []
    for j in range(len(left)):
        if left[j, j] > _OWN * max(correlation[j, j], 1e-300) and correlation[j, j] > 0.0:
            kept.append(j)
            left = left - np.outer(left[:, j], left[j]) / left[j, j]
    return np.array(kept, dtype=np.int64)


def _mean(A: Array, g: Array, variance: Array, prior: Array) -> tuple[Array, Array]:
    """b̄ by generalised least squares with its prior variance, and its covariance."""
    inner = np.eye(A.shape[1]) + A * variance
    solved = np.linalg.solve(inner, np.concatenate([g[:, :, None], A], axis=2))
    H = np.sum(solved[:, :, 1:], axis=0)
    root = np.sqrt(prior)
    middle = np.linalg.inv(np.eye(len(root)) + root[:, None] * (0.5 * (H + H.T)) * root)
    covariance = root[:, None] * middle * root
    return covariance @ np.sum(solved[:, :, 0], axis=0), covariance


def joint_values(judged: Judged, sizes: Sequence[int]) -> tuple[Array, Array]:
    """Several sizes told at once (each while the others may differ too), and their standard deviations, in their units."""
    at = np.array(sizes, dtype=np.int64)
    if not len(at):
        return np.zeros(0), np.zeros(0)
    own = judged.information[np.ix_(at, at)]
    d = np.sqrt(np.maximum(np.diag(own), 1e-300))
    inverse = np.linalg.pinv(own / d[:, None] / d, rcond=1e-9, hermitian=True) / d[:, None] / d
    return inverse @ judged.score[at] * judged.scale[at], np.sqrt(np.maximum(np.diag(inverse), 0.0)) * judged.scale[at]
