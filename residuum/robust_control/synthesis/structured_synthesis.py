"""Fixed-structure mixed-sensitivity synthesis: the controller of a given structure with the
smallest peak cost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize, nnls

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import LARGEST_FOR_ONE_THREAD, one_thread_if_small
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.kept_loops import njit
from residuum.robust_control.loop import Loop, Weights, characteristic
from residuum.robust_control.synthesis.constrained_structure import ControllerStructure

# One step of a minimax problem: the quadratic programme in its epigraph form.

_SMALLEST_PIVOT = 1e-12  # of a diagonal element: below it the curvature is taken for singular


def minimax_step(
    c: FloatArray, A: FloatArray, H: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    r"""(d, λ, t): :math:`\min_{d,t} t + \tfrac12 t^2 + \tfrac12 d^T H d` with :math:`c_i + a_i^T d
    \le t`, low ≤ d ≤ high.

    The problem is one of least distance from (0, −1) in the coordinates (Lᵀd, t), H = L Lᵀ, which
    non-negative least squares solves exactly in as many steps as constraints become active. The
    term ½t² makes it one; near the solution, where t → 0, it has no weight.

    Parameters
    ----------
    c, A : array, shapes (m,), (m, n)
        Values of the functions less their maximum, and their slopes.
    H : array, shape (n, n)
        Curvature, positive definite.
    low, high : array, shape (n,)
        Bounds, low ≤ 0 ≤ high.

    Returns
    -------
    d, λ, t : array (n,), array (m,), float
        The step, the multipliers of the functions (their sum is 1 + t), and the largest linear
        model at the step.

    References
    ----------
    C. L. Lawson, R. J. Hanson, *Solving Least Squares Problems*, chapter 23 (least distance
    programming).

    Examples
    --------
    >>> d, multipliers, t = minimax_step(
    ...     np.array([0.0, -1.0]), np.array([[-1.0], [1.0]]), 1e-6 * np.eye(1), -np.ones(1), np.ones(1)
    ... )
    >>> d.round(5).tolist(), multipliers.round(3).tolist(), round(t, 5)
    ([0.5], [0.25, 0.25], -0.5)
    """
    m, n = A.shape
    inverse = _inverse_of_lower(_lower_factor(H))
    E = np.zeros((n + 2, m + 2 * n))
    E[:n] = np.hstack([-inverse @ A.T, inverse, -inverse])
    E[n, :m] = 1.0
    E[n + 1] = np.concatenate([c + 1.0, low, -high])
    target = np.zeros(n + 2)
    target[n + 1] = 1.0
    try:
        u, _ = nnls(E, target)
    except RuntimeError:
        # went round in circles between all but equal sets: no step, and the descent ends here
        u = np.zeros(m + 2 * n)
    residual = E @ u - target
    d = np.clip(-inverse.T @ residual[:n] / residual[n + 1], low, high)
    return d, u[:m] / -residual[n + 1], float((c + A @ d).max())


@njit(error_model="numpy")
def _lower_factor(H):  # type: ignore[no-untyped-def]  # compiled
    """Cholesky's L; a pivot that rounding made vanish is held at 10⁻¹² of its diagonal, so that H
    may be all but singular.
    """
    n = len(H)
    L = np.zeros((n, n))
    for j in range(n):
        pivot = H[j, j]
        for k in range(j):
            pivot -= L[j, k] ** 2
        L[j, j] = np.sqrt(max(pivot, _SMALLEST_PIVOT * H[j, j]))
        for i in range(j + 1, n):
            total = H[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = total / L[j, j]
    return L


@njit(error_model="numpy")
def _inverse_of_lower(L):  # type: ignore[no-untyped-def]  # compiled
    n = len(L)
    inverse = np.zeros((n, n))
    for j in range(n):
        inverse[j, j] = 1.0 / L[j, j]
        for i in range(j + 1, n):
            total = 0.0
            for k in range(j, i):
                total += L[i, k] * inverse[k, j]
            inverse[i, j] = -total / L[i, i]
    return inverse


# Descent of the largest weighted cost over plants and frequencies, by the parameters of a
# controller.

_SAME = 1e-6  # promised gain in ln cost below which a descent is finished
_SMALLEST = 1e-4  # box, in units of the parameters' scale, below which it is finished
_IDLE = 0.7  # in ln cost below the peak: points further down leave the working set


@dataclass(frozen=True, eq=False)
class _Trial:
    """Logarithms of the cost at one ρ, and the largest of them."""

    rho: FloatArray
    log_cost: FloatArray
    peak: float


class Descent:
    r"""Sequential quadratic programming on :math:`\min_\rho \max_k \ln c_k(\rho)` in a box that
    grows and shrinks.

    Only peaks of the cost along frequency are looked at (the working set); peaks that appear join
    it. The curvature of the Lagrangian is learnt (damped BFGS). A step that gains less than half of
    what the linear models promised is computed again from models bent to the values found at its
    end (second-order correction), and a step to a controller that does not stabilise every plant is
    not taken.

    Attributes
    ----------
    here : _Trial
        Parameters reached, with their costs; `here.peak` is ln of the largest.
    finished : bool
        No step within the smallest box, or a promised gain below 1e-6.

    References
    ----------
    J. Nocedal, S. Wright, *Numerical Optimization*, 2nd ed., chapter 18 (SQP, second-order
    correction, damped BFGS).
    """

    def __init__(
        self,
        loop: Loop,
        weights: Weights,
        structure: ControllerStructure,
        rho: FloatArray,
        sizes: FloatArray,
    ) -> None:
        self.loop, self.weights, self.structure = loop, weights, structure
        self.sizes = sizes
        self.scale = np.maximum(np.abs(rho), 0.3 * sizes)
        self.bounds = structure.bounds()
        self.here = _trial(loop, weights, structure, rho)
        self.working = _peaks(self.here.log_cost, self.here.peak)
        self.multipliers = np.zeros(loop.G.shape)
        self.curvature = 0.01 * np.eye(len(rho))
        # step, and slope of the Lagrangian before it
        self.last: tuple[FloatArray, FloatArray] | None = None
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
        current, at = self.here, np.nonzero(self.working)
        values, slopes = self._slopes(at)
        if self.last is not None:
            step, before = self.last
            self.curvature = _updated(self.curvature, step, self.multipliers[at] @ slopes - before)
            self.last = None
        reach = self.radius * np.maximum(1.0, np.abs(current.rho) / self.scale)
        low, high = self._box(reach)
        d, multipliers, predicted = minimax_step(
            values - current.peak, slopes, self.curvature, low, high
        )
        if predicted > -_SAME:
            self.finished = True
            return
        trial, gained = self._try(d, predicted)
        # bend the models to what was found at the end of the step, and solve again
        if gained < 0.5:
            bent = trial.log_cost[at] - slopes @ d - current.peak
            again, weights, _ = minimax_step(bent - bent.max(), slopes, self.curvature, low, high)
            second, improved = self._try(again, predicted)
            if improved > gained:
                d, multipliers, trial, gained = again, weights, second, improved
        if gained > 0.01:
            self.multipliers[at] = multipliers
            self.last = (d, multipliers @ slopes)
            self.here = trial
            # a point with a multiplier shapes the step, however far below the peak it lies now
            self.working &= (trial.log_cost > trial.peak - _IDLE) | (self.multipliers > 0.0)
            if gained > 0.6:
                self.radius = min(1.0, 2.5 * self.radius)
            elif gained < 0.2:
                self.radius *= 0.5
            return
        # the step may have been shorter than the box: half of what was tried
        self.radius = 0.5 * min(self.radius, float(np.abs(d / reach).max()))
        self.finished = self.radius < _SMALLEST

    def _try(self, d: FloatArray, predicted: float) -> tuple[_Trial, float]:
        """(what stands at the end of a step, gain relative to the predicted one); minus infinity
        where a loop is unstable.
        """
        trial = _trial(self.loop, self.weights, self.structure, self.here.rho + self.scale * d)
        self.working |= _peaks(trial.log_cost, trial.peak)
        gained = (self.here.peak - trial.peak) / -predicted
        if gained > 0.0 and not self.loop.stabilised_by(*self.structure.polynomials(trial.rho)):
            return trial, -np.inf
        return trial, gained

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
    along, s_y = float(step @ bent), float(step @ change)
    share = 1.0 if s_y >= 0.2 * along else 0.8 * along / (along - s_y)
    change = share * change + (1.0 - share) * bent
    updated = (
        curvature - np.outer(bent, bent) / along + np.outer(change, change) / float(step @ change)
    )
    return np.asarray(updated + 1e-6 * np.eye(len(step)))


def _peaks(log_cost: FloatArray, highest: float) -> npt.NDArray[np.bool_]:
    """Local maxima along frequency within 20 % of the highest, with their neighbours, and the
    ends.
    """
    local = log_cost > highest - 0.22
    local[:, 1:] &= log_cost[:, 1:] >= log_cost[:, :-1]
    local[:, :-1] &= log_cost[:, :-1] >= log_cost[:, 1:]
    wide = local.copy()
    wide[:, 1:] |= local[:, :-1]
    wide[:, :-1] |= local[:, 1:]
    return wide


# First values of a controller for plants that the structure's usual ones do not stabilise:
# unstable and integrating plants.

_CROSSINGS = 12  # crossover frequencies that starts are scaled to
_DESCENTS = 6  # simplex searches from the best of them
_EVALUATIONS = 300  # of the closed-loop poles in each
_INSIDE = 1.0 - 1e-9  # modulus of a closed-loop pole that counts as stable


def stabilising_starts(
    loop: Loop, structure: ControllerStructure
) -> list[tuple[FloatArray, FloatArray]]:
    """Values that stabilise every plant, each with the typical sizes of the parameters; empty when
    none is found.

    The structure's starts are scaled to cross over at frequencies spread over the grid, with both
    signs of the gain, and the largest modulus of the closed-loop poles is lowered from the best of
    them by simplex search, a bounded number of times. Plants that are measured only have no poles
    to move: for them the list is empty.

    Notes
    -----
    The spectral radius is neither convex nor smooth: an empty list does not prove that no
    controller of the structure stabilises.
    """
    plants = [plant for plant in loop.plants if isinstance(plant, TransferFunction)]
    if len(plants) < len(loop.plants):
        return []

    def radius(rho: FloatArray) -> float:
        return _spectral_radius(plants, structure.transfer_function(rho))

    low, high = _box(structure)
    # scaled to a crossing, a start may leave the structure's bounds
    scaled = []
    for k in _crossings(loop):
        for rho, sizes in _scaled(loop, structure, k):
            scaled.append((np.clip(rho, low, high), sizes))
    ranked = sorted((radius(rho), n) for n, (rho, _) in enumerate(scaled))
    stable = [scaled[n] for modulus, n in ranked if modulus < _INSIDE]
    if stable:
        return stable
    lowered = [_lowered(radius, *scaled[n], low, high) for _, n in ranked[:_DESCENTS]]
    return [start for start in lowered if start is not None]


def _spectral_radius(plants: list[TransferFunction], controller: TransferFunction) -> float:
    """The largest modulus of a closed-loop pole of any plant."""
    poles = [np.roots(characteristic(plant, controller)) for plant in plants]
    return float(max(np.abs(of_plant).max(initial=0.0) for of_plant in poles))


def _box(structure: ControllerStructure) -> tuple[FloatArray, FloatArray]:
    low = [-np.inf if least is None else least for least, _ in structure.bounds()]
    return np.array(low), np.array(
        [np.inf if most is None else most for _, most in structure.bounds()]
    )


def _lowered(
    radius: Callable[[FloatArray], float],
    rho: FloatArray,
    sizes: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> tuple[FloatArray, FloatArray] | None:
    """The values that a simplex search from `rho` ends at, within the bounds; None where these do
    not stabilise either.
    """
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
    wanted = np.geomspace(
        max(loop.omega[0], 1e-4 * loop.omega[-1]),
        loop.omega[min(top, len(loop.omega) - 1)],
        _CROSSINGS,
    )
    return np.unique(np.minimum(np.searchsorted(loop.omega, wanted), len(loop.omega) - 1))


def _scaled(
    loop: Loop, structure: ControllerStructure, k: int
) -> list[tuple[FloatArray, FloatArray]]:
    """(values, sizes) for a crossover at the grid's frequency k, both signs."""
    gain = float(np.abs(loop.G[:, k]).mean())
    if gain == 0.0:
        return []
    slow = 1.0 / float(loop.omega[k])
    sizes = structure.sizes(gain, slow)
    starts = [(rho, sizes) for sign in (1.0, -1.0) for rho in structure.starts(sign * gain, slow)]
    return starts


