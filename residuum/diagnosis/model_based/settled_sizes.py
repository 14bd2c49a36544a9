"""A told size once more, where it is: with the slopes of everything that scatters along the track that the fault makes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import stats

from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.hypotheses import Hypothesis, slopes_of
from residuum.diagnosis.model_based.sizes import Window, can_be_moved, inside, per_unit, supposed
from residuum.diagnosis.model_based.window_statistics import whitened
from residuum.identification.physics.estimation.least_squares import solve_scaled

Array = npt.NDArray[np.float64]


def settled(baseline: Baseline, window: Window, h: Hypothesis, value: Array, onset: int) -> tuple[Array, Array] | None:
    """The size after one more step and its standard deviation, each of shape (columns,); None where the filter cannot follow,
    or sees nothing of it.

    From its onset on the window is followed as if the hypothesis were so. Its doubt holds the noise and how values scatter when
    healthy, times how much more or less than these left-out healthy windows showed of this size; and what the model may lack
    (`left_open`). Few windows showed it, so 1.96 of it span the band of the t law of their degrees of freedom.
    """
    along = _along(baseline, window, h, value, onset)
    if along is None:
        return None
    J, rows, at = along
    scatter, open_, conditions = baseline.scatter, baseline.left_open, window.sums.conditions
    own = J[:, scatter.own] * scatter.scale[scatter.own]
    S, A = scatter.covariance(conditions), own.T @ own
    weights = np.linalg.solve(np.eye(len(S)) + S @ A, S)
    C = J[:, at] / per_unit(h, float(value[0]))
    through = (C.T @ own) @ weights
    about = rows - own @ window.mean[scatter.own]
    information, score = C.T @ C - through @ (own.T @ C), C.T @ about - through @ (own.T @ about)
    if not np.all(np.diag(information) > 0.0):  # nothing of a size is seen along this track
        return None
    scale = 1.0 / np.sqrt(np.diag(information))
    scaled = 0.5 * (information + information.T) * np.outer(scale, scale)
    covariance = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) * np.outer(scale, scale)
    step = solve_scaled(information, score[:, None], 1e-9)[:, 0]
    E = J[:, open_.sizes] * scatter.scale[open_.sizes] - own @ (scatter.design(conditions) @ open_.absorbed)
    astray = np.abs(covariance @ (C.T @ E - through @ (own.T @ E))) * open_.size
    k = list(baseline.hypotheses).index(h)
    shown = float(baseline.calibration.inflation[k])
    variance = np.maximum(np.diag(covariance), 0.0) * shown + np.sum(astray**2, axis=1)
    wider = stats.t.ppf(0.975, baseline.calibration.freedom[k]) / stats.norm.ppf(0.975)
    return inside(window, h, value + step), np.sqrt(variance) * wider


def _along(baseline: Baseline, window: Window, h: Hypothesis, value: Array, onset: int) -> tuple[Array, Array, list[int]] | None:
    """Whitened slopes by every size and whitened rows along the track with the hypothesis, and the places of its sizes.

    What cannot be moved, and what acts linearly, stays to first order: its rows are those without it, less its own part.
    """
    tracking = baseline.tracking
    at = list(baseline.groups[list(baseline.hypotheses).index(h)].sizes)
    if not can_be_moved(h) and not onset:
        return window.white, window.rows - window.white[:, at] @ value, at
    e = window.filtered.experiment
    moved, values = supposed(tracking, window, h, float(value[0])) if can_be_moved(h) else (e, window.values)
    filtered = tracking.run(moved.window(onset, e.n), values)
    if not filtered.follows:
        return None
    signals = baseline.signals.of(filtered, tracking.states(filtered))
    J = whitened(filtered, slopes_of(filtered, tracking, baseline.hypotheses, signals), baseline.colours)
    rows = whitened(filtered, filtered.normalised, baseline.colours)
    return J, rows if can_be_moved(h) else rows - J[:, at] @ value, at
