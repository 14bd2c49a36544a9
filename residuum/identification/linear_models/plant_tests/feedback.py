"""Does the input answer the output's noise, as a controller's does?

u(t) = Σ_{i=1}^{30} f_i u(t − i) + Σ_{l} h_l e(t − l) + v(t),   e the innovations of the output

In an open loop all h_l are zero: the F-test of them is exact, whatever moves the input. Lag 0 counts where the plant has at least
one sample of delay; a plant that answers within the sample looks the same there, so that a delay of 0 leaves it out.
Caines, Chan, IEEE Trans. Automatic Control 20 (1975) 498–508.

Fails to see a loop whose noise is small beside what its set point moves, which then does little harm either.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
from scipy import stats

from residuum.array_types import FloatArray
from residuum.identification.errors import NotIdentifiable
from residuum.identification.kernel_based.gram import RegressionSums, regression_sums
from residuum.identification.linear_models.plant_tests.long_autoregression import LongAutoregression, factored

_INPUT_PAST, _NOISE_PAST = 30, 10
_LEVEL, _LEAST_SHARE = 1e-4, 0.003
_FEWEST_A_COLUMN = 3
_LEAST_NEWS = 1e-8


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
    sums = reduce(add, [_sums(u, e) for u, e in zip(found.inputs, found.innovations, strict=True)])
    own = np.arange(1, _INPUT_PAST + 1)
    noise = _INPUT_PAST + 1 + np.arange(1 - found.first_lag, _NOISE_PAST)
    columns = np.r_[own, noise]
    if sums.rows < _FEWEST_A_COLUMN * len(columns):
        return None
    _, explained = factored(sums.columns(columns))
    without = sums.energy - float(np.sum(explained[: len(own)] ** 2))
    if not without > _LEAST_NEWS * sums.energy:
        return None  # an input that its own past tells exactly has no news to answer with
    answer = float(np.sum(explained[len(own) :] ** 2))
    freedom = sums.rows - len(columns)
    statistic = answer / len(noise) / max((without - answer) / freedom, np.finfo(float).tiny)
    return FeedbackTest(float(stats.f.sf(statistic, len(noise), freedom)), answer / without)


def _sums(u: FloatArray, e: FloatArray) -> RegressionSums:
    """Of the input on itself and on the innovations, lags 0 … 30 of both, about the means of one record."""
    try:
        return regression_sums([u, e], u, _INPUT_PAST + 1, 0).centred()
    except NotIdentifiable:
        return RegressionSums.zero(2 * (_INPUT_PAST + 1))
