"""What the figures of section 2.3 share: for each identification of (2.38) its loop, designs and random plants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from reproduction.benchmark import FULL, KERNEL, LOW, OMEGA, SEED, TS, identified, weights
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.certificates import (
    RobustAim,
    RobustDesign,
    design_for_robust_performance,
)
from residuum.robust_control.loop import Loop, Weights, frequency_grid
from residuum.robust_control.synthesis.constrained_structure import PIDN
from residuum.robust_control.synthesis.structured_synthesis import Synthesis, synthesise
from residuum.robust_control.weights.performance_weight import (
    NominalAim,
    NominalDesign,
    ReferenceModel,
    design_for_nominal_performance,
)

AIM, DURATION, PLANTS = (
    NominalAim(smallest_overshoot=0.01, longest_settling_time=5.0, slack=0.1),
    4.0,
    200,
)
LIMIT = 1.0 + AIM.slack
NAMES = (LOW, FULL, KERNEL)
FloatArray = npt.NDArray[np.float64]
LOG = {
    "xaxis_title": "ω [rad/s]",
    "yaxis_title": "magnitude",
    "xaxis_type": "log",
    "yaxis_type": "log",
}


@dataclass(frozen=True, eq=False)
class Case:
    """One identification: its plant, grid, |Ŵ_T| on it, where that crosses 0 dB [rad/s], and random plants."""

    name: str
    plant: TransferFunction
    loop: Loop
    W_T: FloatArray
    critical: float
    sampled: Sequence[TransferFunction]


@lru_cache
def case(name: str, plants: int = PLANTS) -> Case:
    """The case of an identification with so many random plants."""
    model, weight = identified()[name], weights()[name]
    plant = model.transfer_function()
    loop = Loop([plant], frequency_grid([plant], lowest=OMEGA[0]))
    den = np.r_[1.0, np.zeros(model.delay + model.order - 1)]
    sampled = [TransferFunction(g, den, TS) for g in model.sample(plants, SEED)]
    W_T = np.abs(weight.weight.frequency_response(loop.omega))
    return Case(name, plant, loop, W_T, weight.critical_frequency or np.pi / TS, sampled)


@lru_cache
def nominal(name: str) -> NominalDesign:
    """DS3: Algorithm 2."""
    one = case(name)
    return design_for_nominal_performance(one.loop, one.W_T, PIDN(TS), AIM, one.critical)


@lru_cache
def robust(name: str) -> RobustDesign:
    """Algorithm 3 with the settings of (2.37)."""
    one = case(name)
    return design_for_robust_performance(one.loop, one.W_T, PIDN(TS), RobustAim(), one.critical)


@lru_cache
def manual(name: str) -> dict[str, Synthesis]:
    """DS1 as printed and read with −10 dB, and DS2."""
    one = case(name)
    W_S = ReferenceModel(0.01, 1.0).weight_magnitude(one.loop.omega)
    chosen = {
        "DS1": manual_weight(10.0, one.loop.omega),
        "DS1 at −10 dB": manual_weight(-10.0, one.loop.omega),
        "DS2": one.W_T,
    }
    return {
        label: synthesise(one.loop, Weights(W_S, W_T), PIDN(TS)) for label, W_T in chosen.items()
    }


def manual_weight(low_gain_db: float, omega: FloatArray) -> FloatArray:
    """|W_T| rising from the low gain to 40 dB with its zero such that a gain below 0 dB crosses it at 40 rad/s."""
    low, high = 10 ** (low_gain_db / 20), 100.0
    zero = 40.0 / np.sqrt(low**-2 - 1) if low < 1 else 40.0
    weight = TransferFunction(np.array([low / zero, low]), np.array([low / (zero * high), 1.0]))
    return np.abs(weight.frequency_response(omega))


def law(rho: FloatArray, z: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
    """K(z) of (2.39) as it is printed."""
    kp, ki, kd, Nd = rho
    return np.asarray(kp + ki * TS / (z - 1) + kd / (Nd + TS / (z - 1)))


def sensitivities(loop: Loop, controller: TransferFunction) -> tuple[FloatArray, FloatArray]:
    """|T|, |S| of the nominal loop."""
    L = loop.G[0] * controller.frequency_response(loop.omega)
    return np.abs(L / (1 + L)), np.abs(1 / (1 + L))
