"""A controller structure with some parameters held and others kept within limits."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names
from residuum.robust_control.synthesis.controller_structure import ControllerStructure


class Constrained(ControllerStructure):
    """K(z, ρ) of another structure whose parameters are partly fixed or limited; ρ holds the free ones only.

    Parameters
    ----------
    structure : ControllerStructure
    fixed : mapping
        Name → value.
    within : mapping
        Name → (lower, upper), infinite where there is none; narrower than the structure's own bounds or equal.

    Raises
    ------
    BadInput
        Unknown name, nothing left free, lower not below upper, a value outside the structure's bounds.

    Examples
    --------
    >>> from residuum.robust_control.synthesis.controller_structure import PIDN
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
                f"controller {self.name!r}: has no parameter {unknown[0]!r}; {known_names(unknown[0], structure.names, 'it has')}"
            )
        self.free = np.array([name not in self.fixed for name in structure.names])
        if not self.free.any():
            raise BadInput(f"controller {self.name!r}: every parameter is fixed; at least one must be free")
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
        return [np.clip(rho[self.free], low, high) for rho in self.structure.starts(gain, time_constant)]

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
        raise BadInput(f"controller {controller!r}, {name}: is fixed at {value:g}; must lie within [{low:g}, {high:g}]")
    if limits is not None:
        low, high = max(low, limits[0]), min(high, limits[1])
        if not low < high:
            raise BadInput(f"controller {controller!r}, {name}: limits leave [{low:g}, {high:g}]; lower must be below upper")
    return (None if math.isinf(low) else low, None if math.isinf(high) else high)
