r"""How a healthy machine's sizes scatter from window to window, as the sums of healthy windows show it.

Each window w has sizes b_w = B x_w + δ_w, δ_w ~ N(0, D) with D diagonal, and the innovations r_w = J_w b_w + noise of variance
one. x_w is what was recorded beside (a temperature, the mean of an input), in standard deviations of the healthy windows, after a
one; B has its first column, and of the others those places alone that healthy windows ask for. So its sums g_w = J_wᵀ r_w have
the mean A_w B x_w and the covariance A_w + A_w D A_w. What the model leaves over when the machine is healthy is so described in
the sizes
of everything that may be missing or may change: it raises the limit of what resembles it, in windows whose operation shows it,
and of nothing else. B and D are estimated by expectation and maximisation.

Reference: N. M. Laird, J. H. Ware, Biometrics 38 (1982) 963.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import stats

from residuum.diagnosis.model_based.window_statistics import WindowStatistics

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

ROUNDS = 100
_FIRST = 0.1
"""Variance that every size begins with at least, in units of what one healthy window tells of it alone."""
_WIDE = 1e8
"""Variance of a coefficient before any window was seen, in these units."""
_RIDGE = 1e-4
_OWN = 1e-3
"""Share of its information that a size must have beyond the sizes before it, to scatter by itself."""
_MOVES = 1e-3
"""Probability, over all that was tried, at which a size is taken to move with what was recorded."""
_MOST_JOINED = 12
_SPARE = 8
"""Windows beyond the conditions that are asked for, before any is."""


@dataclass(frozen=True, eq=False)
class HealthyScatter:
    """Mean and scatter of the sizes over healthy windows, in units of `scale`.

    Attributes
    ----------
    scale : array, shape (m,)
        Standard deviation with which a healthy window alone tells each size.
    own : array of int, shape (k,)
        Sizes that scatter by themselves; all others resemble those.
    moving : array of int, shape (p, 2)
        Coefficients: which own size (its position in `own`) moves with which condition; 0 is the constant.
    coefficients : array, shape (p,)
    doubt : array, shape (p, p)
        Their covariance.
    variance : array, shape (k,)
        D of one further window.
    windows : int
    """

    scale: Array
    own: Integers
    moving: Integers
    coefficients: Array
    doubt: Array
    variance: Array
    windows: int

    def design(self, conditions: Array) -> Array:
        """Z, shape (k, p), with which the coefficients make a window's usual sizes; `conditions` without the constant."""
        x = np.concatenate([[1.0], conditions])
        Z = np.zeros((len(self.own), len(self.moving)))
        Z[self.moving[:, 0], np.arange(len(self.moving))] = x[self.moving[:, 1]]
        return Z

    def mean(self, conditions: Array) -> Array:
        """Usual sizes under these conditions, shape (m,)."""
        full = np.zeros(len(self.scale))
        full[self.own] = self.design(conditions) @ self.coefficients
        return full

    def covariance(self, conditions: Array) -> Array:
        """Of the own sizes of one further window about `mean`, shape (k, k): D, and the doubt of B."""
        Z = self.design(conditions)
        return np.diag(self.variance) + Z @ self.doubt @ Z.T

    def judged(self, statistics: WindowStatistics, mean: Array | None = None) -> Judged:
        """A window's sums in these units, about the healthy mean (or another), weighted by what is usual when healthy."""
        scaled = statistics.scaled(self.scale).about(self.mean(statistics.conditions) if mean is None else mean)
        weights = self.weights(statistics)
        left = weights @ np.column_stack([scaled.A, scaled.g])
        m = len(self.scale)
        information = scaled.A - scaled.A @ left[:, :m]
        score = scaled.g - scaled.A @ left[:, m]
        return Judged(score, 0.5 * (information + information.T), self.scale)

    def weights(self, statistics: WindowStatistics) -> Array:
        """S (1 + A S)⁻¹ in these units, S the covariance: what a projection on J becomes on its way through Σ⁻¹."""
        at = self.own
        A = statistics.A[np.ix_(at, at)] * self.scale[at][:, None] * self.scale[at]
        S = self.covariance(statistics.conditions)
        weights = np.zeros((len(self.scale), len(self.scale)))
        inner = np.linalg.solve(np.eye(len(at)) + S @ A, S)
        weights[np.ix_(at, at)] = 0.5 * (inner + inner.T)
        return weights


