"""Does the plant integrate? Whether the static gain B(1)/A(1) has a bound.

The static gain of a long autoregression is B(1)/A(1). Its confidence set is bounded only if A(1) differs from zero by more than
chance (Fieller 1954), and under a root at one chance is Dickey's and Fuller's: with the level estimated, A(1)/std exceeds 3.43 in
1 % of records only. Where A(1) may be zero and B(1) is not, the plant integrates, or settles slower than the record shows: the
record cannot tell the two apart. Where neither differs from zero, the noise wanders and the plant need not.

Fails where the loop holds the output so well that it hardly moves (then `feedback` speaks), and for a pole at one that the input
does not reach.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from residuum.identification.linear_models.plant_tests.long_autoregression import LongAutoregression

DICKEY_FULLER = 3.43
"""1 % level of Dickey's and Fuller's statistic with a constant, long records."""
_INPUT_ACTS = 3.3
"""Standard deviations of a sum of input weights that is there: 0.1 %, two-sided."""


@dataclass(frozen=True)
class IntegratorTest:
    """A(1) and B(1) over their standard deviations."""

    level_statistic: float
    input_statistic: float

    @property
    def integrates(self) -> bool:
        """Whether the static gain has no bound."""
        return self.level_statistic < DICKEY_FULLER and abs(self.input_statistic) > _INPUT_ACTS

    @property
    def wanders(self) -> bool:
        """Whether the output wanders by itself."""
        return self.level_statistic < DICKEY_FULLER and abs(self.input_statistic) <= _INPUT_ACTS


def integrator_test(found: LongAutoregression) -> IntegratorTest:
    """The test on a long autoregression.

    >>> from residuum.identification.linear_models.plant_tests.long_autoregression import long_autoregression
    >>> from residuum.identification.record import Record
    >>> rng = np.random.default_rng(0)
    >>> u, e = rng.standard_normal((2, 1000))
    >>> level = np.r_[0.0, np.cumsum(u)[:-1]] + 0.1 * e
    >>> record = Record({"u": u, "level": level}, {"u": "", "level": ""}, 1.0)
    >>> integrator_test(long_autoregression([record], "u", "level")).integrates
    True
    """
    a, b = found.output_weights, found.input_weights
    level_spread = found.spread(np.ones_like(a), np.zeros_like(b))
    input_spread = found.spread(np.zeros_like(a), np.ones_like(b))
    return IntegratorTest((1.0 - float(a.sum())) / level_spread, float(b.sum()) / input_spread)
