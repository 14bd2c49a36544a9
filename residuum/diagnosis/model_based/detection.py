r"""Whether a window differs from healthy ones: a test for each size and each output's energy, at one false-alarm rate for all.

A hypothesis' statistic T = uᵀ I⁻¹ u (k sizes) is compared with F and t laws of the degrees of freedom that its scatter between
healthy windows rests on, and told as the normal deviation of the same rarity, so that all are on one scale. Each hypothesis'
variance is raised by what windows left out of the training showed of it (never lowered). The limit is that of a chosen number of
false alarms a day, shared by all hypotheses (Bonferroni), and raised where the left-out windows stood higher than it promises.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from residuum.diagnosis.model_based.healthy_scatter import HealthyScatter, Judged, healthy_scatter
from residuum.diagnosis.model_based.window_statistics import WindowStatistics
from residuum.diagnosis.thresholds.false_alarm_rate import SECONDS_A_DAY
from residuum.diagnosis.thresholds.upper_tail import UpperTail

Array = npt.NDArray[np.float64]

_LEFT_OUT_ROUNDS = 12
_HIGHEST = 3
"""Left-out windows that the limit is held against."""
_LEAST_PER_WINDOW, _MOST_PER_WINDOW = 1e-12, 0.1
_RAREST = 1e-300


@dataclass(frozen=True)
class Group:
    """Which sizes (positions) one hypothesis has."""

    sizes: tuple[int, ...]


def groups_of(counts: Sequence[int]) -> list[Group]:
    """Groups of so many sizes each, one after the other."""
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(int)
    return [Group(tuple(range(a, b))) for a, b in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True)]


def deviations(judged: Judged, groups: Sequence[Group], inflation: Array) -> Array:
    """Each hypothesis' rarity as a normal deviation, shape (hypotheses,); 0 where the window does not show it."""
    freedom = judged.freedom
    return np.array([_deviation(judged, list(g.sizes), freedom, f) for g, f in zip(groups, inflation, strict=True)])


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


def _deviation(judged: Judged, sizes: list[int], freedom: Array, inflation: float) -> float:
    if not np.min(np.diag(judged.information)[sizes]) > 1e-9:
        return 0.0
    k, T = len(sizes), chi_square(judged, sizes) / inflation
    log_p = float(stats.f.logsf(T / k, k, float(np.min(freedom[sizes]))))
    return _normal(log_p) if np.isfinite(log_p) else float(np.sqrt(T))


def _normal(log_p: float) -> float:
    """The deviation that a normal variable exceeds in size with this probability (its logarithm)."""
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


@dataclass(frozen=True, eq=False)
class Calibration:
    """Factors on each hypothesis' variance, tests that count as independent, by what the limit is raised, and left-out windows.

    `left_out` are the largest deviations of healthy windows, each judged by the others: the limit is no lower than their tail's.
    """

    inflation: Array
    tests: int
    raised: float
    left_out: Array

    def limit(self, false_alarms_per_day: float, seconds: float) -> float:
        """Deviation that a healthy window of this length passes at the chosen rate."""
        rate = float(np.clip(false_alarms_per_day * seconds / SECONDS_A_DAY, _LEAST_PER_WINDOW, _MOST_PER_WINDOW))
        promised = self.raised * _normal(np.log(rate / self.tests))
        return max(promised, float(UpperTail.of(self.left_out).limit(rate))) if len(self.left_out) > 2 else promised


def calibrated(
    windows: Sequence[WindowStatistics], scatter: HealthyScatter, groups: Sequence[Group], energies: Energies
) -> Calibration:
    """What each window shows that is judged by the others."""
    flat = np.ones(len(groups))
    left_out = []
    for k, window in enumerate(windows):
        others = [*windows[:k], *windows[k + 1 :]]
        left_out.append((healthy_scatter(others, _LEFT_OUT_ROUNDS, scatter).judged(window), Energies.of(others), window))
    T = np.array([[chi_square(j, g.sizes) / len(g.sizes) for g in groups] for j, _, _ in left_out])
    inflation = np.maximum(np.mean(T, axis=0), 1.0) if len(T) else flat
    usual = np.array([stats.chi2.isf(0.5 / len(windows), len(g.sizes)) / len(g.sizes) for g in groups])
    tests = len(scatter.own) + int(np.count_nonzero(energies.mean))
    highest = [float(max(np.max(deviations(j, groups, inflation)), np.max(e.deviations(w)))) for j, e, w in left_out]
    promised = [_normal(np.log(min((k + 0.5) / len(windows), 0.5) / tests)) for k in range(_HIGHEST)]
    stood = np.sort(highest)[::-1][:_HIGHEST]
    raised = float(np.mean(stood / np.array(promised[: len(stood)])))
    inflation = np.maximum(inflation, np.max(T, axis=0) / usual)  # few windows of many may be those that differ
    return Calibration(inflation, tests, max(raised, 1.0), np.array(highest))


def rate_alone(windows: int, seconds: float) -> float:
    """False alarms a day that so many healthy windows vouch for without any law: one in (windows + 1)."""
    return SECONDS_A_DAY / seconds / (windows + 1)
