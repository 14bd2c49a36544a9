"""The mixed-sensitivity cost of a loop on a frequency grid, with its gradient, and the stability of
the loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.blas_threads import LARGEST_FOR_ONE_THREAD, one_thread_if_small
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.schur import is_schur
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.weights.weighted_cost import (
    rational_response,
    weighted_cost,
    weighted_slopes,
)

# A plant that is known only by its measured frequency response, and the stability of its loop by
# Nyquist's criterion.

_LONGEST_TURN = 0.5 * np.pi  # [rad] of 1 + L between two frequencies: more is ambiguous
_FURTHEST_FROM_AXIS = np.pi / 4  # [rad] of 1 + L at the ends of the grid from its asymptote
_AROUND_A_PEAK = np.array([-4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0])  # half widths


@dataclass(frozen=True, eq=False)
class MeasuredPlant:
    """G(e^{jωTs}) at measured frequencies, taken as it is.

    Parameters
    ----------
    omega : array, shape (k,)
        [rad/s], increasing, within (0, π/Ts].
    response : array, shape (k,)
    sample_time : float
        [s]
    unstable_poles, integrators : int
        Poles of the plant outside the unit circle, and at z = 1; data alone do not tell them.

    Raises
    ------
    BadInput
        Shapes differ, values are not finite, frequencies do not increase within (0, π/Ts], counts
        are negative.
    """

    omega: FloatArray
    response: ComplexArray
    sample_time: float
    unstable_poles: int = 0
    integrators: int = 0

    def __post_init__(self) -> None:
        omega = np.asarray(self.omega, dtype=float)
        response = np.asarray(self.response, dtype=complex)
        if omega.ndim != 1 or len(omega) < 2 or response.shape != omega.shape:
            raise BadInput(
                f"MeasuredPlant: {omega.shape} frequencies and {response.shape} values; needs two"
                " or more of each"
            )
        if not (np.isfinite(omega).all() and np.isfinite(response).all()):
            raise BadInput("MeasuredPlant: a frequency or a value is not finite")
        if not self.sample_time > 0:
            raise BadInput(f"MeasuredPlant, sample_time: is {self.sample_time!r}; must be positive")
        nyquist = np.pi / self.sample_time
        if not (np.diff(omega, prepend=0.0) > 0).all() or omega[-1] > nyquist * (1 + 1e-9):
            raise BadInput(
                f"MeasuredPlant, omega: must increase within 0 … π/Ts = {nyquist:.6g} rad/s"
            )
        if min(self.unstable_poles, self.integrators) < 0:
            raise BadInput("MeasuredPlant: numbers of poles must not be negative")
        object.__setattr__(self, "omega", omega)
        object.__setattr__(self, "response", response)

    def frequency_response(self, omega: npt.ArrayLike) -> ComplexArray:
        """Values between the measured ones, linear in ln ω; none outside them (BadInput)."""
        omega = np.asarray(omega, dtype=float)
        if np.any(omega < self.omega[0] * (1 - 1e-9)) or np.any(
            omega > self.omega[-1] * (1 + 1e-9)
        ):
            raise BadInput(
                f"MeasuredPlant: measured from {self.omega[0]:.6g} to {self.omega[-1]:.6g} rad/s"
                " only"
            )
        at, known = np.log(omega), np.log(self.omega)
        return np.interp(at, known, self.response.real) + 1j * np.interp(
            at, known, self.response.imag
        )


def closed_loop_unstable_poles(
    L: ComplexArray, unstable_poles: int, integrators: int
) -> int | None:
    """Poles of the closed loop outside the unit circle, from the turns of 1 + L about zero; None
    when the data do not tell.

    With the path past z = 1 on its outside, 1 + L turns P − Z times about zero as z goes once round
    the unit circle: Z and P are the poles of the closed and of the open loop outside. Half the path
    is measured; each integrator adds −½ turn at z = 1.

    Parameters
    ----------
    L : array, shape (k,)
        Open loop on increasing frequencies from well below the loop's bandwidth to (near) the
        Nyquist frequency.
    unstable_poles, integrators : int
        Of the open loop: outside the circle, and at z = 1.

    Notes
    -----
    None when 1 + L turns by more than 90° from one frequency to the next (the grid is too coarse to
    count), or is more than 45° from its asymptote at the ends (the grid ends too early). A
    resonance that stands between two frequencies cannot be seen.

    Examples
    --------
    >>> z = np.exp(1j * np.geomspace(1e-3, np.pi, 400))
    >>> [closed_loop_unstable_poles(gain / (z - 1.0), 0, 1) for gain in (0.5, 3.0)]
    [0, 1]
    """
    distance = 1.0 + L
    if not np.all(np.abs(distance) > 0):
        return None
    turns = np.angle(distance[1:] / distance[:-1])
    if np.abs(turns).max() > _LONGEST_TURN:
        return None
    # to the axis of the integrators' asymptote below the first frequency, to the real axis above
    # the last one
    before = _from_axis(np.angle(distance[0]) + 0.5 * np.pi * integrators)
    after = _from_axis(np.angle(distance[-1]))
    if max(abs(before), abs(after)) > _FURTHEST_FROM_AXIS:
        return None
    winding = (turns.sum() + before - after) / np.pi - 0.5 * integrators
    outside = int(np.round(unstable_poles - winding))
    return outside if outside >= 0 else None


def _from_axis(angle: float) -> float:
    """The angle from the nearest multiple of 180°."""
    return float(angle - np.pi * np.round(angle / np.pi))


# A weighted loop in state space, kept as a chain of small blocks so that long impulse responses
# stay well conditioned.


def interconnect(
    blocks: Sequence[StateSpace], between: FloatArray, external: FloatArray, outputs: FloatArray
) -> StateSpace:
    """Blocks side by side with inputs v and outputs w, joined by v = `between` w + `external` r, z
    = `outputs` w.

    The states stay those of the blocks, so no polynomials are multiplied out.

    Raises
    ------
    BadInput
        The loop without delay has gain 1 (I − F D is singular): it has no solution.
    """
    A, B, C, D = (block_diag(*[getattr(block, name) for block in blocks]) for name in "ABCD")
    direct = np.eye(len(between)) - between @ D  # I − F D
    if abs(np.linalg.det(direct)) < 1e-12:
        raise BadInput("state space: the loop is not well posed; its direct feedthrough equals −1")
    # v = (I − F D)⁻¹ (F C x + E r), from v = F w + E r and w = C x + D v
    from_states = np.linalg.solve(direct, between @ C)
    from_input = np.linalg.solve(direct, external)
    C, D = outputs @ (C + D @ from_states), outputs @ D @ from_input
    return StateSpace(A + B @ from_states, B @ from_input, C, D, blocks[0].sample_time)


def weighted_loop(
    plant: TransferFunction,
    controller: TransferFunction,
    W_S: TransferFunction | None = None,
    W_T: TransferFunction | None = None,
    W_K: TransferFunction | None = None,
) -> StateSpace:
    """From the reference to [W_S S; W_T T; W_K K S], the rows whose weight is given.

    Raises BadInput when no weight is given, or for unequal sample times.
    """
    weights = [weight for weight in (W_S, W_T, W_K) if weight is not None]
    if not weights or len({system.sample_time for system in (plant, controller, *weights)}) != 1:
        raise BadInput(
            "weighted loop: needs a weight, and one sample time for plant, controller and weights"
        )
    blocks = [StateSpace.from_transfer_function(system) for system in (controller, plant, *weights)]
    n = len(blocks)
    between, external = np.zeros((n, n)), np.zeros((n, 1))
    between[0, 1], external[0] = -1.0, 1.0  # K is driven by e = r − y
    between[1, 0] = 1.0
    row = 2
    if W_S is not None:
        between[row, 1], external[row] = -1.0, 1.0
        row += 1
    if W_T is not None:
        between[row, 1] = 1.0
        row += 1
    if W_K is not None:
        between[row, 0] = 1.0
    return interconnect(blocks, between, external, np.eye(n)[2:])


Plant = TransferFunction | MeasuredPlant


@dataclass(frozen=True, eq=False)
class Weights:
    """|W_S|, |W_T| and, when the control effort counts, |W_K| on the grid, shape (k,); the cost
    needs no more than magnitudes.

    `entries` is the norm taken across the entries at each frequency: "2" for ‖[W_S S; W_T T; W_K K
    S]‖∞ (2.1), "1" for
    |W_S S| + |W_T T| (+ |W_K K S|), which is the robust-performance condition (2.33), (2.37b).
    """

    W_S: FloatArray
    W_T: FloatArray
    entries: str = "2"
    W_K: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.entries not in ("1", "2"):
            raise BadInput(f"Weights, entries: is {self.entries!r}; must be '1' or '2'")
        for name in ("W_S", "W_T") if self.W_K is None else ("W_S", "W_T", "W_K"):
            values = np.abs(np.asarray(getattr(self, name)))
            if values.ndim != 1 or not np.isfinite(values).all():
                raise BadInput(f"Weights, {name}: must be finite magnitudes on the grid")
            object.__setattr__(self, name, values)

    def between(self, position: FloatArray) -> Weights:
        """The weights at positions between the points of the grid, linear in the logarithms."""
        steps = np.arange(len(self.W_S))

        def at(magnitude: FloatArray) -> FloatArray:
            return np.asarray(
                np.exp(np.interp(position, steps, np.log(np.maximum(magnitude, 1e-300))))
            )

        return Weights(
            at(self.W_S), at(self.W_T), self.entries, None if self.W_K is None else at(self.W_K)
        )


class Loop:
    """One or more plants under one controller.

    Parameters
    ----------
    plants : sequence of TransferFunction or MeasuredPlant
        Discrete-time, one sample time.
    omega : array, shape (k,)
        Frequencies [rad/s], increasing, up to π/Ts.

    Raises
    ------
    BadInput
        No plant, continuous time, different sample times, a grid beyond Nyquist.
    """

    def __init__(self, plants: Sequence[Plant], omega: npt.ArrayLike) -> None:
        if not plants:
            raise BadInput("Loop, plants: none was given")
        steps = {plant.sample_time for plant in plants}
        if len(steps) != 1 or None in steps:
            raise BadInput(
                f"Loop, plants: have sample times {sorted(map(str, steps))}; all must be"
                " discrete-time and equal"
            )
        self.plants = tuple(plants)
        self.sample_time = float(plants[0].sample_time or 0.0)
        self.omega = np.asarray(omega, dtype=float)
        if (
            self.omega.ndim != 1
            or np.any(np.diff(self.omega) <= 0)
            or self.omega[-1] > np.pi / self.sample_time * (1 + 1e-9)
        ):
            raise BadInput(
                f"Loop, omega: must increase up to at most π/Ts = {np.pi / self.sample_time:.6g}"
                " rad/s"
            )
        self.z = np.exp(1j * self.omega * self.sample_time)
        # per structure, once found
        self.stabilising: dict[object, list[tuple[FloatArray, FloatArray]]] = {}
        self.G = np.array([plant.frequency_response(self.omega) for plant in plants])

    def part_of_finer(self, points: npt.NDArray[np.intp]) -> Loop:
        """The loop on some points of its finer grid; nothing is computed anew, and it refines to
        the same grid.
        """
        fine, position = self.finer
        # not by the constructor, which computes the plants' responses
        part = object.__new__(Loop)
        part.plants, part.sample_time = self.plants, self.sample_time
        part.stabilising = self.stabilising
        part.omega, part.z, part.G = fine.omega[points], fine.z[points], fine.G[:, points]
        part.__dict__["finer"] = (
            fine,
            np.interp(position, position[points], np.arange(len(points))),
        )
        return part

    @cached_property
    def finer(self) -> tuple[Loop, FloatArray]:
        """(the loop on a grid 20 times as fine, positions of its points in this grid)."""
        steps = np.arange(len(self.omega))
        position = np.linspace(0, steps[-1], 20 * int(steps[-1]) + 1)
        omega = np.exp(np.interp(position, steps, np.log(self.omega)))
        omega[-1] = self.omega[-1]  # rounding could put it beyond the Nyquist frequency
        return Loop(self.plants, omega), position

    @cached_property
    def plants_are_stable(self) -> bool:
        """Whether no plant has a pole on or outside the unit circle; measured plants as they were
        declared.
        """
        return all(
            (
                plant.unstable_poles == plant.integrators == 0
                if isinstance(plant, MeasuredPlant)
                else bool(np.abs(plant.poles).max(initial=0.0) < 1.0 - 1e-9)
            )
            for plant in self.plants
        )

    @cached_property
    def gain_and_time_constant(self) -> tuple[float, float]:
        """Mean static gain, and the time constant [s] of the slowest half-power frequency of the
        plants.
        """
        gain = float(np.mean(self.G[:, 0].real)) or 1.0
        below = np.abs(self.G) < np.abs(self.G[:, :1]) / np.sqrt(2)
        corner = [self.omega[np.argmax(row)] if row.any() else self.omega[-1] for row in below]
        return gain, 1.0 / float(min(corner))

    def controller_response(self, num: FloatArray, den: FloatArray) -> ComplexArray:
        """K = num/den (descending powers of z) on the grid."""
        return np.asarray(
            rational_response(np.asarray(num, dtype=float), np.asarray(den, dtype=float), self.z)
        )

    def cost(self, K: ComplexArray, weights: Weights) -> FloatArray:
        """The weighted cost at every plant and frequency, shape (plants, k)."""
        effort = np.zeros(len(K)) if weights.W_K is None else weights.W_K
        return np.asarray(
            weighted_cost(self.G, K, weights.W_S, weights.W_T, effort, weights.entries == "1")
        )

    def slopes(
        self,
        K: ComplexArray,
        dK: ComplexArray,
        weights: Weights,
        at: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]],
    ) -> tuple[FloatArray, FloatArray]:
        """(cost, ∂cost/∂ρ) at chosen (plant, frequency) pairs, shapes (c,) and (c, parameters),
        from K and ∂K/∂ρ there.
        """
        plant, k = at
        effort = np.zeros(len(k)) if weights.W_K is None else weights.W_K[k]
        value, slope = weighted_slopes(
            self.G[plant, k], K, dK, weights.W_S[k], weights.W_T[k], effort, weights.entries == "1"
        )
        return np.asarray(value), np.asarray(slope)

    def is_stable(self, controller: TransferFunction) -> bool:
        """Whether every closed loop has all its poles inside the unit circle (no hidden
        cancellation allowed).
        """
        return self.stabilised_by(controller.num, controller.den)

    def stabilised_by(self, num: FloatArray, den: FloatArray) -> bool:
        """The same for the controller num/den (descending powers of z): Schur–Cohn; measured plants
        by Nyquist.
        """
        return all(
            (
                self._turns_right(k, num, den)
                if isinstance(plant, MeasuredPlant)
                else is_schur(_sum(np.convolve(plant.den, den), np.convolve(plant.num, num)))
            )
            for k, plant in enumerate(self.plants)
        )

    @one_thread_if_small(LARGEST_FOR_ONE_THREAD)
    def is_certainly_stable(self, controller: TransferFunction) -> bool:
        """The same from the closed-loop roots themselves, for the final word; measured plants by
        Nyquist's criterion.
        """
        return all(
            (
                self._turns_right(k, controller.num, controller.den)
                if isinstance(plant, MeasuredPlant)
                else bool(np.all(np.abs(np.roots(characteristic(plant, controller))) < 1.0))
            )
            for k, plant in enumerate(self.plants)
        )

    def _turns_right(self, k: int, num: FloatArray, den: FloatArray) -> bool:
        plant = self.plants[k]
        if not isinstance(plant, MeasuredPlant):
            raise TypeError("only a measured plant is judged by Nyquist's criterion")
        poles = np.roots(den)
        integrators = int(np.sum(np.abs(poles - 1.0) < 1e-6))
        # an integrator that rounding puts outside the circle is counted once, as an integrator
        largest = 1.0 + 1e-6 if integrators else 1.0
        outside = int(np.sum(np.abs(poles) > largest))
        L = self.G[k] * self.controller_response(num, den)
        unstable = closed_loop_unstable_poles(
            L, plant.unstable_poles + outside, plant.integrators + integrators
        )
        return unstable == 0


def frequency_grid(
    plants: Sequence[Plant], *, points: int = 600, lowest: float | None = None
) -> FloatArray:
    """Frequencies [rad/s] for a design: logarithmic up to π/Ts, and dense about every lightly
    damped pole and zero.

    Between two points of an even grid a resonance can hide whose peak decides the norm. When plants
    were measured, their common frequencies are the grid.
    """
    measured = [plant for plant in plants if isinstance(plant, MeasuredPlant)]
    if measured:
        return _common_frequencies(measured)
    sample_time = float(plants[0].sample_time or 0.0)
    nyquist = np.pi / sample_time
    if lowest is None:
        lowest = nyquist / 10**5.5
    grids = [np.geomspace(lowest, nyquist, points)]
    for plant in plants:
        if isinstance(plant, TransferFunction):
            grids += _about_resonances(plant, sample_time)
    whole = np.unique(np.concatenate(grids))
    return np.asarray(whole[(whole >= grids[0][0]) & (whole <= nyquist)])


def _common_frequencies(measured: Sequence[MeasuredPlant]) -> FloatArray:
    """All frequencies [rad/s] at which any plant was measured, within the span of every one."""
    grid = np.unique(np.concatenate([plant.omega for plant in measured]))
    low = max(plant.omega[0] for plant in measured)
    high = min(plant.omega[-1] for plant in measured)
    return np.asarray(grid[(grid >= low) & (grid <= high)])


def _about_resonances(plant: TransferFunction, sample_time: float) -> list[FloatArray]:
    """Frequencies [rad/s] about every lightly damped pole and zero, spaced by its half width.

    A root r = e^{sTs} stands for s with Im s = ∠r/Ts and |Re s| = |ln|r||/Ts, the half width of its
    peak; one on the unit circle itself is taken as a millionth of the band wide.
    """
    nyquist = np.pi / sample_time
    grids = []
    for root in np.concatenate([plant.poles, plant.zeros]):
        if root.imag > 0 and 0.9 < abs(root) < 1.1:
            centre = np.angle(root) / sample_time
            width = abs(np.log(abs(root))) / sample_time + 1e-6 * nyquist
            grids.append(centre + width * _AROUND_A_PEAK)
    return grids


def characteristic(plant: TransferFunction, controller: TransferFunction) -> FloatArray:
    """Closed-loop characteristic polynomial den_G den_K + num_G num_K."""
    return _sum(np.convolve(plant.den, controller.den), np.convolve(plant.num, controller.num))


def _sum(a: FloatArray, b: FloatArray) -> FloatArray:
    """Of two polynomials, descending powers."""
    long, short = (a, b) if len(a) >= len(b) else (b, a)
    total = long.astype(float)
    total[len(long) - len(short) :] += short
    return total
