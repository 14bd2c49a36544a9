"""The second-order reference model of a closed loop, and the performance weight that it implies."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction


@dataclass(frozen=True)
class ReferenceModel:
    """T_d(s) = ω_n²/(s² + 2ξω_n s + ω_n²), from overshoot and settling time; (2.30), (2.31).

    ξ = |ln o|/√(π² + ln² o),   ω_n = 4/(ξ ℓ)    (the printed (2.31b) reads ω_n ℓ ξ = 4)

    Parameters
    ----------
    overshoot : float
        o, 0 < o < 1 (0.01 = 1 %).
    settling_time : float
        ℓ [s], into 2 %.

    Raises
    ------
    BadInput
        Outside these ranges.
    """

    overshoot: float
    settling_time: float

    def __post_init__(self) -> None:
        if not 0 < self.overshoot < 1:
            raise BadInput(f"ReferenceModel, overshoot: is {self.overshoot!r}; must lie between 0 and 1")
        if not (math.isfinite(self.settling_time) and self.settling_time > 0):
            raise BadInput(f"ReferenceModel, settling_time: is {self.settling_time!r}; must be a positive number of seconds")

    @property
    def damping(self) -> float:
        """ξ."""
        return abs(math.log(self.overshoot)) / math.hypot(math.pi, math.log(self.overshoot))

    @property
    def natural_frequency(self) -> float:
        """ω_n [rad/s]."""
        return 4.0 / (self.damping * self.settling_time)

    @property
    def bandwidth(self) -> float:
        """ω_c = ω_n √(√(4ξ⁴ + 1) − 2ξ²) [rad/s], where the open loop T_d/(1 − T_d) crosses 0 dB."""
        return self.natural_frequency * _crossing(self.damping)

    def transfer_function(self) -> TransferFunction:
        """T_d(s)."""
        w = self.natural_frequency
        return TransferFunction(np.array([w * w]), np.array([1.0, 2 * self.damping * w, w * w]))

    def weight_magnitude(self, omega: npt.ArrayLike) -> FloatArray:
        """|W_S(jω)| = |1 − T_d(jω)|⁻¹, (2.32); it grows without bound towards ω = 0, where a loop needs an integrator."""
        return np.asarray(1.0 / np.abs(1.0 - self.transfer_function().frequency_response(omega)), dtype=float)


def shortest_settling_time(overshoot: float, critical_frequency: float) -> float:
    """ℓ_min [s]: the settling time whose reference model crosses 0 dB at `critical_frequency` [rad/s]; step 2 of Algorithm 2."""
    damping = ReferenceModel(overshoot, 1.0).damping
    return 4.0 * _crossing(damping) / (damping * critical_frequency)


def _crossing(damping: float) -> float:
    return math.sqrt(math.sqrt(4 * damping**4 + 1) - 2 * damping**2)
