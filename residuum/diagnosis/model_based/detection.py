r"""Whether a window differs from healthy ones: a test for each size and each output's energy, at one false-alarm rate for all.

A hypothesis' statistic T = uᵀ (I + Λ)⁻¹ u (k sizes) is divided by what healthy windows showed of it when each was judged by the
others, s² = Σ T / Σ k_w, where k_w = tr I (I + Λ)⁻¹ ≤ k is what a window shows of it, pooled with all other hypotheses' as far as
these resemble each other (Smyth), and held against the F law of the degrees of freedom that s² then has: of twenty windows only
those count that showed it. Everything is learned anew without the window that is judged: which sizes scatter and what they move
with, too, for what was chosen to suit a window flatters it. Λ is a share of the information of a usual window, as if sizes had
a normal law before the window was seen: a window that hardly shows a size tells it by a few samples, in which the error that the
model keeps is not averaged out.

Windows may be rough or calm as a whole: how much the sums of all sizes scatter beyond chance
gives a second number of degrees. The probability is told as the normal deviation of the same rarity, so that all are on one
scale; the largest of them has the rarity p that the dependence of the sizes in healthy windows gives it (drawn at random), and
not Bonferroni's bound, which forty alike hypotheses would pay for. Were all laws exact, q = −ln p would be exponential of mean
one. It is of a mean that n left-out windows tell, Σq, beside n₀ windows' worth of belief in one, and so a further window passes q
with probability (1 + q/(n₀ + Σq))^−(n₀ + n): the limit carries the doubt of its own estimate, the more the rarer the alarm.

References: G. K. Smyth, Stat. Appl. Genet. Mol. Biol. 3 (2004) 3 (pooled variances); J. Aitchison, I. R. Dunsmore, Statistical
Prediction Analysis, Cambridge 1975, ch. 2 (predictive law of an exponential).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import special, stats

from residuum.diagnosis.model_based.healthy_scatter import HealthyScatter, Judged, healthy_scatter
from residuum.diagnosis.model_based.window_statistics import WindowStatistics
from residuum.diagnosis.thresholds.false_alarm_rate import SECONDS_A_DAY

Array = npt.NDArray[np.float64]

_LEFT_OUT_ROUNDS = 40
_BELIEVED = 20
"""Windows' worth of belief that the laws hold."""
_BEFORE = 0.1
"""Share of a usual window's information in Λ: sizes worth a test are some three of its standard deviations."""
_LEAST_PER_WINDOW, _MOST_PER_WINDOW = 1e-12, 0.5
_RAREST = 1e-300
_DRAWS = 20_000
RATES = np.array([0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002])
"""Probabilities a window at which the number of independent tests is counted; below the last it is taken to stay."""


_USUAL_ROUGHNESS, _USUAL_DOUBT = 0.03, 0.1
"""Variance of the logarithm of windows' levels (some 17 %) that is taken where few windows leave it open, and its doubt."""
_LEAST_ROUGHNESS = 0.01
_LEAST_SEEN = 1e-9


@dataclass(frozen=True)
class Group:
    """Which sizes (positions) one hypothesis has."""

    sizes: tuple[int, ...]


def groups_of(counts: Sequence[int]) -> list[Group]:
    """Groups of so many sizes each, one after the other."""
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(int)
    return [Group(tuple(range(a, b))) for a, b in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True)]


