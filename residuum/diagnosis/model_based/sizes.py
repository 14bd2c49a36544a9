"""How much: the size of a cause with its doubt, re-estimated where it is, and when it began."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.filtered_window import Filtered, TrackingFilter
from residuum.diagnosis.model_based.healthy_scatter import Judged, joint_values
from residuum.diagnosis.model_based.hypotheses import Hypothesis, slopes_of
from residuum.diagnosis.model_based.window_statistics import WindowStatistics, whitened
from residuum.identification.physics import Experiment
from residuum.identification.physics.estimation.least_squares import solve_scaled

Array = npt.NDArray[np.float64]

STEPS = 3
_PARTS = 12
"""Beginnings that are tried: the window's parts."""
_WORTH = 3.0
"""Log-likelihood beyond the logarithm of the parts' number that a later beginning must bring."""
_LEAST_GAIN = -0.95
_FARTHEST = 0.95
"""Share of a value that may be lost at most."""


@dataclass(frozen=True, eq=False)
class Window:
    """A window in the baseline's terms: track, signals, whitened rows and slopes, sums, and what they say.

    It is followed with the model's `values`; `mean` are the usual sizes about those, in the scatter's units.
    """

    filtered: Filtered
    signals: Array
    rows: Array
    white: Array
    sums: WindowStatistics
    judged: Judged
    weights: Array
    mean: Array
    values: Mapping[str, float]

    def likelihood(self, rows: Array, scale: Array) -> float:
        """Log-likelihood of whitened rows under Σ = 1 + J S Jᵀ (constants left out); scale is the scatter's."""
        mean = self.mean
        g = (self.white.T @ rows) * scale - (self.sums.A * scale[:, None] * scale) @ mean
        about = rows - self.white @ (scale * mean)
        return float(-0.5 * (about @ about - g @ self.weights @ g))


@dataclass(frozen=True, eq=False)
class Sized:
    """A hypothesis' size in a window: value and standard deviation of each column, onset sample, and the likelihood's rise."""

    value: Array
    std: Array
    onset: int
    gain: float


def refined(baseline: Baseline, window: Window, h: Hypothesis, sizes: tuple[int, ...], *, steps: int = STEPS) -> Sized:
    """The size with which the hypothesis makes the window likeliest: first to first order, then re-estimated at each new size.

    The filter runs anew with the value, the corrected reading or the corrected input; effects of the catalogue alone, whose
    sizes act linearly, and shifts in time are taken to first order.
    """
    scatter, at = baseline.scatter, list(sizes)
    value, std = joint_values(window.judged, at)
    start = window.likelihood(window.rows, scatter.scale)
    gain = 0.5 * float(value / window.judged.scale[at] @ window.judged.score[at])
    if not can_be_moved(h):
        return Sized(value, std, 0, gain)
    found, moved, height = Sized(value, std, 0, gain), np.zeros(len(at)), 0.0
    for _ in range(steps):
        step = _risen(baseline, window, h, moved, value, start + height)
        if step is None:
            break
        moved, rows, C, height = step.moved, step.rows, step.slopes, step.likelihood - start
        information, score = _beside(window, baseline, C, rows)
        value = solve_scaled(information, score[:, None])[:, 0]
        std = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        if np.all(np.abs(value) < 3.0 * std):  # near enough for the rest to be linear
            return Sized(inside(window, h, moved + value), std, 0, height + 0.5 * float(value @ score))
        found = Sized(moved, std, 0, height)
    return found


@dataclass(frozen=True, eq=False)
class _Step:
    """A size that was reached, the whitened rows and slopes there, and their likelihood."""

    moved: Array
    rows: Array
    slopes: Array
    likelihood: float


def _risen(baseline: Baseline, window: Window, h: Hypothesis, moved: Array, step: Array, least: float) -> _Step | None:
    """The step, or a part of it, with which the window becomes likelier than `least`; None where none does."""
    for part in (1.0, 0.4, 0.1):
        target = inside(window, h, moved + part * step)
        there = moved_window(baseline, window, h, target)
        if there is None:
            continue
        filtered, C = there
        rows = whitened(filtered, filtered.normalised, baseline.colours)
        likelihood = window.likelihood(rows, baseline.scatter.scale) - _determinant(filtered, window.filtered)
        likelihood -= _stretched(baseline, window, h, float(target[0]))
        if likelihood > least:
            return _Step(target, rows, C, likelihood)
    return None


def _determinant(there: Filtered, here: Filtered) -> float:
    used = np.isfinite(here.e) & np.isfinite(there.e)
    return 0.5 * float(np.sum(np.log(there.V[used] / here.V[used])))


def _stretched(baseline: Baseline, window: Window, h: Hypothesis, value: float) -> float:
    """Logarithm of how much wider a gain spreads its sensor's readings: shrunk ones have small innovations of any cause."""
    if h.kind != "sensor" or h.columns[0].signal != "reading":
        return 0.0
    output = list(baseline.tracking.model.outputs).index(h.place)
    return float(window.sums.count[output]) * float(np.log1p(value))


def can_be_moved(h: Hypothesis) -> bool:
    """Whether a window can be followed as if the hypothesis were so."""
    return not h.shape and h.kind != "disturbance" and h.columns[0].signal in ("one", "reading", "input")