@dataclass(frozen=True, eq=False)
class Judged:
    """Score and information of every size in a window, both weighted by Σ⁻¹, Σ = 1 + J S Jᵀ.

    `score` u = Jᵀ Σ⁻¹ (r − J b̄), `information` I = Jᵀ Σ⁻¹ J.
    """

    score: Array
    information: Array
    scale: Array


def healthy_scatter(windows: Sequence[WindowStatistics], values: Sequence[int], rounds: int = ROUNDS) -> HealthyScatter:
    """Mean and scatter of sizes over healthy windows, and with which conditions they move.

    The model's own `values` (positions) scatter; what they do not account for joins them one by one, conditions before further
    sizes,
    as long as windows stand further from the healthy than chance allows. Two sizes that do the same are so never set against
    each other.
    """
    scale = unit_of_each(windows)
    own = own_sizes(np.mean([w.scaled(scale).A for w in windows], axis=0), values)
    k, n = len(own), len(windows)
    moving = np.column_stack([np.arange(k), np.zeros(k, dtype=np.int64)]).astype(np.int64)
    first = np.maximum(np.var(each_alone([w.scaled(scale) for w in windows], own), axis=0), _FIRST) if k else np.zeros(0)
    found = scattered(windows, HealthyScatter(scale, own, moving, np.zeros(k), _WIDE * np.eye(k), first, n), rounds)
    for _ in range(min(_MOST_JOINED, n - _SPARE)):
        wider = _moved(windows, found) or _joined(windows, found)
        if wider is None:
            break
        found = scattered(windows, wider, rounds)
    return found


def each_alone(windows: Sequence[WindowStatistics], sizes: Sequence[int] | Integers) -> Array:
    """Sizes as each window by itself tells them, all at once, shape (windows, sizes)."""
    ridge = _RIDGE * np.eye(len(sizes))
    return np.array([np.linalg.solve(w.of(sizes).A + ridge, w.g[list(sizes)]) for w in windows])


def _moved(windows: Sequence[WindowStatistics], found: HealthyScatter) -> HealthyScatter | None:
    """With the coefficient that healthy windows ask for most; None where they ask for none."""
    pair = _most_moving(windows, found, len(windows[0].conditions)) if len(found.own) else None
    return None if pair is None else _with_coefficient(found, pair)


def _with_coefficient(found: HealthyScatter, pair: Integers) -> HealthyScatter:
    p = len(found.moving)
    doubt = _WIDE * np.eye(p + 1)
    doubt[:p, :p] = found.doubt
    return replace(found, moving=np.vstack([found.moving, pair]), coefficients=np.append(found.coefficients, 0.0), doubt=doubt)


def _joined(windows: Sequence[WindowStatistics], found: HealthyScatter) -> HealthyScatter | None:
    """With the size that differs most between windows, or from nothing, beyond what is accounted for; None where none does."""
    n, judged = len(windows), [found.judged(w) for w in windows]
    information = np.array([np.diag(j.information) for j in judged])
    seen = np.all(information > 1e-9, axis=0)
    seen[found.own] = False
    if not seen.any():
        return None
    squares = np.where(seen, np.sum(np.array([j.score for j in judged]) ** 2 / np.maximum(information, 1e-9), axis=0), 0.0)
    size = int(np.argmax(squares))
    if stats.chi2.sf(squares[size], n) * np.count_nonzero(seen) > _MOVES:
        return None
    steps = np.array([j.score[size] / j.information[size, size] for j in judged])
    wider = replace(found, own=np.append(found.own, size), variance=np.append(found.variance, max(float(np.var(steps)), _FIRST)))
    return _with_coefficient(wider, np.array([len(found.own), 0], dtype=np.int64))


def scattered(windows: Sequence[WindowStatistics], start: HealthyScatter, rounds: int) -> HealthyScatter:
    """Coefficients and scatter over healthy windows, by expectation and maximisation from `start`."""
    own, k = start.own, len(start.own)
    scaled = [w.scaled(start.scale) for w in windows]
    A, g = np.array([w.of(own).A for w in scaled]), np.array([w.g[own] for w in scaled])
    Z = np.array([start.design(w.conditions) for w in windows])
    variance, prior = np.maximum(start.variance, 1e-6), np.maximum(start.coefficients**2 + np.diag(start.doubt), 1e-12)
    for _ in range(rounds):
        coefficients, doubt = _coefficients(A, g, Z, variance, prior)
        prior = coefficients**2 + np.diag(doubt)
        deviation, left = _deviations(A, g - np.einsum("wij,wj->wi", A, Z @ coefficients), variance)
        variance = np.mean(deviation**2 + np.maximum(left, 0.0), axis=0)
    coefficients, doubt = _coefficients(A, g, Z, variance, prior)
    n = len(windows)
    used = np.bincount(start.moving[:, 0], minlength=k)
    return replace(start, coefficients=coefficients, doubt=doubt, variance=variance * n / np.maximum(n - used, 1), windows=n)


