"""What every prediction error method is: which polynomials it has, and where its search starts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import ClassVar

from residuum.array_types import FloatArray
from residuum.identification.linear_models.prediction_error.criterion import Orders
from residuum.identification.linear_models.prediction_error.data import Signals
from residuum.identification.linear_models.prediction_error.starts import FirstValues


class Structure(ABC):
    """A model structure of the family A y = B/F u + C/D e.

    `linear` structures have a quadratic criterion: their start is already the minimum.
    """

    name: ClassVar[str]
    equation: ClassVar[str]
    linear: ClassVar[bool] = False
    has_input: ClassVar[bool] = True

    @abstractmethod
    def orders(self, order: int, delay: int) -> Orders:
        """The polynomial orders that one number means for this structure."""

    @abstractmethod
    def starts(self, first: FirstValues, orders: Orders) -> Iterator[FloatArray]:
        """First values of θ, the most promising first."""

    def parameters(self, data: Signals, orders: Orders) -> int:
        """Number of parameters that this data set must determine."""
        return orders.count
