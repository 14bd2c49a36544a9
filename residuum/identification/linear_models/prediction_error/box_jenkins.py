"""Box–Jenkins: y = B/F u + C/D e."""

from collections.abc import Iterator

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.linear_models.prediction_error.base import Structure
from residuum.identification.linear_models.prediction_error.filtering import filtered
from residuum.identification.linear_models.prediction_error.polynomials import Orders
from residuum.identification.linear_models.prediction_error.starts import FirstValues


class BoxJenkins(Structure):
    """y = B/F u + C/D e: plant and noise with dynamics of their own."""

    name, equation = "bj", "y = B/F u + C/D e"

    def orders(self, order: int, delay: int) -> Orders:
        """n_b = n_f = n_c = n_d = order."""
        return Orders(nb=order, nf=order, nc=order, nd=order, delay=delay)

    def starts(self, first: FirstValues, orders: Orders) -> Iterator[FloatArray]:
        """The plant as for output error, the noise by two-stage regression on what the plant leaves."""
        for b, f in first.plant(orders.nb, orders.nf):
            delayed = np.r_[np.zeros(orders.delay), b]
            rests = [y - filtered(delayed, f, u) for u, y in first.data.pairs]
            c, d = first.noise(rests, orders.nc, orders.nd)
            yield np.concatenate([b, f[1:], c[1:], d[1:]])
