"""Output error: y = B/F u + e."""

from collections.abc import Iterator

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.linear_models.prediction_error.base import Structure
from residuum.identification.linear_models.prediction_error.polynomials import Orders
from residuum.identification.linear_models.prediction_error.starts import FirstValues


class OutputError(Structure):
    """y = B/F u + e: white noise on the output. With too low an order it fits where the output has power."""

    name, equation = "oe", "y = B/F u + e"

    def orders(self, order: int, delay: int) -> Orders:
        """n_b = n_f = order."""
        return Orders(nb=order, nf=order, delay=delay)

    def starts(self, first: FirstValues, orders: Orders) -> Iterator[FloatArray]:
        """A realisation of the impulse response, as it is and refined by iterated prefiltering."""
        for b, f in first.plant(orders.nb, orders.nf):
            yield np.concatenate([b, f[1:]])
