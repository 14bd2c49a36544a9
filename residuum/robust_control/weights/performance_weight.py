"""A performance weight with a monotone gain: high at low frequency, crossing 0 dB once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction


@dataclass(frozen=True)
class MonotoneWeight:
    """W(s) = (h s + a)/(s + a/l), |W(jω_c)| = 1.

    a = ω_c √((1 − h²)/(1 − l⁻²)) with gains l at ω = 0 and h at ω = ∞; used by Algorithm 3.

    Parameters
    ----------
    low_gain_db, high_gain_db : float
        20 lg l and 20 lg h; the one above, the other below 0 dB.
    critical_frequency : float
        ω_c [rad/s].
    """

    low_gain_db: float
    high_gain_db: float
    critical_frequency: float

    def __post_init__(self) -> None:
        if self.low_gain_db * self.high_gain_db >= 0:
            raise BadInput(
                f"MonotoneWeight: gains {self.low_gain_db} dB and {self.high_gain_db} dB; one must lie above 0 dB, one below"
            )
        if not (math.isfinite(self.critical_frequency) and self.critical_frequency > 0):
            raise BadInput(f"MonotoneWeight, critical_frequency: is {self.critical_frequency!r}; must be positive")

    def transfer_function(self) -> TransferFunction:
        """W(s)."""
        low, high = 10 ** (self.low_gain_db / 20), 10 ** (self.high_gain_db / 20)
        a = self.critical_frequency * math.sqrt((1 - high**2) / (1 - low**-2))
        return TransferFunction(np.array([high, a]), np.array([1.0, a / low]))

    def magnitude(self, omega: npt.ArrayLike) -> FloatArray:
        """|W(jω)|."""
        return np.abs(self.transfer_function().frequency_response(omega))
