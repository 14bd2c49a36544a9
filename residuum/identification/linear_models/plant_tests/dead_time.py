"""When does the input begin to act? The first lag whose weight, with all before it, is more than chance.

H₀(k): b_first = … = b_k = 0 in the long autoregression, by the χ² of the leading weights; the dead time is the first k that is
refused at .1 %. A response that begins gently is found a little late, by what drowns in the noise anyway.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from residuum.identification.linear_models.plant_tests.long_autoregression import LongAutoregression

_LEVEL = 1e-3


def dead_time(found: LongAutoregression) -> int | None:
    """Samples before the input acts; None where it acts within no lag of the regression.

    >>> from residuum.identification.linear_models.plant_tests.long_autoregression import long_autoregression
    >>> from residuum.identification.record import Record
    >>> u, e = np.random.default_rng(0).standard_normal((2, 1000))
    >>> record = Record({"u": u, "y": np.r_[np.zeros(40), u[:-40]] + e}, {"u": "", "y": ""}, 1.0)
    >>> dead_time(long_autoregression([record], "u", "y"))
    40
    """
    refused = np.flatnonzero(stats.chi2.sf(found.leading, np.arange(1, len(found.leading) + 1)) < _LEVEL)
    return found.first_lag + int(refused[0]) if refused.size else None
