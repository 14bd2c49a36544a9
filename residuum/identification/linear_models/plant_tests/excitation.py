"""What of a response does one experiment tell? The directions of its input that rise above the output's noise.

y(t) = Σ_{j=f}^{Q} g_j u(t − j) + c + e(t) in signals of unit power. Along an eigenvector of ΦᵀΦ with eigenvalue λ the response is
known to σ/√λ; where that exceeds one, the ratio of the powers of output and input, the record knows less of it than anybody. The
number of the others is the order to which the input excites persistently at this noise: one sine 2, whatever its last digits say.
The static gain is told where its standard deviation stays below one, or it is there by more than chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
from scipy import linalg

from residuum.identification.blas_threads import one_thread_if_small
from residuum.identification.kernel_based.gram import RegressionSums
from residuum.identification.kernel_based.lagged_data import record_sums
from residuum.identification.linear_models.plant_tests.long_autoregression import factored
from residuum.identification.record import Record

_LAGS, _SAMPLES_A_LAG, _FEWEST_LAGS = 60, 6, 4
_MOST = 10_000
_THERE = 3.3
"""Standard deviations of a gain that is there: 0.1 %, two-sided."""


@dataclass(frozen=True)
class ExcitationTest:
    """Directions that the record tells, of how many lags, and the static gain with its standard deviation."""

    order: int
    lags: int
    gain: float
    gain_spread: float

    @property
    def tells_gain(self) -> bool:
        """Whether the record tells the static gain without a model's help."""
        return self.gain_spread < max(1.0, abs(self.gain) / _THERE)


@one_thread_if_small(_LAGS)
def excitation_test(records: Sequence[Record], input: str, output: str, first_lag: int = 1) -> ExcitationTest:
    """The test over all records, each with a level of its own; at most their first 10 000 samples count.

    Raises NotIdentifiable where no row is complete, or a signal does not move.

    >>> from residuum.identification.record import Record
    >>> rng, t = np.random.default_rng(0), np.arange(600)
    >>> u = np.sin(2 * np.pi * t / 20)
    >>> record = Record({"u": u, "y": 0.3 * np.roll(u, 3) + 0.02 * rng.standard_normal(600)}, {"u": "", "y": ""}, 1.0)
    >>> found = excitation_test([record], "u", "y")
    >>> found.order, found.tells_gain
    (2, False)
    """
    short = [record.window(0, min(record.n, _MOST // len(records))) for record in records]
    lags = max(_FEWEST_LAGS, min(_LAGS, sum(record.n for record in short) // _SAMPLES_A_LAG))
    sums = reduce(add, [record_sums(record, [input], output, lags, first_lag, offset=True)[0].centred() for record in short])
    power, answer = max(float(np.diag(sums.gram).mean()), 1e-300), max(sums.energy, 1e-300)
    scaled = RegressionSums(
        sums.gram * (sums.rows / power),
        sums.cross * (sums.rows / np.sqrt(power * answer)),
        float(sums.rows),
        sums.rows,
        sums.regressor_sum,
        sums.output_sum,
        sums.fitted_offsets,
    )
    factor, explained = factored(scaled)
    noise = max(1.0 - float(explained @ explained) / sums.rows, 0.0) * sums.rows / max(sums.degrees_of_freedom - lags, 1)
    g = linalg.solve_triangular(factor, explained, lower=True, trans="T")
    spread = float(np.sqrt(noise) * np.linalg.norm(linalg.solve_triangular(factor, np.ones(lags), lower=True)))
    told = np.linalg.eigvalsh(scaled.gram) > max(noise, 1e-9 * sums.rows)
    return ExcitationTest(int(np.count_nonzero(told)), lags, float(g.sum()), spread)
