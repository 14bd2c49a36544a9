"""A controller structure with some parameters held and others kept within limits."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar

import numpy as np

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.nearest_names import known_names

# Controllers of fixed structure: frequency response and its exact gradient by the parameters.


class ControllerStructure(ABC):
    """K(z, ρ) with a fixed number of parameters.

    `names` and `units` (of a dimensionless loop) describe ρ; `lower`, `upper` bound it.
    """

    name: ClassVar[str]
    equation: ClassVar[str]
    names: tuple[str, ...]

    def __init__(self, sample_time: float) -> None:
        if not sample_time > 0:
            raise BadInput(
                f"controller {self.name!r}, sample_time: {sample_time!r}; must be positive"
            )
        self.sample_time = sample_time

    @abstractmethod
    def response(self, rho: FloatArray, z: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """(K, ∂K/∂ρ) at z, shapes (k,) and (k, parameters)."""

    @abstractmethod
    def polynomials(self, rho: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(numerator, denominator) of K, descending powers of z."""

    def transfer_function(self, rho: FloatArray) -> TransferFunction:
        """K(z)."""
        return TransferFunction(*self.polynomials(rho), self.sample_time)

    @abstractmethod
    def bounds(self) -> list[tuple[float | None, float | None]]:
        """Bounds of ρ that keep K proper and causal."""

    @abstractmethod
    def starts(self, gain: float, time_constant: float) -> list[FloatArray]:
        """First values for a plant of static gain `gain` whose response takes about `time_constant`
        [s].
        """

    def sizes(self, gain: float, time_constant: float) -> FloatArray:
        """How large each parameter typically is for such a plant; ρ mixes units, so a search must
        not compare them.
        """
        sizes = np.abs(self.starts(gain, time_constant)).max(axis=0)
        return np.where(sizes > 0, sizes, 1.0)


