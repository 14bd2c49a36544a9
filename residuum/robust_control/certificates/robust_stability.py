"""Robust stability under unstructured uncertainty: the small-gain tests of Table 2 of the source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.loop import Loop, characteristic, frequency_grid

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
_Test = Callable[[ComplexArray, ComplexArray, ComplexArray], FloatArray]

UNCERTAINTIES: dict[str, _Test] = {
    "additive": lambda G, K, S: np.abs(K * S),
    "input-multiplicative": lambda G, K, S: np.abs(G * K * S),
    "output-multiplicative": lambda G, K, S: np.abs(G * K * S),
    "inverse-additive": lambda G, K, S: np.abs(G * S),
    "inverse-input-multiplicative": lambda G, K, S: np.abs(S),
    "inverse-output-multiplicative": lambda G, K, S: np.abs(S),
    "right-coprime": lambda G, K, S: np.abs(S) * np.hypot(1.0, np.abs(K)) * np.hypot(1.0, np.abs(G)),
    "left-coprime": lambda G, K, S: np.abs(S) * np.hypot(1.0, np.abs(K)) * np.hypot(1.0, np.abs(G)),
}
"""Kind → |M| of its test ‖W M‖∞ ≤ 1.

G + WΔ; G(1 + WΔ); (1 + WΔ)G; G/(1 + WΔG); G/(1 + WΔ) and (1 + WΔ)⁻¹G; (N + Δ_n)/(D + Δ_d) with the normalised coprime
factors |N|² + |D|² = 1 of G, for which D⁻¹ = √(1 + |G|²) on the circle. For one input and one output the input and
output forms agree, and so do right and left. (1.27) is printed without its bars and as one entry too many.
"""


@dataclass(frozen=True)
class RobustStability:
    """Result of one test.

    Attributes
    ----------
    kind : str
    peak : float
        max_ω |W M|; every Δ with ‖Δ‖∞ < 1/peak leaves the loop stable, and some Δ of that size does not.
    frequency : float
        Where it is [rad/s].
    holds : bool
        Whether all ‖Δ‖∞ < 1 are tolerated: the nominal loop is stable and peak ≤ 1.
    """

    kind: str
    peak: float
    frequency: float
    holds: bool


def robust_stability(
    kind: str, plant: TransferFunction, controller: TransferFunction, weight: TransferFunction | None = None
) -> RobustStability:
    """The small-gain test of one kind of uncertainty, on a grid that is dense about the closed loop's own resonances.

    Parameters
    ----------
    kind : str
        A key of `UNCERTAINTIES`.
    weight : TransferFunction or None
        W; None: 1, so that 1/peak is the stability radius (1.26).

    Raises
    ------
    BadInput
        Unknown kind; plant not in discrete time.

    Examples
    --------
    >>> plant = TransferFunction([0.1], [1.0, -0.9], 1.0)
    >>> proportional = TransferFunction([4.0], [1.0], 1.0)
    >>> found = robust_stability("output-multiplicative", plant, proportional)
    >>> round(found.peak, 3), found.holds
    (0.8, True)
    """
    if kind not in UNCERTAINTIES:
        raise BadInput(f"robust stability, kind: is {kind!r}; must be one of {', '.join(UNCERTAINTIES)}")
    omega, G, K, S = loop_responses(plant, controller)
    W = np.ones(len(omega)) if weight is None else np.abs(weight.frequency_response(omega))
    test = W * UNCERTAINTIES[kind](G, K, S)
    k = int(np.argmax(test))
    stable = Loop([plant], omega).is_certainly_stable(controller)
    return RobustStability(kind, float(test[k]), float(omega[k]), stable and bool(test[k] <= 1.0))


def loop_responses(
    plant: TransferFunction, controller: TransferFunction
) -> tuple[FloatArray, ComplexArray, ComplexArray, ComplexArray]:
    """(ω, G, K, S) on a grid dense about the plant's and the closed loop's resonances."""
    closed = TransferFunction(plant.den, characteristic(plant, controller), plant.sample_time)
    omega = frequency_grid([plant, closed], points=4000)
    G, K = plant.frequency_response(omega), controller.frequency_response(omega)
    return omega, G, K, 1.0 / (1.0 + G * K)