def _deviations(A: Array, rest: Array, variance: Array) -> tuple[Array, Array]:
    """Posterior mean and variance of each window's δ: D (1 + A D)⁻¹ rest and diag(D − D (1 + A D)⁻¹ A D)."""
    solved = np.linalg.solve(np.eye(A.shape[1]) + A * variance, np.concatenate([rest[:, :, None], A], axis=2))
    return variance * solved[:, :, 0], variance - variance * np.einsum("wii->wi", solved[:, :, 1:]) * variance


def _most_moving(windows: Sequence[WindowStatistics], found: HealthyScatter, conditions: int) -> Integers | None:
    """The own size and the condition that its deviations follow most surely; None where no chance is ruled out."""
    if not conditions:
        return None
    scaled = [w.scaled(found.scale).of(found.own) for w in windows]
    A = np.array([w.A for w in scaled])
    usual = np.array([found.design(w.conditions) @ found.coefficients for w in windows])
    rest = np.array([w.g for w in scaled]) - np.einsum("wij,wj->wi", A, usual)
    deviation, _ = _deviations(A, rest, found.variance)
    X = np.array([w.conditions for w in windows])
    d, x = deviation - deviation.mean(axis=0), X - X.mean(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        r = np.nan_to_num((d.T @ x) / np.sqrt(np.sum(d**2, axis=0)[:, None] * np.sum(x**2, axis=0)))
    for size, condition in found.moving:
        if condition:
            r[size, condition - 1] = 0.0
    size, condition = np.unravel_index(int(np.argmax(np.abs(r))), r.shape)
    freedom = len(windows) - 2
    t = abs(r[size, condition]) * np.sqrt(freedom / max(1.0 - r[size, condition] ** 2, 1e-12))
    sure = 2.0 * stats.t.sf(t, freedom) * r.size < _MOVES
    return np.array([size, condition + 1], dtype=np.int64) if sure else None


def unit_of_each(windows: Sequence[WindowStatistics]) -> Array:
    """Standard deviation with which a usual window alone tells each size; 1 where none does."""
    information = np.mean([np.diag(w.A) for w in windows], axis=0)
    return np.where(information > 0.0, 1.0 / np.sqrt(np.where(information > 0.0, information, 1.0)), 1.0)


def own_sizes(correlation: Array, among: Sequence[int]) -> Integers:
    """Sizes among these whose information is not nearly that of the ones before (a Cholesky factorisation tells)."""
    left = correlation.copy()
    kept = []
    for j in among:
        if left[j, j] > _OWN * max(correlation[j, j], 1e-300) and correlation[j, j] > 0.0:
            kept.append(j)
            left = left - np.outer(left[:, j], left[j]) / left[j, j]
    return np.array(kept, dtype=np.int64)


def _coefficients(A: Array, g: Array, Z: Array, variance: Array, prior: Array) -> tuple[Array, Array]:
    """B's places by generalised least squares with their prior variances, and their covariance."""
    inner = np.eye(A.shape[1]) + A * variance
    solved = np.linalg.solve(inner, np.concatenate([g[:, :, None], A @ Z], axis=2))
    H = np.einsum("wip,wiq->pq", Z, solved[:, :, 1:])
    rhs = np.einsum("wip,wi->p", Z, solved[:, :, 0])
    root = np.sqrt(prior)
    middle = np.linalg.inv(np.eye(len(root)) + root[:, None] * (0.5 * (H + H.T)) * root)
    covariance = root[:, None] * middle * root
    return covariance @ rhs, covariance


def joint_values(judged: Judged, sizes: Sequence[int]) -> tuple[Array, Array]:
    """Several sizes told at once (each while the others may differ too), and their standard deviations, in their units."""
    at = np.array(sizes, dtype=np.int64)
    if not len(at):
        return np.zeros(0), np.zeros(0)
    own = judged.information[np.ix_(at, at)]
    d = np.sqrt(np.maximum(np.diag(own), 1e-300))
    inverse = np.linalg.pinv(own / d[:, None] / d, rcond=1e-9, hermitian=True) / d[:, None] / d
    return inverse @ judged.score[at] * judged.scale[at], np.sqrt(np.maximum(np.diag(inverse), 0.0)) * judged.scale[at]