@dataclass(frozen=True, eq=False)
class Calibration:
    """What left-out healthy windows showed of each hypothesis.

    Attributes
    ----------
    before : array, shape (m,)
        Λ, of every size.
    shown : array, shape (m,)
        Largest information of a healthy window on every size.
    inflation : array, shape (hypotheses,)
        s² of each.
    freedom : array, shape (hypotheses,)
        Degrees of freedom of each s², windows' own roughness included.
    tests : array, shape (len(RATES),)
        Independent tests that the largest deviation amounts to, at each of RATES.
    left_out : array, shape (windows,)
        Largest deviation of each healthy window, judged by the others.
    """

    before: Array
    shown: Array
    inflation: Array
    freedom: Array
    tests: Array
    left_out: Array

    def deviations(self, judged: Judged, information: Array, groups: Sequence[Group]) -> Array:
        """Each hypothesis' rarity as a normal deviation, shape (hypotheses,); 0 where the window does not show it.

        `information` is the window's own on every size, before it was weighed by the scatter, shape (m,).
        """
        T = chi_squares(judged, groups, self.before) * (1.0 + _BEFORE) / self.inflation
        k = np.array([len(g.sizes) for g in groups])
        each = np.array([_normal(float(p), t) for p, t in zip(stats.f.logsf(T / k, k, self.freedom), T, strict=True)])
        return each / np.sqrt(novelty(information, self.shown, groups))

    def rarity(self, deviation: Array) -> Array:
        """−ln of the probability that the largest of all deviations of a healthy window passes these, were all laws exact."""
        single = np.log(2.0) + special.log_ndtr(-np.maximum(deviation, 0.0))
        found = -single
        for _ in range(20):  # the number of tests hardly changes with the rate
            tests = np.interp(found, -np.log(RATES), self.tests)
            found = -np.log(-np.expm1(tests * np.log1p(-np.exp(np.minimum(single, -1e-12)))))
        return np.asarray(found)

    @cached_property
    def _left_out_rarity(self) -> float:
        return float(np.sum(self.rarity(self.left_out)))

    def limit(self, false_alarms_per_day: float, seconds: float) -> float:
        """Deviation that a healthy window of this length passes at the chosen rate."""
        rate = float(np.clip(false_alarms_per_day * seconds / SECONDS_A_DAY, _LEAST_PER_WINDOW, _MOST_PER_WINDOW))
        windows, sum_of_rarity = _BELIEVED + len(self.left_out), _BELIEVED + self._left_out_rarity
        exact = float(sum_of_rarity * np.expm1(-np.log(rate) / windows))
        tests = float(np.interp(exact, -np.log(RATES), self.tests))
        return _normal(float(np.log(-np.expm1(np.log1p(-np.exp(-exact)) / tests))))


def novelty(information: Array, shown: Array, groups: Sequence[Group]) -> Array:
    """How much more a window tells of each hypothesis than any healthy one did, shape (hypotheses,), at least 1.

    What no healthy window could show, none has vouched for: its scatter is taken to be as much larger.
    """
    ratio = information / np.maximum(shown, 1e-300)
    return np.array([max(1.0, float(np.max(ratio[list(g.sizes)]))) for g in groups])


def chi_squares(judged: Judged, groups: Sequence[Group], before: Array) -> Array:
    """uᵀ (I + Λ)⁻¹ u of each group, shape (groups,)."""
    judged = replace(judged, information=judged.information + np.diag(before))
    d = np.diag(judged.information)
    single = np.where(d > 1e-9, judged.score**2 / np.maximum(d, 1e-9), 0.0)
    return np.array([single[g.sizes[0]] if len(g.sizes) == 1 else chi_square(judged, g.sizes) for g in groups])


def chi_square(judged: Judged, sizes: Sequence[int]) -> float:
    """uᵀ I⁻¹ u over some sizes; directions that the window does not show count nothing."""
    at = np.array(sizes)
    own, u = judged.information[np.ix_(at, at)], judged.score[at]
    d = np.sqrt(np.maximum(np.diag(own), 0.0))
    if not d.max() > 0.0:
        return 0.0
    d = np.where(d > 0.0, d, 1.0)
    values, vectors = np.linalg.eigh(own / d[:, None] / d)
    seen = values > 1e-6 * values[-1]
    return float(np.sum((vectors[:, seen].T @ (u / d)) ** 2 / values[seen]))


def _normal(log_p: float, square: float = np.inf) -> float:
    """The deviation that a normal variable exceeds in size with this probability (its logarithm); √square where that vanishes."""
    if not np.isfinite(log_p):
        return float(np.sqrt(square))
    return float(-stats.norm.ppf(0.5 * np.exp(log_p))) if log_p > -690.0 else float(np.sqrt(-2.0 * log_p))


