"""Whether a window is healthy, at one rate of false alarms: its values by Hotelling's T² and each by itself, its error power, and
offsets of its readings.

References
----------
H. Hotelling, Ann. Math. Stat. 2 (1931) 360; C. R. Rao, *Linear Statistical Inference*, 2nd ed. 1973, 8c (one direction of T²).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.window_fit import Fit, information

Array = npt.NDArray[np.float64]
_TESTS = 4


@dataclass(frozen=True, eq=False)
class Detected:
    """`p` that a healthy window of such a run looks like this; of its values the mean (values,) and covariance there.

    `surprise` is how far error power lies above the usual (2 · outputs,) [standard deviations].
    """

    p: float
    mean: Array
    covariance: Array
    surprise: Array


def detected(baseline: Baseline, fit: Fit, offsets: tuple[Array, Array], features: Array) -> Detected:
    """Hold the window's own estimate, its error and its offsets (with the information on them) against healthy ones;
    Bonferroni's bound over the tests.
    """
    mean, covariance = baseline.values.at(features)
    z, freedom = baseline.surprise(features, fit), baseline.values.freedom
    each = [len(z) * float(stats.t.sf(z, baseline.errors.freedom).min(initial=1.0))]
    usual, scatter = baseline.offsets.at(features)
    t = np.abs(offsets[0] - usual) / np.sqrt(np.diag(scatter) + 1.0 / np.maximum(offsets[1], 1e-300))
    each.append(2.0 * len(t) * float(stats.t.sf(t, baseline.offsets.freedom).min(initial=1.0)))
    if k := len(mean):
        d, H = fit.others - mean, information(fit, k)
        T = H - H @ np.linalg.solve(H + np.linalg.inv(covariance), H)  # (S + H⁻¹)⁻¹, where H may be singular
        t2 = max(float(d @ T @ d), 0.0)
        m = max(freedom - k + 1.0, 1.0)
        one = (T @ d) ** 2 / np.maximum(np.diag(T), 1e-300)  # what one value alone explains of it
        each.append(float(stats.f.sf(t2 * m / (k * freedom), k, m)))
        each.append(k * float(stats.f.sf(one * m / np.maximum(freedom + t2 - one, 1e-12), 1, m).min()))
    return Detected(min(1.0, _TESTS * min(each)), mean, covariance, z)
