"""First values of a controller for plants that the structure's usual ones do not stabilise: unstable and integrating plants."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from residuum.array_types import FloatArray
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.loop import Loop, characteristic
from residuum.robust_control.synthesis.controller_structure import ControllerStructure

_CROSSINGS, _DESCENTS, _EVALUATIONS = 12, 6, 300
_INSIDE = 1.0 - 1e-9


def stabilising_starts(loop: Loop, structure: ControllerStructure) -> list[tuple[FloatArray, FloatArray]]:
    """Values that stabilise every plant, each with the typical sizes of the parameters; empty when none is found.

    The structure's starts are scaled to cross over at frequencies spread over the grid, with both signs of the gain, and the
    largest modulus of the closed-loop poles is lowered from the best of them by simplex search, a bounded number of times.
    Plants that are measured only have no poles to move: for them the list is empty.

    Notes
    -----
    The spectral radius is neither convex nor smooth: an empty list does not prove that no controller of the structure stabilises.
    """
    plants = [plant for plant in loop.plants if isinstance(plant, TransferFunction)]
    if len(plants) < len(loop.plants):
        return []

    def radius(rho: FloatArray) -> float:
        controller = structure.transfer_function(rho)
        return float(max(np.abs(np.roots(characteristic(plant, controller))).max(initial=0.0) for plant in plants))

    low, high = _box(structure)
    scaled = [(np.clip(rho, low, high), sizes) for k in _crossings(loop) for rho, sizes in _scaled(loop, structure, k)]
    ranked = sorted((radius(rho), n) for n, (rho, _) in enumerate(scaled))
    if found := [scaled[n] for modulus, n in ranked if modulus < _INSIDE]:
        return found
    lowered = [_lowered(radius, *scaled[n], low, high) for _, n in ranked[:_DESCENTS]]
    return [start for start in lowered if start is not None]


def _box(structure: ControllerStructure) -> tuple[FloatArray, FloatArray]:
    low = [-np.inf if least is None else least for least, _ in structure.bounds()]
    return np.array(low), np.array([np.inf if most is None else most for _, most in structure.bounds()])


def _lowered(
    radius: Callable[[FloatArray], float], rho: FloatArray, sizes: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """The values that a simplex search from `rho` ends at, within the bounds; None where these do not stabilise either."""
    simplex = np.vstack([np.zeros(len(rho)), 0.5 * np.eye(len(rho))])
    least = minimize(
        lambda x: radius(np.clip(rho + sizes * x, low, high)),
        simplex[0],
        method="Nelder-Mead",
        options={"maxfev": _EVALUATIONS, "xatol": 1e-6, "fatol": 1e-9, "initial_simplex": simplex},
    )
    return (np.clip(rho + sizes * least.x, low, high), sizes) if least.fun < _INSIDE else None


def _crossings(loop: Loop) -> npt.NDArray[np.intp]:
    top = np.searchsorted(loop.omega, 0.7 * loop.omega[-1])
    wanted = np.geomspace(max(loop.omega[0], 1e-4 * loop.omega[-1]), loop.omega[min(top, len(loop.omega) - 1)], _CROSSINGS)
    return np.unique(np.minimum(np.searchsorted(loop.omega, wanted), len(loop.omega) - 1))


def _scaled(loop: Loop, structure: ControllerStructure, k: int) -> list[tuple[FloatArray, FloatArray]]:
    """(values, sizes) for a crossover at the grid's frequency k, both signs."""
    gain = float(np.abs(loop.G[:, k]).mean())
    if gain == 0.0:
        return []
    slow = 1.0 / float(loop.omega[k])
    sizes = structure.sizes(gain, slow)
    starts = [(rho, sizes) for sign in (1.0, -1.0) for rho in structure.starts(sign * gain, slow)]
    return starts
