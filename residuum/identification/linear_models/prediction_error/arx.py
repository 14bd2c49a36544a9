"""ARX, and its special cases FIR (no A) and AR (no B)."""

from collections.abc import Iterator

from residuum.array_types import FloatArray
from residuum.identification.linear_models.prediction_error.base import Structure
from residuum.identification.linear_models.prediction_error.polynomials import Orders
from residuum.identification.linear_models.prediction_error.starts import FirstValues, least_squares_arx


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
    """y = B u + e: linear, unbiased, but with large variance for long responses (the kernel methods cure that)."""

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
