"""Does the input answer the output's noise, as a controller's does?

u(t) = Σ_{i=1}^{30} f_i u(t − i) + Σ_{l} h_l e(t − l) + v(t),   e the innovations of the output

In an open loop all h_l are zero: the F-test of them is exact, whatever moves the input. Lag 0 counts where the plant has at least
one sample of delay; a plant that answers within the sample looks the same there, so that a delay of 0 leaves it out.
Caines, Chan, IEEE Trans. Automatic Control 20 (1975) 498–508.

Fails to see a loop whose noise is small beside what its set point moves, which then does little harm either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from residuum.identification.linear_models.plant_tests.long_autoregression import LongAutoregression, complete_rows, ridged

FloatArray = npt.NDArray[np.float64]
_INPUT_PAST, _NOISE_PAST = 30, 10
_LEVEL, _LEAST_SHARE = 1e-4, 0.003
_FEWEST_A_COLUMN = 3


@dataclass(frozen=True)
class FeedbackTest:
    """p-value of the F-test, and the part of the input's news that the output's noise explains."""

    p_value: float
    share: float

    @property
    def present(self) -> bool:
        """Whether the input answers the noise: p below 10⁻⁴, and .3 % of its news or more."""
        return self.p_value < _LEVEL and self.share > _LEAST_SHARE


def feedback_test(found: LongAutoregression) -> FeedbackTest | None:
    """The test on a long autoregression; None where noise or rows are too few to tell.

    >>> from residuum.identification.linear_models.plant_tests.long_autoregression import long_autoregression
    >>> from residuum.identification.record import Record
    >>> rng, y, u = np.random.default_rng(0), np.zeros(1000), np.zeros(1000)
    >>> e, r = rng.standard_normal((2, 1000))
    >>> for t in range(1, 1000):
    ...     y[t] = 0.7 * y[t - 1] + u[t - 1] + e[t]
    ...     u[t] = 0.3 * (r[t] - y[t])
    >>> feedback_test(long_autoregression([Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0)], "u", "y")).present
    True
    """
    if not found.resolved:
        return None
    pairs = [_rows(u, e, found.first_lag) for u, e in zip(found.inputs, found.innovations, strict=True)]
    X, t = np.vstack([pair[0] for pair in pairs]), np.concatenate([pair[1] for pair in pairs])
    noises = X.shape[1] - _INPUT_PAST
    if len(t) < _FEWEST_A_COLUMN * X.shape[1]:
        return None
    without, with_noise = _left(X[:, :_INPUT_PAST], t), _left(X, t)
    if not without > 1e-10 * float(t @ t):
        return None  # an input that its own past tells exactly has no news to answer with
    freedom = len(t) - X.shape[1]
    statistic = (without - with_noise) / noises / max(with_noise / freedom, np.finfo(float).tiny)
    return FeedbackTest(float(stats.f.sf(statistic, noises, freedom)), 1.0 - with_noise / without)


def _rows(u: FloatArray, e: FloatArray, first_lag: int) -> tuple[FloatArray, FloatArray]:
    """Past inputs and innovations, and the input, of one record; lag 0 of the noise where `first_lag` is 1."""
    columns = _INPUT_PAST + _NOISE_PAST - (1 - first_lag)
    if len(u) <= _INPUT_PAST + 1:
        return np.zeros((0, columns)), np.zeros(0)
    past = np.lib.stride_tricks.sliding_window_view(u, _INPUT_PAST + 1)[:, ::-1]
    noise = np.lib.stride_tricks.sliding_window_view(e, _INPUT_PAST + 1)[:, ::-1]
    X, t, _ = complete_rows(np.hstack([past[:, 1:], noise[:, 1 - first_lag : _NOISE_PAST]]), past[:, 0])
    return X, t


def _left(X: FloatArray, t: FloatArray) -> float:
    """Sum of squares that the regression leaves."""
    left = t - X @ np.linalg.solve(ridged(X.T @ X), X.T @ t)
    return float(left @ left)
