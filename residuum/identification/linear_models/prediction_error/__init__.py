"""Prediction error methods: one search for the family A y = B/F u + C/D e, a file a structure.

>>> import numpy as np
>>> from residuum.identification.linear_models.prediction_error import STRUCTURES, identify
>>> from residuum.identification.record import Record
>>> rng = np.random.default_rng(1)
>>> u, e, y = rng.normal(size=500), 0.1 * rng.normal(size=500), np.zeros(500)
>>> for t in range(1, 500):
...     y[t] = -0.4 * y[t - 1] + 0.6 * u[t - 1] + e[t]
>>> model = identify(STRUCTURES["arx"], [Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0)], "u", "y", order=1)
>>> model.numerator.round(1).tolist(), model.denominator.round(1).tolist()
([0.6], [1.0, 0.4])
"""

from residuum.identification.linear_models.prediction_error.criterion import Orders
from residuum.identification.linear_models.prediction_error.identify import identify
from residuum.identification.linear_models.prediction_error.order_selection import CRITERIA
from residuum.identification.linear_models.prediction_error.result import in_confidence_ellipsoid
from residuum.identification.linear_models.prediction_error.starts import Structure
from residuum.identification.linear_models.prediction_error.structures import (
    AR,
    ARMAX,
    ARX,
    FIR,
    BoxJenkins,
    OutputError,
)

STRUCTURES: dict[str, Structure] = {
    "ar": AR(),
    "arx": ARX(),
    "fir": FIR(),
    "armax": ARMAX(),
    "oe": OutputError(),
    "bj": BoxJenkins(),
}

__all__ = ["CRITERIA", "STRUCTURES", "Orders", "Structure", "identify", "in_confidence_ellipsoid"]