@dataclass(frozen=True, eq=False)
class Energies:
    """Logarithm of each output's innovations' mean square over healthy windows: mean and standard deviation, shape (outputs,)."""

    mean: Array
    std: Array
    windows: int

    @classmethod
    def of(cls, windows: Sequence[WindowStatistics]) -> Energies:
        """Of healthy windows."""
        logs = np.array([log_energy(w) for w in windows])
        sampling = np.array([np.sqrt(2.0 / max(float(np.mean(c)), 1.0)) for c in np.array([w.count for w in windows]).T])
        return cls(logs.mean(axis=0), np.maximum(logs.std(axis=0, ddof=1), sampling), len(windows))

    def deviations(self, window: WindowStatistics) -> Array:
        """How rare the energies of a window are, those above the mean alone, as normal deviations."""
        t = (log_energy(window) - self.mean) / (self.std * np.sqrt(1.0 + 1.0 / self.windows))
        logs = stats.t.logsf(np.maximum(t, 0.0), self.windows - 1)
        logs = np.maximum(logs, -1e6)
        return np.array([_normal(float(p)) if x > 0.0 else 0.0 for p, x in zip(logs, t, strict=True)])


def log_energy(window: WindowStatistics) -> Array:
    """Logarithm of each output's mean square whitened innovation; 0 where it was not measured."""
    there = window.count > 0
    return np.where(there, np.log(np.maximum(window.energy, _RAREST) / np.where(there, window.count, 1.0)), 0.0)


def calibrated(
    windows: Sequence[WindowStatistics], scatter: HealthyScatter, values: Sequence[int], groups: Sequence[Group], seed: int = 0
) -> Calibration:
    """What each window shows that is judged by the others; `values` are the sizes that `healthy_scatter` begins with."""
    n, k = len(windows), np.array([len(g.sizes) for g in groups])
    others = [[*windows[:j], *windows[j + 1 :]] for j in range(n)]
    left_out = [healthy_scatter(rest, values, _LEFT_OUT_ROUNDS).judged(w) for rest, w in zip(others, windows, strict=True)]
    usual = [scatter.judged(w) for w in windows]
    before = _BEFORE * np.mean([np.diag(j.information) for j in usual], axis=0)
    information = np.array([np.diag(w.A) for w in windows])
    squares = np.array([chi_squares(j, groups, before) for j in left_out])
    visible = np.array([visibility(j, groups, before) for j in left_out])
    rough = roughness(left_out)
    tests = independent_tests(usual, groups, int(np.count_nonzero(windows[0].count)), seed)

    def of(kept: npt.NDArray[np.int64], largest: Array) -> Calibration:
        seen = np.sum(visible[kept], axis=0)
        inflation, freedom = pooled(np.sum(squares[kept], axis=0) / np.maximum(seen, _LEAST_SEEN), seen / k, len(kept))
        shown, freedom = np.max(information[kept], axis=0), 1.0 / (1.0 / freedom + rough)
        return Calibration(before, shown, inflation * max(1.0 - 2.0 * rough, 0.5), freedom, tests, largest)

    highest = []
    for j, rest in enumerate(others):
        without = of(np.delete(np.arange(n), j), np.zeros(0))
        each = without.deviations(left_out[j], information[j], groups)
        highest.append(max(np.max(each), np.max(Energies.of(rest).deviations(windows[j]))))
    return of(np.arange(n), np.array(highest))


def visibility(judged: Judged, groups: Sequence[Group], before: Array) -> Array:
    """Directions of each group that the window shows, tr I (I + Λ)⁻¹, shape (groups,): what T is if there is noise alone."""
    found = []
    for g in groups:
        at = np.array(g.sizes)
        own, extra = judged.information[np.ix_(at, at)], np.diag(before[at])
        d = np.sqrt(np.maximum(np.diag(own) + before[at], 1e-300))
        found.append(float(np.trace(np.linalg.pinv((own + extra) / d[:, None] / d, rcond=1e-6) @ (own / d[:, None] / d))))
    return np.maximum(np.array(found), 0.0)


def pooled(squares: Array, freedom: Array, most: int) -> tuple[Array, Array]:
    """Mean squares of `freedom` degrees each, drawn to their common value as far as they resemble it, and their degrees then.

    log s² has the variance ψ′(d/2) + ψ′(d₀/2) where the true ones scatter as an inverse χ² of d₀ degrees; hypotheses are not
    independent, so the common value is never trusted beyond the windows themselves (d₀ ≤ `most`). What two windows alone
    have shown has two degrees, however many windows there were.
    """
    told = freedom > 1.0
    if not told.any():
        return np.ones(len(squares)), np.full(len(squares), float(most))
    d = freedom[told]
    weights = d / np.sum(d)
    logs = np.log(np.maximum(squares[told], 1e-12)) - special.digamma(d / 2.0) + np.log(d / 2.0)
    spread = float(weights @ (logs - weights @ logs) ** 2) / max(1.0 - float(weights @ weights), 1e-12)
    beyond = spread - float(weights @ special.polygamma(1, d / 2.0)) if len(d) > 1 else 0.0
    prior = min(2.0 * _inverse_trigamma(beyond), most) if beyond > 0.0 else float(most)
    common = float(np.exp(weights @ logs + special.digamma(prior / 2.0) - np.log(prior / 2.0)))
    return (prior * common + freedom * squares) / (prior + freedom), prior + freedom


