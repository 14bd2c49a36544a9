"""ARMAX: A y = B u + C e."""

from collections.abc import Iterator

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.linear_models.prediction_error.base import Structure
from residuum.identification.linear_models.prediction_error.polynomials import Orders
from residuum.identification.linear_models.prediction_error.starts import FirstValues, least_squares_arx


class ARMAX(Structure):
    """A y = B u + C e: noise that enters early in the process, with a colour of its own."""

    name, equation = "armax", "A y = B u + C e"

    def orders(self, order: int, delay: int) -> Orders:
        """n_a = n_b = n_c = order."""
        return Orders(na=order, nb=order, nc=order, delay=delay)

    def starts(self, first: FirstValues, orders: Orders) -> Iterator[FloatArray]:
        """Two-stage regression, and the ARX solution with C = 1."""
        yield first.armax(orders.na, orders.nb, orders.nc)
        yield np.concatenate(
            [least_squares_arx(first.data, Orders(orders.na, orders.nb, delay=orders.delay)), np.zeros(orders.nc)]
        )
