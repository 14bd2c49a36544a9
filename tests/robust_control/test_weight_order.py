"""A weight whose fit, not what it bounds, is over 100 % at the lowest frequency."""

import numpy as np
from scipy.signal import lfilter

from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.record import Record
from residuum.robust_control.control_problem import ControlProblem, WeightChoice


def test_two_orders_more_where_the_fit_alone_is_over_100_percent():
    """Two resonances cut off after 100 lags: a weight of order 2 above Ω is 2 at low frequency, where Ω is .4."""
    rng = np.random.default_rng(1)
    u = rng.standard_normal(6000)
    y = lfilter([0, 0, 0, 0.28261, 0.50666], [1, -1.41833, 1.58939, -1.31608, 0.88642], u)
    e = np.clip(rng.standard_normal(6000), -3, 3)
    y = y + e * np.std(y) / 5.0 / np.std(e)
    model = identify_impulse_response(
        Record({"u": u[1000:], "y": y[1000:]}, {"u": "", "y": ""}, 0.01), "u", "y", offset=False
    )
    problem = ControlProblem([model], seed=1, weight=WeightChoice(lowest=1e-3))
    assert problem.largest[0] < 1.0 and problem.magnitude[0] < 1.0
    assert np.all(problem.magnitude >= problem.largest * (1 - 1e-9))
    assert problem.crossing > 1.0