_STEPS, _FIRST_STEPS = 80, 8  # of a descent, and before it is compared with the others
_STARTS = 4  # that are searched, of different signs of the parameters
_EXCHANGES = 3  # times that peaks between the grid's frequencies join it
_LEFT_BEHIND = 0.05  # in ln cost above the best: a descent that stands higher ends there
_GAP = 3e-5  # relative, between the peak on the grid and that on the finer one


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
        """From the closed-loop roots; computed when asked for, since most designs of a search are
        dropped for their cost.
        """
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

    min_ρ max_{G, ω} ‖[W_S S; W_T T; W_K K S]‖, written as min t subject to cost_k(ρ) ≤ t on a
    working set of peaks and solved by sequential quadratic programming with exact gradients; peaks
    that appear join the set. A step that leaves the set of stabilising controllers is cut back,
    which the cost itself demands, since S grows without bound at its border. Peaks that stand
    between two frequencies of the grid are found on one 20 times finer and added, until both agree.

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
    The problem is not convex: several starts are searched and the best kept; a global optimum is
    not certified.

    References
    ----------
    P. Apkarian, D. Noll, *Nonsmooth H∞ synthesis*, IEEE Trans. Autom. Control 51 (2006).
    """
    usable = _usable_starts(loop, structure, starts)
    descents = [Descent(loop, weights, structure, rho, sizes) for rho, sizes in usable]
    best = _search(_valleys(descents), target)
    for _ in range(_EXCHANGES):
        fine_cost = _fine_cost(loop, weights, structure, best.here.rho)
        # descents hold the logarithm of the cost
        enough = np.exp(best.here.peak) * (1.0 + _GAP)
        if target is not None:
            enough = max(target, enough)
        if fine_cost.max() <= enough:
            break
        loop, weights = _with_peaks(loop, weights, fine_cost)
        best = _search([Descent(loop, weights, structure, best.here.rho, best.sizes)], target)
    return _result(loop, weights, structure, best)


def _usable_starts(
    loop: Loop, structure: ControllerStructure, starts: Iterable[FloatArray] | None
) -> list[tuple[FloatArray, FloatArray]]:
    """First values that stabilise every plant, each with the typical sizes of the parameters."""
    sizes = structure.sizes(*loop.gain_and_time_constant)
    first = [*(default_starts(loop, structure) if starts is None else starts)]
    usable = [(rho, sizes) for rho in first if loop.stabilised_by(*structure.polynomials(rho))]
    if starts is None and (not usable or not loop.plants_are_stable):
        # a search of its own, kept with the loop: each design of a front asks for the same
        if structure not in loop.stabilising:
            loop.stabilising[structure] = stabilising_starts(loop, structure)
        usable += loop.stabilising[structure]
    if not usable:
        raise NoStabilisingStart(
            f"controller {structure.name!r}: none of {len(first)} first values stabilises the"
            " plant, nor any found by moving the closed-loop poles inwards; take a structure with"
            " more freedom"
        )
    return usable


def _search(descents: list[Descent], target: float | None) -> Descent:
    """Every descent begins; those that are not left far behind by the best go on to the end.

    Descents that come near to each other are not joined: two optima of one sign pattern can lie
    close, and differ by percents.
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
            best = min(best, descent, key=lambda candidate: candidate.here.peak)
    return best