def _inverse_trigamma(y: float) -> float:
    """x with ψ′(x) = y, by Newton's steps on 1/ψ′."""
    x = 0.5 + 1.0 / y
    for _ in range(50):
        trigamma = float(special.polygamma(1, x))
        step = trigamma * (1.0 - trigamma / y) / float(special.polygamma(2, x))
        x += step
        if abs(step) < 1e-8 * x:
            break
    return x


def roughness(judged: Sequence[Judged]) -> float:
    """1/ν of the law (inverse χ² of ν degrees) by which windows are rough or calm as a whole.

    Scores along the directions that a usual window shows, each over its own mean square, make a sum of so many degrees in
    every window;
    log sums scatter by ψ′(r/2) if windows are alike, by ψ′(ν/2) beyond; what twenty windows leave open of that is filled by
    what is usual.
    """
    correlation = np.mean([_correlation(j.information) for j in judged], axis=0)
    values, vectors = np.linalg.eigh(correlation)
    seen = values > 0.05 * values[-1]
    z = np.array([j.score / np.sqrt(np.maximum(np.diag(j.information), 1e-300)) for j in judged])
    squares = (z @ vectors[:, seen]) ** 2
    sums = np.sum(squares / np.maximum(np.mean(squares, axis=0), 1e-300), axis=1)
    alike = float(special.polygamma(1, np.count_nonzero(seen) / 2.0))
    beyond, doubt = float(np.var(np.log(sums), ddof=1)) - alike, 2.0 * alike**2 / max(len(judged) - 1, 1)
    weight = _USUAL_DOUBT**2 / (_USUAL_DOUBT**2 + doubt)
    return 0.5 / _inverse_trigamma(max(weight * beyond + (1.0 - weight) * _USUAL_ROUGHNESS, _LEAST_ROUGHNESS))


def independent_tests(windows: Sequence[Judged], groups: Sequence[Group], energies: int, seed: int) -> Array:
    """How many independent tests the largest of all deviations amounts to, at each of RATES."""
    correlation = np.mean([_correlation(w.information) for w in windows], axis=0)
    values, vectors = np.linalg.eigh(correlation)
    rng = np.random.default_rng([seed, 31])
    u = rng.standard_normal((_DRAWS, len(values))) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    largest = np.zeros(_DRAWS)
    for g in groups:
        at = list(g.sizes)
        if len(at) == 1:
            deviation = np.abs(u[:, at[0]])
        else:
            own = np.linalg.pinv(correlation[np.ix_(at, at)], rcond=1e-6, hermitian=True)
            T = np.einsum("ni,ij,nj->n", u[:, at], own, u[:, at])
            deviation = -special.ndtri(0.5 * stats.chi2.sf(T, len(at)))
        largest = np.maximum(largest, deviation)
    above = np.maximum(rng.standard_normal((_DRAWS, energies)), 0.0)
    one_sided = np.where(above > 0.0, -special.ndtri(0.5 * special.ndtr(-above)), 0.0)
    largest = np.maximum(largest, one_sided.max(axis=1, initial=0.0))
    single = special.ndtr(-np.quantile(largest, 1.0 - RATES)) * 2.0
    return np.maximum(np.log1p(-RATES) / np.log1p(-single), 1.0)


def _correlation(information: Array) -> Array:
    d = np.sqrt(np.maximum(np.diag(information), 1e-300))
    return information / d[:, None] / d


def rate_alone(windows: int, seconds: float) -> float:
    """False alarms a day that so many healthy windows vouch for without any law: one in (windows + 1)."""
    return SECONDS_A_DAY / seconds / (windows + 1)
