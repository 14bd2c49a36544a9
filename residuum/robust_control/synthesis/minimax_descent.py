"""Descent of the largest weighted cost over plants and frequencies, by the parameters of a controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.robust_control.loop import Loop, Weights
from residuum.robust_control.synthesis.controller_structure import ControllerStructure
from residuum.robust_control.synthesis.minimax_step import minimax_step

_SAME, _SMALLEST, _IDLE = 1e-6, 1e-4, 0.7


@dataclass(frozen=True, eq=False)
class _Trial:
    """Logarithms of the cost at one ρ, and the largest of them."""

    rho: FloatArray
    log_cost: FloatArray
    peak: float


class Descent:
    r"""Sequential quadratic programming on :math:`\min_\rho \max_k \ln c_k(\rho)` in a box that grows and shrinks.

    Only peaks of the cost along frequency are looked at (the working set); peaks that appear join it. The curvature of the
    Lagrangian is learnt (damped BFGS). A step that gains less than half of what the linear models promised is computed again
    from models bent to the values found at its end (second-order correction), and a step to a controller that does not
    stabilise every plant is not taken.

    Attributes
    ----------
    here : _Trial
        Parameters reached, with their costs; `here.peak` is ln of the largest.
    finished : bool
        No step within the smallest box, or a promised gain below 1e-6.

    References
    ----------
    J. Nocedal, S. Wright, *Numerical Optimization*, 2nd ed., chapter 18 (SQP, second-order correction, damped BFGS).
    """

    def __init__(self, loop: Loop, weights: Weights, structure: ControllerStructure, rho: FloatArray, sizes: FloatArray) -> None:
        self.loop, self.weights, self.structure = loop, weights, structure
        self.sizes = sizes
        self.scale = np.maximum(np.abs(rho), 0.3 * sizes)
        self.bounds = structure.bounds()
        self.here = _trial(loop, weights, structure, rho)
        self.working = _peaks(self.here.log_cost, self.here.peak)
        self.multipliers = np.zeros(loop.G.shape)
        self.curvature = 0.01 * np.eye(len(rho))
        self.last: tuple[FloatArray, FloatArray] | None = None  # step, slope of the Lagrangian before it
        self.radius = 1.0
        self.finished = False

    def advance(self, steps: int, goal: float) -> None:
        """At most so many steps, until ln cost ≤ goal."""
        for _ in range(steps):
            self.finished = self.finished or self.here.peak <= goal
            if self.finished:
                return
            self._step()

    def _step(self) -> None:
        here, at = self.here, np.nonzero(self.working)
        values, slopes = self._slopes(at)
        if self.last is not None:
            step, before = self.last
            self.curvature = _updated(self.curvature, step, self.multipliers[at] @ slopes - before)
            self.last = None
        reach = self.radius * np.maximum(1.0, np.abs(here.rho) / self.scale)
        low, high = self._box(reach)
        d, multipliers, predicted = minimax_step(values - here.peak, slopes, self.curvature, low, high)
        if predicted > -_SAME:
            self.finished = True
            return
        there, gained = self._try(d, predicted)
        if gained < 0.5:  # bend the models to what was found at the end of the step, and solve again
            bent = there.log_cost[at] - slopes @ d - here.peak
            again, weights, _ = minimax_step(bent - bent.max(), slopes, self.curvature, low, high)
            second, improved = self._try(again, predicted)
            if improved > gained:
                d, multipliers, there, gained = again, weights, second, improved
        if gained > 0.01:
            self.multipliers[at] = multipliers
            self.last = (d, multipliers @ slopes)
            self.here = there
            self.working &= (there.log_cost > there.peak - _IDLE) | (self.multipliers > 0.0)
            self.radius = min(1.0, 2.5 * self.radius) if gained > 0.6 else self.radius * (0.5 if gained < 0.2 else 1.0)
            return
        self.radius = 0.5 * min(self.radius, float(np.abs(d / reach).max()))
        self.finished = self.radius < _SMALLEST

    def _try(self, d: FloatArray, predicted: float) -> tuple[_Trial, float]:
        """(what stands at the end of a step, gain relative to the predicted one); minus infinity where a loop is unstable."""
        there = _trial(self.loop, self.weights, self.structure, self.here.rho + self.scale * d)
        self.working |= _peaks(there.log_cost, there.peak)
        gained = (self.here.peak - there.peak) / -predicted
        if gained > 0.0 and not self.loop.stabilised_by(*self.structure.polynomials(there.rho)):
            return there, -np.inf
        return there, gained

    def _slopes(self, at: tuple[npt.NDArray[np.intp], ...]) -> tuple[FloatArray, FloatArray]:
        """(ln cost, its slopes by the scaled parameters) at chosen (plant, frequency) pairs."""
        pairs = (at[0], at[1])
        K, dK = self.structure.response(self.here.rho, self.loop.z[pairs[1]])
        value, slope = self.loop.slopes(K, dK, self.weights, pairs)
        return np.log(value), slope * (self.scale / value[:, None])

    def _box(self, reach: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The steps within the radius and the structure's bounds, in units of the scale."""
        low, high = -reach, reach.copy()
        for j, (lower, upper) in enumerate(self.bounds):
            if lower is not None:
                low[j] = max(low[j], min(0.0, (lower - self.here.rho[j]) / self.scale[j]))
            if upper is not None:
                high[j] = min(high[j], max(0.0, (upper - self.here.rho[j]) / self.scale[j]))
        return low, high


def _trial(loop: Loop, weights: Weights, structure: ControllerStructure, rho: FloatArray) -> _Trial:
    cost = loop.cost(loop.controller_response(*structure.polynomials(rho)), weights)
    log_cost = np.log(np.maximum(cost, 1e-300))
    return _Trial(rho, log_cost, float(log_cost.max()))


def _updated(curvature: FloatArray, step: FloatArray, change: FloatArray) -> FloatArray:
    """Powell's damped BFGS update, which stays positive definite."""
    bent = curvature @ step
    along, seen = float(step @ bent), float(step @ change)
    share = 1.0 if seen >= 0.2 * along else 0.8 * along / (along - seen)
    change = share * change + (1.0 - share) * bent
    updated = curvature - np.outer(bent, bent) / along + np.outer(change, change) / float(step @ change)
    return np.asarray(updated + 1e-6 * np.eye(len(step)))


def _peaks(log_cost: FloatArray, highest: float) -> npt.NDArray[np.bool_]:
    """Local maxima along frequency within 20 % of the highest, with their neighbours, and the ends."""
    local = log_cost > highest - 0.22
    local[:, 1:] &= log_cost[:, 1:] >= log_cost[:, :-1]
    local[:, :-1] &= log_cost[:, :-1] >= log_cost[:, 1:]
    wide = local.copy()
    wide[:, 1:] |= local[:, :-1]
    wide[:, :-1] |= local[:, 1:]
    return wide
