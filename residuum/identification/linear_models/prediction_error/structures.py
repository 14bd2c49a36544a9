"""The structures of prediction-error models: ARX, ARMAX, output error, Box–Jenkins."""

from collections.abc import Iterator

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.linear_models.prediction_error.criterion import Orders, filtered
from residuum.identification.linear_models.prediction_error.starts import (
    FirstValues,
    Structure,
    least_squares_arx,
)

# ARMAX: A y = B u + C e.


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
            [
                least_squares_arx(first.data, Orders(orders.na, orders.nb, delay=orders.delay)),
                np.zeros(orders.nc),
            ]
        )


# ARX, and its special cases FIR (no A) and AR (no B).


class ARX(Structure):
    """A y = B u + e: linear least squares, biased when the noise does not enter through 1/A."""

    name, equation, linear = "arx", "A y = B u + e", True

    def orders(self, order: int, delay: int) -> Orders:
        """n_a = n_b = order."""
        return Orders(na=order, nb=order, delay=delay)

    def starts(self, first: FirstValues, orders: Orders) -> Iterator[FloatArray]:
        """The least-squares solution."""
        yield least_squares_arx(first.data, orders)


class FIR(ARX):
    """y = B u + e: linear, unbiased, but with large variance for long responses (the kernel methods
    cure that).
    """

    name, equation = "fir", "y = B u + e"

    def orders(self, order: int, delay: int) -> Orders:
        """n_b = order."""
        return Orders(nb=order, delay=delay)


class AR(ARX):
    """A y = e: a time series without an input."""

    name, equation, has_input = "ar", "A y = e", False

    def orders(self, order: int, delay: int) -> Orders:
        """n_a = order."""
        return Orders(na=order)


# Box–Jenkins: y = B/F u + C/D e.


class BoxJenkins(Structure):
    """y = B/F u + C/D e: plant and noise with dynamics of their own."""

    name, equation = "bj", "y = B/F u + C/D e"

    def orders(self, order: int, delay: int) -> Orders:
        """n_b = n_f = n_c = n_d = order."""
        return Orders(nb=order, nf=order, nc=order, nd=order, delay=delay)

    def starts(self, first: FirstValues, orders: Orders) -> Iterator[FloatArray]:
        """The plant as for output error, the noise by two-stage regression on what the plant
        leaves.
        """
        for b, f in first.plant(orders.nb, orders.nf):
            delayed = np.r_[np.zeros(orders.delay), b]
            rests = [y - filtered(delayed, f, u) for u, y in first.data.pairs]
            c, d = first.noise(rests, orders.nc, orders.nd)
            yield np.concatenate([b, f[1:], c[1:], d[1:]])


# Output error: y = B/F u + e.


class OutputError(Structure):
    """y = B/F u + e: white noise on the output. With too low an order it fits where the output has
    power.
    """

    name, equation = "oe", "y = B/F u + e"

    def orders(self, order: int, delay: int) -> Orders:
        """n_b = n_f = order."""
        return Orders(nb=order, nf=order, delay=delay)

    def starts(self, first: FirstValues, orders: Orders) -> Iterator[FloatArray]:
        """A realisation of the impulse response, as it is and refined by iterated prefiltering."""
        for b, f in first.plant(orders.nb, orders.nf):
            yield np.concatenate([b, f[1:]])