def inside(window: Window, h: Hypothesis, value: Array) -> Array:
    """Within the bounds of a parameter; a gain that is not lost altogether."""
    column = h.columns[0]
    if column.acts_on.startswith("parameter:"):
        now = window.values[column.acts_on.removeprefix("parameter:")]
        far = _FARTHEST * abs(now) if now else np.inf  # a step too long would leave what the filter can follow
        return np.clip(value, max(column.lower - now, -far), min(column.upper - now, far / (1.0 - _FARTHEST)))
    if column.signal in ("reading", "input"):
        return np.maximum(value, _LEAST_GAIN)
    return value


def per_unit(h: Hypothesis, value: float) -> float:
    """What a gain has become: signals along the moved track are so many times those that a unit of it acts on."""
    return 1.0 + value if h.kind in ("sensor", "actuator") and h.columns[0].signal in ("reading", "input") else 1.0


def moved_window(baseline: Baseline, window: Window, h: Hypothesis, value: Array) -> tuple[Filtered, Array] | None:
    """The window followed as if the hypothesis were so, and the slopes (whitened, laid end to end) by its size there."""
    tracking, experiment = baseline.tracking, window.filtered.experiment
    e, values = supposed(tracking, window, h, float(value[0]))
    filtered = tracking.run(e, values)
    if not filtered.follows:
        return None
    signal = np.ones((e.n, 1))
    if h.columns[0].signal == "reading":
        signal = filtered.predicted[:, [list(tracking.model.outputs).index(h.place)]]
        signal = np.nan_to_num(signal) / per_unit(h, float(value[0]))
    elif h.columns[0].signal == "input":
        signal = experiment.U[:, [list(tracking.model.inputs).index(h.place)]]
    J = slopes_of(filtered, tracking, [h], np.ascontiguousarray(signal))
    return filtered, whitened(filtered, J, baseline.colours)


def supposed(tracking: TrackingFilter, window: Window, h: Hypothesis, value: float) -> tuple[Experiment, Mapping[str, float]]:
    """The window with the reading or the input corrected, and the values of the model to follow it with."""
    column, e = h.columns[0], window.filtered.experiment
    if column.acts_on.startswith("parameter:"):
        name = column.acts_on.removeprefix("parameter:")
        return e, {**window.values, name: window.values[name] + value}
    if h.kind == "sensor":
        Y, o = e.Y.copy(), list(tracking.model.outputs).index(h.place)
        Y[:, o] = Y[:, o] - value if column.signal == "one" else Y[:, o] / (1.0 + value)
        return replace(e, Y=Y), window.values
    if h.kind == "actuator":
        U, i = e.U.copy(), list(tracking.model.inputs).index(h.place)
        U[:, i] = U[:, i] + value if column.signal == "one" else U[:, i] * (1.0 + value)
        return replace(e, U=U), window.values
    return e, window.values


def _beside(window: Window, baseline: Baseline, C: Array, rows: Array) -> tuple[Array, Array]:
    """Information and score of columns C, shape (rows, k), on whitened rows, weighted by what is usual."""
    scale, mean = baseline.scatter.scale, window.mean
    J0 = window.white
    about = rows - J0 @ (scale * mean)
    cross, g = (C.T @ J0) * scale, (J0.T @ about) * scale
    through = cross @ window.weights
    return C.T @ C - through @ cross.T, C.T @ about - through @ g


def with_onset(baseline: Baseline, window: Window, h: Hypothesis, sized: Sized) -> Sized:
    """The size with the beginning that makes the window likeliest; from its start unless a later one is clearly better."""
    e = window.filtered.experiment
    signals = _own_signals(baseline, window, h)
    edges = np.linspace(0, e.n, _PARTS + 1).astype(int)
    k = len(h.columns)
    masked = np.zeros((e.n, k * _PARTS))
    for part in range(_PARTS):
        masked[edges[part] :, part * k : (part + 1) * k] = signals[edges[part] :]
    alone = [Hypothesis(h.kind, h.name, h.place, h.columns, h.shape)] * _PARTS
    C = whitened(window.filtered, slopes_of(window.filtered, baseline.tracking, alone, masked), baseline.colours)
    information, score = _beside(window, baseline, C, window.rows)
    gains, found = [], []
    for part in range(_PARTS):
        at = slice(part * k, (part + 1) * k)
        own, u = information[at, at], score[at]
        value = solve_scaled(own, u[:, None], 1e-9)[:, 0]
        gains.append(0.5 * float(value @ u))
        found.append((value, np.sqrt(np.maximum(np.diag(np.linalg.pinv(own)), 0.0))))
    best = int(np.argmax(gains))
    rise = gains[best] - max(gains[0], sized.gain)
    if best == 0 or rise < _WORTH + np.log(_PARTS):
        return sized
    value, std = found[best]
    return Sized(value, std, int(edges[best]), gains[best] - float(np.log(_PARTS)))


def _own_signals(baseline: Baseline, window: Window, h: Hypothesis) -> Array:
    """The hypothesis' signals along the window, shape (n, columns)."""
    group = baseline.groups[list(baseline.hypotheses).index(h)]
    return window.signals[:, list(group.sizes)]