def _valleys(descents: list[Descent]) -> list[Descent]:
    """The best start of each pattern of signs, four at most: starts of one pattern mostly end in
    the same valley.
    """
    best: dict[bytes, Descent] = {}
    for descent in sorted(descents, key=lambda descent: descent.here.peak):
        best.setdefault(np.sign(descent.here.rho).tobytes(), descent)
    return list(best.values())[:_STARTS]


def default_starts(loop: Loop, structure: ControllerStructure) -> list[FloatArray]:
    """The structure's first values for the plants' static gain and response time, and for five
    times slower and faster ones.
    """
    gain, slow = loop.gain_and_time_constant
    return [rho for scale in (1.0, 5.0, 0.2) for rho in structure.starts(gain, scale * slow)]


def _result(
    loop: Loop, weights: Weights, structure: ControllerStructure, best: Descent
) -> Synthesis:
    rho = best.here.rho
    controller = structure.transfer_function(rho)
    fine = _fine_cost(loop, weights, structure, rho)
    where = float(loop.finer[0].omega[int(np.argmax(fine))])
    cost = float(np.exp(best.here.peak))
    return Synthesis(structure, rho, controller, cost, float(fine.max()), where, loop)


def _fine_cost(
    loop: Loop, weights: Weights, structure: ControllerStructure, rho: FloatArray
) -> FloatArray:
    """The largest cost over the plants on the finer grid, shape (fine frequencies,)."""
    fine, position = loop.finer
    K = fine.controller_response(*structure.polynomials(rho))
    return np.asarray(fine.cost(K, weights.between(position)).max(axis=0))


def _with_peaks(loop: Loop, weights: Weights, fine_cost: FloatArray) -> tuple[Loop, Weights]:
    """The grid with the finer grid's peaks added, so that the next design sees them."""
    inner = fine_cost[1:-1]
    peaks = 1 + np.flatnonzero(
        (inner >= fine_cost[:-2]) & (inner >= fine_cost[2:]) & (inner > 0.9 * fine_cost.max())
    )
    position = loop.finer[1]
    points = np.union1d(np.searchsorted(position, np.arange(len(loop.omega))), peaks)
    return loop.part_of_finer(points), weights.between(position[points])
