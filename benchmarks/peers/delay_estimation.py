"""The input delay of the actuator: by simulation error (7.3), and by likelihood with coloured noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from residuum.diagnosis.gate.actuator_model import AdaptedModel
from residuum.diagnosis.gate.movements import Movement, flat_part
from residuum.diagnosis.vibration.vibration_indicators import autoregressive_whitener
from residuum.identification.errors import NotIdentifiable

Signal = npt.NDArray[np.float64]
_NOISE_ORDER = 20


@dataclass(frozen=True)
class Delay:
    """A delay d [s], its standard deviation from the curvature of the criterion [s], and the criterion there.

    `at_edge` True: the optimum lies at an end of the grid, so the data do not fix a delay inside it.
    """

    value: float
    std: float
    criterion: float
    at_edge: bool


def delay_by_simulation_error(
    movement: Movement, model: AdaptedModel, largest: float = 0.05
) -> Delay:
    """Minimise J(d) = mean (v^c − v̂_d)² of (7.3) over 0 ≤ d ≤ `largest`, the other constants of `model` kept.

    J is written in motor speed; τ̄ scales it only. The standard deviation takes the residual as white, which a gate's
    residual is not, so it is too small; and a wrong time constant is paid for with a wrong delay (only T + d shows in the
    ramps).
    """
    run = _moving(movement)
    n = run.stop - run.start

    def cost(d: float) -> float:
        residual = replace(model, delay=d).residual(movement)[run]
        return 0.5 * n * float(np.log(np.mean(residual**2)))

    return _minimum(cost, movement.sample_time, largest)


def delay_by_likelihood(
    movement: Movement, model: AdaptedModel, largest: float = 0.05, order: int = _NOISE_ORDER
) -> Delay:
    """Maximise the Gaussian likelihood of d with the residual autoregressive of `order` (fitted at each d).

    Whitening takes weight from the slow misfit that friction leaves and gives it to what moves fast, such as the ripple of the
    pulse-width modulation, which fixes the delay to a fraction of a sample.
    """
    run = _moving(movement)

    def cost(d: float) -> float:
        residual = replace(model, delay=d).residual(movement)[run]
        innovation = np.asarray(
            lfilter(autoregressive_whitener(residual, order), [1.0], residual - np.mean(residual))
        )[order:]
        return 0.5 * innovation.shape[0] * float(np.log(np.mean(innovation**2)))

    return _minimum(cost, movement.sample_time, largest)


def _moving(movement: Movement) -> slice:
    """From 30 % of the flat speed on the way up to the end of the flat part."""
    flat, _ = flat_part(movement)
    fast = np.flatnonzero(movement.speed > 0.3 * np.median(movement.speed[flat]))
    if fast.size == 0 or flat.stop - fast[0] < 10 * _NOISE_ORDER:
        raise NotIdentifiable("the movement is too short to estimate a delay from")
    return slice(int(fast[0]), flat.stop)


def _minimum(cost: Callable[[float], float], step: float, largest: float) -> Delay:
    """Least of −ln likelihood on the grid of samples, refined by the parabola through three quarter-step points."""
    grid = np.arange(0.0, largest + 0.5 * step, step)
    values = np.array([cost(float(d)) for d in grid])
    best = int(np.argmin(values))
    if best in (0, grid.shape[0] - 1):
        return Delay(float(grid[best]), float("inf"), float(values[best]), True)
    fine = grid[best] + step * np.array([-0.5, -0.25, 0.0, 0.25, 0.5])
    a, b, c = np.polyfit(fine - grid[best], [cost(float(d)) for d in fine], 2)
    if a <= 0:
        return Delay(float(grid[best]), step, float(values[best]), False)
    offset = float(np.clip(-b / (2 * a), -step, step))
    return Delay(
        float(grid[best] + offset), float(1.0 / np.sqrt(2 * a)), float(c - b**2 / (4 * a)), False
    )
