"""Disk margins: gain and phase that may vary together before the loop becomes unstable."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.loop import Loop, characteristic, frequency_grid


@dataclass(frozen=True)
class DiskMargin:
    """`alpha` is the disk's size; gain may vary within (`gain_low`, `gain_high`), phase within ± `phase` [rad], at once or alone.

    `frequency` [rad/s] is where the loop is nearest to the disk.
    """

    alpha: float
    gain_low: float
    gain_high: float
    phase: float
    frequency: float


def disk_margin(plant: TransferFunction, controller: TransferFunction, *, skew: float = 0.0) -> DiskMargin:
    """α = 1/‖S + (σ − 1)/2‖∞ for the perturbations f = (1 + (1−σ)/2 δ)/(1 − (1+σ)/2 δ), |δ| < α.

    Parameters
    ----------
    skew : float
        σ: 0 weighs more and less gain alike, 1 uses S alone, −1 uses T alone.

    Raises
    ------
    BadInput
        The nominal loop is not stable: there is no margin.

    References
    ----------
    P. Seiler, A. Packard, P. Gahinet, *An introduction to disk margins*, IEEE Control Systems Magazine 40 (2020) 78–95.

    Examples
    --------
    >>> plant, K = TransferFunction([0.1], [1.0, -0.9], 1.0), TransferFunction([4.0], [1.0], 1.0)
    >>> margin = disk_margin(plant, K)
    >>> round(margin.gain_high, 3), bool(margin.phase > 1)
    (4.75, True)
    """
    omega, _, _, S = loop_responses(plant, controller)
    if not Loop([plant], omega).is_certainly_stable(controller):
        raise BadInput("disk margin: the nominal loop is not stable")
    distance = np.abs(S + (skew - 1.0) / 2.0)
    k = int(np.argmax(distance))
    alpha = 1.0 / float(distance[k])
    low = (2.0 - alpha * (1.0 - skew)) / (2.0 + alpha * (1.0 + skew))
    room = 2.0 - alpha * (1.0 + skew)
    high = (2.0 + alpha * (1.0 - skew)) / room if room > 1e-12 else math.inf
    cosine = low if math.isinf(high) else (1.0 + low * high) / (low + high)
    return DiskMargin(alpha, low, high, math.acos(min(1.0, max(-1.0, cosine))), float(omega[k]))


def loop_responses(
    plant: TransferFunction, controller: TransferFunction
) -> tuple[FloatArray, ComplexArray, ComplexArray, ComplexArray]:
    """(ω, G, K, S) on a grid dense about the plant's and the closed loop's resonances."""
    closed = TransferFunction(plant.den, characteristic(plant, controller), plant.sample_time)
    omega = frequency_grid([plant, closed], points=4000)
    G, K = plant.frequency_response(omega), controller.frequency_response(omega)
    return omega, G, K, 1.0 / (1.0 + G * K)
