"""Fixed-structure mixed-sensitivity synthesis: the controller of a given structure with the smallest peak cost."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import LARGEST_FOR_ONE_THREAD, one_thread_if_small
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.loop import Loop, Weights
from residuum.robust_control.synthesis.controller_structure import ControllerStructure
from residuum.robust_control.synthesis.minimax_descent import Descent
from residuum.robust_control.synthesis.stabilising_start import stabilising_starts

_STEPS, _FIRST_STEPS, _STARTS, _EXCHANGES = 80, 8, 4, 3
_LEFT_BEHIND = 0.05
_GAP = 3e-5


@dataclass(frozen=True, eq=False)
class Synthesis:
    """A designed controller.

    Attributes
    ----------
    structure : ControllerStructure
    rho : array
        Its parameters.
    controller : TransferFunction
        K(z).
    cost : float
        Largest weighted cost over plants and grid.
    certified : float
        The largest cost on a grid 20 times finer.
    worst_frequency : float
        Where it is [rad/s].
    loop : Loop
        The plants it was designed for.
    """

    structure: ControllerStructure
    rho: FloatArray
    controller: TransferFunction
    cost: float
    certified: float
    worst_frequency: float
    loop: Loop = field(repr=False)

    @cached_property
    def stable(self) -> bool:
        """From the closed-loop roots; computed when asked for, since most designs of a search are dropped for their cost."""
        return self.loop.is_certainly_stable(self.controller)


class NoStabilisingStart(BadInput):
    """No first value of the structure stabilises the plants; the search cannot begin."""


@one_thread_if_small(LARGEST_FOR_ONE_THREAD)
def synthesise(
    loop: Loop,
    weights: Weights,
    structure: ControllerStructure,
    *,
    starts: Iterable[FloatArray] | None = None,
    target: float | None = None,
) -> Synthesis:
    """Minimise the peak over plants and frequencies of the weighted cost.

    min_ρ max_{G, ω} ‖[W_S S; W_T T; W_K K S]‖, written as min t subject to cost_k(ρ) ≤ t on a working set of peaks and solved by
    sequential quadratic programming with exact gradients; peaks that appear join the set. A step that leaves
    the set of stabilising controllers is cut back, which the cost itself demands, since S grows without bound at
    its border. Peaks that stand between two frequencies of the grid are found on one 20 times finer and added, until both agree.

    Parameters
    ----------
    loop : Loop
        Plants on their frequency grid.
    weights : Weights
        |W_S|, |W_T|, and |W_K| where the control effort counts, on the same grid.
    structure : ControllerStructure
    starts : iterable of arrays, optional
        First values; default the structure's own, scaled by the plants.
    target : float, optional
        Stop as soon as the cost is below it.

    Raises
    ------
    NoStabilisingStart
        No start stabilises all plants.

    Notes
    -----
    The problem is not convex: several starts are searched and the best kept; a global optimum is not certified.

    References
    ----------
    P. Apkarian, D. Noll, *Nonsmooth H∞ synthesis*, IEEE Trans. Autom. Control 51 (2006).
    """
    sizes = structure.sizes(*loop.gain_and_time_constant)
    first = [(rho, sizes) for rho in (starts if starts is not None else default_starts(loop, structure))]
    usable = [(rho, sizes) for rho, sizes in first if loop.stabilised_by(*structure.polynomials(rho))]
    if starts is None and (not usable or not loop.plants_are_stable):
        if structure not in loop.stabilising:
            loop.stabilising[structure] = stabilising_starts(loop, structure)
        usable += loop.stabilising[structure]
    if not usable:
        raise NoStabilisingStart(
            f"controller {structure.name!r}: none of {len(first)} first values stabilises the plant, nor any found by moving "
            "the closed-loop poles inwards; take a structure with more freedom"
        )
    descents = [Descent(loop, weights, structure, rho, sizes) for rho, sizes in usable]
    best = _search(_valleys(descents), target)
    for _ in range(_EXCHANGES):
        found = _fine_cost(loop, weights, structure, best.here.rho)
        enough = np.exp(best.here.peak) * (1.0 + _GAP) if target is None else max(target, np.exp(best.here.peak) * (1.0 + _GAP))
        if found.max() <= enough:
            break
        loop, weights = _with_peaks(loop, weights, found)
        best = _search([Descent(loop, weights, structure, best.here.rho, best.sizes)], target)
    return _result(loop, weights, structure, best)


def _search(descents: list[Descent], target: float | None) -> Descent:
    """Every descent begins; those that are not left far behind by the best go on to the end.

    Descents that come near to each other are not joined: two optima of one sign pattern can lie close, and differ by percents.
    """
    goal = -np.inf if target is None else float(np.log(target))
    for descent in descents:
        descent.advance(_FIRST_STEPS if len(descents) > 1 else _STEPS, goal)
        if descent.here.peak <= goal:
            return descent
    descents = sorted(descents, key=lambda descent: descent.here.peak)
    best = descents[0]
    for descent in descents:
        if descent is best or descent.here.peak < best.here.peak + _LEFT_BEHIND:
            descent.advance(_STEPS, goal)
            best = min(best, descent, key=lambda one: one.here.peak)
    return best


def _valleys(descents: list[Descent]) -> list[Descent]:
    """The best start of each pattern of signs, four at most: starts of one pattern mostly end in the same valley."""
    best: dict[bytes, Descent] = {}
    for descent in sorted(descents, key=lambda descent: descent.here.peak):
        best.setdefault(np.sign(descent.here.rho).tobytes(), descent)
    return list(best.values())[:_STARTS]


def default_starts(loop: Loop, structure: ControllerStructure) -> list[FloatArray]:
    """The structure's first values for the plants' static gain and response time, and for five times slower and faster ones."""
    gain, slow = loop.gain_and_time_constant
    return [rho for scale in (1.0, 5.0, 0.2) for rho in structure.starts(gain, scale * slow)]


def _result(loop: Loop, weights: Weights, structure: ControllerStructure, best: Descent) -> Synthesis:
    rho = best.here.rho
    controller = structure.transfer_function(rho)
    fine = _fine_cost(loop, weights, structure, rho)
    where = float(loop.finer[0].omega[int(np.argmax(fine))])
    cost = float(np.exp(best.here.peak))
    return Synthesis(structure, rho, controller, cost, float(fine.max()), where, loop)


def _fine_cost(loop: Loop, weights: Weights, structure: ControllerStructure, rho: FloatArray) -> FloatArray:
    """The largest cost over the plants on the finer grid, shape (fine frequencies,)."""
    fine, position = loop.finer
    K = fine.controller_response(*structure.polynomials(rho))
    return np.asarray(fine.cost(K, weights.between(position)).max(axis=0))


def _with_peaks(loop: Loop, weights: Weights, fine_cost: FloatArray) -> tuple[Loop, Weights]:
    """The grid with the finer grid's peaks added, so that the next design sees them."""
    inner = fine_cost[1:-1]
    peaks = 1 + np.flatnonzero((inner >= fine_cost[:-2]) & (inner >= fine_cost[2:]) & (inner > 0.9 * fine_cost.max()))
    position = loop.finer[1]
    kept = np.union1d(np.searchsorted(position, np.arange(len(loop.omega))), peaks)
    return loop.part_of_finer(kept), weights.between(position[kept])