class PI(ControllerStructure):
    """Proportional and integral."""

    name, equation, names = "pi", "k_p + k_i Ts/(z − 1)", ("k_p", "k_i")

    def response(self, rho: FloatArray, z: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """(K, ∂K/∂ρ)."""
        gradient = np.ones((len(z), 2), dtype=complex)
        gradient[:, 1] = self.sample_time / (z - 1)
        return np.asarray(gradient @ rho, dtype=complex), gradient

    def polynomials(self, rho: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(numerator, denominator)."""
        kp, ki = rho
        return np.array([kp, ki * self.sample_time - kp]), np.array([1.0, -1.0])

    def bounds(self) -> list[tuple[float | None, float | None]]:
        """None needed."""
        return [(None, None)] * 2

    def starts(self, gain: float, time_constant: float) -> list[FloatArray]:
        """Slow to brisk integral action."""
        return [
            np.array([p / gain, i / gain / time_constant])
            for p, i in ((0.0, 0.02), (0.05, 0.2), (0.3, 1.0))
        ]


class PID(ControllerStructure):
    """Proportional, integral and unfiltered derivative by the backward difference."""

    name, equation, names = (
        "pid",
        "k_p + k_i Ts/(z − 1) + k_d (z − 1)/(Ts z)",
        ("k_p", "k_i", "k_d"),
    )

    def response(self, rho: FloatArray, z: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """(K, ∂K/∂ρ)."""
        gradient = np.empty((len(z), 3), dtype=complex)
        gradient[:, 0] = 1.0
        gradient[:, 1] = self.sample_time / (z - 1)
        gradient[:, 2] = (1 - 1 / z) / self.sample_time
        return np.asarray(gradient @ rho, dtype=complex), gradient

    def polynomials(self, rho: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(numerator, denominator)."""
        kp, ki, kd = rho[0], rho[1] * self.sample_time, rho[2] / self.sample_time
        return np.array([kp + kd, ki - kp - 2 * kd, kd]), np.array([1.0, -1.0, 0.0])

    def bounds(self) -> list[tuple[float | None, float | None]]:
        """None needed."""
        return [(None, None)] * 3

    def starts(self, gain: float, time_constant: float) -> list[FloatArray]:
        """The PI starts with no and with some derivative action."""
        lead = 0.1 * abs(max(0.1 * time_constant, self.sample_time) / gain)
        return [
            np.r_[pair, d]
            for pair in PI(self.sample_time).starts(gain, time_constant)
            for d in (0.0, lead)
        ]


class PIDN(ControllerStructure):
    """Proportional, integral and filtered derivative, (2.39) of the source."""

    name, equation = "pidn", "k_p + k_i Ts/(z − 1) + k_d/(N_d + Ts/(z − 1))"
    names = ("k_p", "k_i", "k_d", "N_d")

    def response(self, rho: FloatArray, z: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """(K, ∂K/∂ρ)."""
        kd, nd = rho[2:]
        x = self.sample_time / (z - 1)
        derivative = 1.0 / (nd + x)
        gradient = np.empty((len(z), 4), dtype=complex)
        gradient[:, 0] = 1.0
        gradient[:, 1] = x
        gradient[:, 2] = derivative
        gradient[:, 3] = -kd * derivative * derivative
        return np.asarray(gradient[:, :3] @ rho[:3], dtype=complex), gradient

    def polynomials(self, rho: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(numerator, denominator): (z − 1)(z − p) below, p = 1 − Ts/N_d."""
        kp, ki, kd, p = (
            rho[0],
            rho[1] * self.sample_time,
            rho[2] / rho[3],
            1.0 - self.sample_time / rho[3],
        )
        num = np.array([kp + kd, ki - kp * (1.0 + p) - 2.0 * kd, (kp - ki) * p + kd])
        return num, np.array([1.0, -1.0 - p, p])

    def bounds(self) -> list[tuple[float | None, float | None]]:
        """N_d > Ts/2 keeps the pole 1 − Ts/N_d of the derivative's filter inside the unit
        circle.
        """
        return [
            (None, None),
            (None, None),
            (None, None),
            # At 0.55 Ts the pole lies at −0.82, clear of −1.
            (0.55 * self.sample_time, 1e4 * self.sample_time),
        ]

    def starts(self, gain: float, time_constant: float) -> list[FloatArray]:
        """The PI starts with no and with some derivative action, a zero on the plant's pole at two
        crossovers, and integrators rolled off: k_i/(s(1 + N_d s)).
        """
        filters = max(0.1 * time_constant, self.sample_time)
        pairs = PI(self.sample_time).starts(gain, time_constant)
        candidates = [
            np.r_[pair, d * abs(filters / gain), filters] for pair in pairs for d in (0.0, 0.1)
        ]
        # The cost of this structure has two valleys. Of 80 random designs 22 ended in the dearer
        # one, by up to 9 %, without these zeros on the plant's pole; with them 2, by up to 1.6 %.
        candidates += [
            np.array([loop / gain, loop / gain / time_constant, 0.0, filters])
            for loop in (2.0, 10.0)
        ]
        for _, ki in pairs:
            lag = max(0.3 / abs(ki * gain), self.sample_time)
            # With x = Ts/(z − 1) these values are k_i x · x/(N + x), N the lag: an integrator
            # behind a first-order lag.
            candidates.append(np.array([-ki * lag, ki, ki * lag**2, lag]))
        return candidates


class LeadLag(ControllerStructure):
    """One lead or lag section, without integral action."""

    name, equation, names = "lead-lag", "k (z − c)/(z − p)", ("k", "c", "p")

    def response(self, rho: FloatArray, z: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """(K, ∂K/∂ρ)."""
        k, c, p = rho
        shape = (z - c) / (z - p)
        return np.asarray(k * shape), np.stack([shape, -k / (z - p), k * shape / (z - p)], axis=1)

    def polynomials(self, rho: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(numerator, denominator)."""
        k, c, p = rho
        return np.array([k, -k * c]), np.array([1.0, -p])

    def bounds(self) -> list[tuple[float | None, float | None]]:
        """Zero and pole inside the unit circle, on the side of slow dynamics."""
        return [(None, None), (0.0, 1.0 - 1e-9), (0.0, 1.0 - 1e-9)]

    def starts(self, gain: float, time_constant: float) -> list[FloatArray]:
        """Proportional control with a slow lag, and with a fast lead."""
        slow = np.exp(-self.sample_time / time_constant)
        return [
            np.array([size / gain, c, p])
            for size in (0.1, 1.0)
            for c, p in ((slow**3, slow), (slow, slow**5))
        ]


class Rational(ControllerStructure):
    """Numerator and denominator of free coefficients, with an integrator when asked.

    Parameters
    ----------
    order : int
        Degree of the denominator, the integrator's included, 1 to 20.
    numerator : int or None
        Degree of the numerator, at most `order`; None: `order`.
    """

    name, equation = "rational", "(b₀ zᵏ + …)/((z − 1)(zᵐ + a₁ zᵐ⁻¹ + …))"

    def __init__(
        self,
        sample_time: float,
        *,
        order: int = 2,
        numerator: int | None = None,
        integrator: bool = True,
    ) -> None:
        super().__init__(sample_time)
        degree = order if numerator is None else numerator
        if not 1 <= order <= 20:
            raise BadInput(f"controller 'rational', order: is {order}; must be from 1 to 20")
        if not 0 <= degree <= order:
            raise BadInput(
                f"controller 'rational', numerator: is {degree}; must be from 0 to the order,"
                f" {order}"
            )
        self.integrator = integrator
        self.above, self.below = degree + 1, order - int(integrator)
        self.names = tuple(
            [f"b_{k}" for k in range(self.above)] + [f"a_{k + 1}" for k in range(self.below)]
        )

    def response(self, rho: FloatArray, z: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """(K, ∂K/∂ρ)."""
        q = self.above
        powers = np.vander(z, q)
        free = np.polyval(np.r_[1.0, rho[q:]], z)
        den = free * ((z - 1) if self.integrator else 1.0)
        K = powers @ rho[:q] / den
        by_den = -K[:, None] * np.vander(z, self.below + 1)[:, 1:] / free[:, None]
        return np.asarray(K), np.hstack([powers / den[:, None], by_den])

    def polynomials(self, rho: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(numerator, denominator)."""
        den = np.r_[1.0, rho[self.above :]]
        return rho[: self.above], np.convolve(den, [1.0, -1.0]) if self.integrator else den

    def bounds(self) -> list[tuple[float | None, float | None]]:
        """None; stability of the loop is checked as a whole."""
        return [(None, None)] * len(self.names)

    def starts(self, gain: float, time_constant: float) -> list[FloatArray]:
        """PI controllers written in this form, the other poles at zero; integrators alone when the
        numerator is a constant.
        """
        candidates = []
        for kp, ki in PI(self.sample_time).starts(gain, time_constant):
            leading = (
                (kp, ki * self.sample_time - kp)
                if self.integrator
                else (kp + ki * time_constant, 0.0)
            )
            rho = np.zeros(len(self.names))
            rho[: min(2, self.above)] = leading if self.above > 1 else sum(leading)
            candidates.append(rho)
        return candidates

    def sizes(self, gain: float, time_constant: float) -> FloatArray:
        """The largest numerator coefficient of the starts for all of them, 1 for the
        denominator's.
        """
        return np.r_[
            np.full(self.above, np.abs(self.starts(gain, time_constant)).max()), np.ones(self.below)
        ]


# Pareto front of two wishes when asking less of the second one always stays feasible.

Design = TypeVar("Design")


@dataclass(frozen=True)
class Point(Generic[Design]):
    """A feasible pair on the front, with the design that meets it."""

    first: float
    second: float
    design: Design


def bisected_front(
    firsts: Sequence[float],
    seconds: Sequence[float],
    meets: Callable[[float, float, Design | None], Design | None],
) -> list[Point[Design]]:
    """The front over a grid of two wishes, each ordered from modest to ambitious.

    For each value of the first wish the most ambitious second one is found by bisection, about
    log₂(len(seconds)) designs; dominated points are then left out. `meets(first, second, warm)`
    gives a design or None; `warm` is a design that met a neighbouring pair.

    >>> found = bisected_front([1, 2, 3], [1, 2, 3, 4], lambda a, b, _: (a, b) if a * b <= 4 else None)
    >>> [(point.first, point.second) for point in found]
    [(1, 4), (2, 2), (3, 1)]
    """
    front: list[tuple[int, Point[Design]]] = []
    warm: Design | None = None
    for first in firsts:
        low, high = 0, len(seconds) - 1
        best: tuple[int, Design] | None = None
        while low <= high:
            middle = (low + high) // 2
            design = meets(first, seconds[middle], warm)
            if design is None:
                high = middle - 1
            else:
                # The next pair is a neighbour, whose search begins at this controller.
                best, warm = (middle, design), design
                low = middle + 1
        if best is not None:
            front.append((best[0], Point(first, seconds[best[0]], best[1])))
    return [
        point
        for k, (rank, point) in enumerate(front)
        # A point is no part of the front where a more ambitious first wish leaves as much of the
        # second.
        if all(later < rank for later, _ in front[k + 1 :])
    ]


def preferred(
    front: Sequence[Point[Design]],
    ideal: tuple[float, float],
    span: tuple[float, float],
    only: int | None,
) -> Point[Design]:
    """The nearest point, or the best in one wish alone and, among equals, in the other: the
    single-objective form of Remark 2.7.

    Parameters
    ----------
    only : int or None
        0 or 1: the wish that counts; None: both.
    """
    if only is None:
        return closest(front, ideal, span)
    values = [(point.first, point.second) for point in front]
    distances = [
        tuple(abs(value[k] - ideal[k]) / span[k] for k in (only, 1 - only)) for value in values
    ]
    return front[min(range(len(front)), key=distances.__getitem__)]


def closest(
    front: Sequence[Point[Design]], ideal: tuple[float, float], span: tuple[float, float]
) -> Point[Design]:
    """The point nearest to the ideal pair, each wish measured in its span."""
    distances = [
        np.hypot((p.first - ideal[0]) / span[0], (p.second - ideal[1]) / span[1]) for p in front
    ]
    return front[int(np.argmin(distances))]


class Constrained(ControllerStructure):
    """K(z, ρ) of another structure whose parameters are partly fixed or limited; ρ holds the free
    ones only.

    Parameters
    ----------
    structure : ControllerStructure
    fixed : mapping
        Name → value.
    within : mapping
        Name → (lower, upper), infinite where there is none; narrower than the structure's own
        bounds or equal.

    Raises
    ------
    BadInput
        Unknown name, nothing left free, lower not below upper, a value outside the structure's
        bounds.

    Examples
    --------
    >>> from residuum.robust_control.synthesis.constrained_structure import PIDN
    >>> pi = Constrained(PIDN(0.1), fixed={"k_d": 0.0, "N_d": 0.5}, within={"k_i": (0.0, 2.0)})
    >>> pi.names, pi.bounds()
    (('k_p', 'k_i'), [(None, None), (0.0, 2.0)])
    """

    def __init__(
        self,
        structure: ControllerStructure,
        *,
        fixed: Mapping[str, float] | None = None,
        within: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        super().__init__(structure.sample_time)
        self.structure, self.fixed, self.within = structure, dict(fixed or {}), dict(within or {})
        self.name, self.equation = structure.name, structure.equation  # type: ignore[misc]  # those of the whole
        if unknown := [name for name in (*self.fixed, *self.within) if name not in structure.names]:
            raise BadInput(
                f"controller {self.name!r}: has no parameter {unknown[0]!r};"
                f" {known_names(unknown[0], structure.names, 'it has')}"
            )
        self.free = np.array([name not in self.fixed for name in structure.names])
        if not self.free.any():
            raise BadInput(
                f"controller {self.name!r}: every parameter is fixed; at least one must be free"
            )
        self.names = tuple(name for name in structure.names if name not in self.fixed)
        self._whole = np.array([self.fixed.get(name, 0.0) for name in structure.names], dtype=float)
        self._bounds = [
            _narrowed(self.name, name, own, self.within.get(name), self.fixed.get(name))
            for name, own in zip(structure.names, structure.bounds(), strict=True)
        ]

    def whole(self, rho: FloatArray) -> FloatArray:
        """Every parameter of the structure, the fixed ones included."""
        values = self._whole.copy()
        values[self.free] = rho
        return values

    def response(self, rho: FloatArray, z: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """(K, ∂K/∂ρ)."""
        K, dK = self.structure.response(self.whole(rho), z)
        return K, dK[:, self.free]

    def polynomials(self, rho: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(numerator, denominator)."""
        return self.structure.polynomials(self.whole(rho))

    def bounds(self) -> list[tuple[float | None, float | None]]:
        """Of the free parameters."""
        return [bound for bound, free in zip(self._bounds, self.free, strict=True) if free]

    def starts(self, gain: float, time_constant: float) -> list[FloatArray]:
        """The structure's own first values, moved to the nearest value allowed."""
        low = np.array([-np.inf if bound[0] is None else bound[0] for bound in self.bounds()])
        high = np.array([np.inf if bound[1] is None else bound[1] for bound in self.bounds()])
        return [
            np.clip(rho[self.free], low, high) for rho in self.structure.starts(gain, time_constant)
        ]

    def sizes(self, gain: float, time_constant: float) -> FloatArray:
        """Of the free parameters."""
        return np.asarray(self.structure.sizes(gain, time_constant)[self.free])


def _narrowed(
    controller: str,
    name: str,
    own: tuple[float | None, float | None],
    limits: tuple[float, float] | None,
    value: float | None,
) -> tuple[float | None, float | None]:
    low = -math.inf if own[0] is None else own[0]
    high = math.inf if own[1] is None else own[1]
    if value is not None and not (low <= value <= high and math.isfinite(value)):
        raise BadInput(
            f"controller {controller!r}, {name}: is fixed at {value:g}; must lie within [{low:g},"
            f" {high:g}]"
        )
    if limits is not None:
        low, high = max(low, limits[0]), min(high, limits[1])
        if not low < high:
            raise BadInput(
                f"controller {controller!r}, {name}: limits leave [{low:g}, {high:g}]; lower must"
                " be below upper"
            )
    return (None if math.isinf(low) else low, None if math.isinf(high) else high)
