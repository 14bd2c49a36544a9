"""Input delay: which lag the response begins at, by the marginal likelihood of each candidate.

Of a gentle beginning, or one that a single step or pulse hardly tells, the likelihood is flat over
several candidates. A delay too long leaves out lags that answer, and what lies there is pressed
into those behind them, with a narrow band; one too short leaves lags more to estimate. So the
shortest is taken that the data do not speak against.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.blas_threads import one_thread_if_small
from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.impulse_response import (
    check_settings,
    maximise,
    scaled_sums,
)
from residuum.identification.kernel_based.kernels import KERNELS
from residuum.identification.kernel_based.lagged_data import lagged_data
from residuum.identification.kernel_based.marginal_likelihood import marginal_likelihood
from residuum.identification.record import Record

_ABOUT_AS_LIKELY = 2.0  # [nat]: one seventh of the probability


@dataclass(frozen=True, eq=False)
class DelayEstimate:
    """The shortest delay [samples] that is about as likely as the most likely one, and for every
    candidate 0 … longest its −log p and probability.
    """

    delay: int
    negative_log_likelihood: npt.NDArray[np.float64]

    @property
    def probability(self) -> npt.NDArray[np.float64]:
        """Posterior probability of each candidate, all being equally likely beforehand, shape
        (longest + 1,).
        """
        likelihood = np.exp(self.negative_log_likelihood.min() - self.negative_log_likelihood)
        return np.asarray(likelihood / likelihood.sum())


def estimate_delay(
    records: Record | Sequence[Record],
    input: str,
    output: str,
    *,
    kernel: str = "tc",
    order: int = 50,
    longest: int = 20,
    offset: bool = True,
) -> DelayEstimate:
    """The lag of the first impulse-response coefficient, among 0 … `longest` samples.

    Every candidate explains the same output samples with `order` coefficients from its lag on, and
    is judged by its largest marginal likelihood: a prior that decays from its first coefficient is
    penalised for zeros there. The regression sums are computed once, for all lags.

    Raises what `identify_impulse_response` raises.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(300)
    >>> y = np.convolve(u, [0, 0, 0, 0, 1.0, 0.7, 0.5])[:300] + 0.1 * rng.standard_normal(300)
    >>> estimate_delay(Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0), "u", "y", order=20, longest=8).delay
    4
    """
    check_settings(kernel, order, 0, "marginal")
    if longest < 0:
        raise BadInput(f"longest delay {longest}: must be a number of samples ≥ 0")
    sums = lagged_data(records, [input], output, order + longest, 0, offset=offset).sums
    values, start = [], None
    with one_thread_if_small(order):
        for delay in range(longest + 1):
            candidate = scaled_sums(sums.columns(np.arange(delay, delay + order)), 1)[0]
            # from where the search for the delay before it ended: neighbours have a like optimum
            start, value = maximise(marginal_likelihood(candidate, KERNELS[kernel]), start)
            values.append(value)
    # the first of those that are about as likely as the best
    about = np.array(values) <= min(values) + _ABOUT_AS_LIKELY
    return DelayEstimate(int(np.argmax(about)), np.array(values))
