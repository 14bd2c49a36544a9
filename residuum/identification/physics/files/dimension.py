"""Dimensions of expressions: every sum must add like to like, in one scale, or the model file is
refused.

A dimension is the product of base units to rational powers together with the scale to SI (kJ is
1000 J), so that adding mV to V is refused as surely as adding V to A. Numbers in an equation are
taken in the units that the file declares; nothing is rescaled behind the user's back. A bare number
takes the dimension of what it is added to or compared with (`T + 273.15`, `max(h, 0)`); `%` counts
as a plain number.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

from residuum.identification.physics.files.expression import (
    COMPARISONS,
    Call,
    Name,
    Node,
    Number,
    Operation,
    folded,
)
from residuum.identification.units import is_own, parse_unit

_PLAIN = {"%", "percent"}
_OFFSET = {"°C": "K", "degC": "K", "C": "K", "°F": "delta_degF"}


@dataclass(frozen=True)
class Dimension:
    """Base units with exponents, and the factor to SI; `literal` marks a bare number, which fits
    anywhere.
    """

    exponents: tuple[tuple[str, Fraction], ...] = ()
    scale: float = 1.0
    literal: bool = False

    def __mul__(self, other: Dimension) -> Dimension:
        powers = dict(self.exponents)
        for base, exponent in other.exponents:
            powers[base] = powers.get(base, Fraction(0)) + exponent
        return Dimension(_sorted(powers), self.scale * other.scale, self.literal and other.literal)

    def __pow__(self, exponent: Fraction) -> Dimension:
        return Dimension(
            _sorted({b: e * exponent for b, e in self.exponents}),
            self.scale ** float(exponent),
            self.literal,
        )

    def __truediv__(self, other: Dimension) -> Dimension:
        return self * other ** Fraction(-1)

    def agrees(self, other: Dimension) -> bool:
        """Same base units and same scale (a bare number agrees with everything).

        A word that nobody knows counts things, as a radian does: `ticks` may stand where nothing
        does (kg·m²·ticks/s² beside N·m), but not where another word stands.
        """
        if self.literal or other.literal:
            return True
        mine = dict(self.exponents)
        theirs = dict(other.exponents)
        odd = {base for base in {*mine, *theirs} if mine.get(base) != theirs.get(base)}
        counted = not odd or (all(map(is_own, odd)) and not (odd & {*mine} and odd & {*theirs}))
        return counted and math.isclose(self.scale, other.scale, rel_tol=1e-9)

    def __str__(self) -> str:
        bases = "·".join(base if e == 1 else f"{base}^{e}" for base, e in self.exponents) or "1"
        return bases if math.isclose(self.scale, 1.0, rel_tol=1e-9) else f"{self.scale:g} {bases}"


PLAIN = Dimension()
LITERAL = Dimension(literal=True)
_SECOND = "s"


@lru_cache(maxsize=1024)
def dimension_of_unit(unit: str) -> Dimension:
    """The dimension of a unit; absolute temperatures count as differences.

    >>> dimension_of_unit("kJ") / dimension_of_unit("kW") == dimension_of_unit("s")
    True
    """
    if unit.strip() in _PLAIN:
        return PLAIN
    spelled = unit.replace("percent", "1").replace("%", "1")
    parsed = parse_unit(_OFFSET.get(spelled.strip(), spelled))
    powers = {
        _short(name): Fraction(exponent).limit_denominator(64)
        for name, exponent in parsed.base.items()
    }
    powers.pop("rad", None)
    return Dimension(_sorted(powers), parsed.scale)


def dimension_of(tree: Node, names: Mapping[str, Dimension]) -> Dimension:
    """The dimension of an expression; BadModel with line and column when unlike things are
    added.
    """
    return folded(tree, lambda node, operands: _of_node(node, operands, names))


def _of_node(tree: Node, operands: list[Dimension], names: Mapping[str, Dimension]) -> Dimension:
    if isinstance(tree, Number):
        return LITERAL
    if isinstance(tree, Name):
        return names[tree.name]
    if isinstance(tree, Call):
        return _of_call(tree, operands)
    if tree.operator in ("+", "-"):
        return _alike(tree, operands)
    if tree.operator in COMPARISONS:
        _alike(tree, operands)
        return PLAIN
    if tree.operator in ("and", "or", "not"):
        return PLAIN
    if tree.operator == "*":
        return operands[0] * operands[1]
    if tree.operator == "/":
        return operands[0] / operands[1]
    return operands[0] if tree.operator == "neg" else _power(tree, operands)


_FIRST_ALIKE = {"min": 0, "max": 0, "mod": 0, "hypot": 0, "where": 1}
"""Functions that have the dimension of their operands, and the first operand that counts: a
condition has none.
"""


def _of_call(tree: Call, operands: list[Dimension]) -> Dimension:
    if tree.function in _FIRST_ALIKE:
        return _alike(tree, operands[_FIRST_ALIKE[tree.function] :])
    if tree.function == "atan2":
        _alike(tree, operands)
        return PLAIN
    if tree.function in ("table", "cubic"):
        # the places that values are given at stand between what is looked up and the values
        return _alike(tree, operands[1 + len(operands) // 2 :])
    if tree.function == "delay":
        _check_time(tree, operands[1])
        return operands[0]
    if tree.function == "der":
        return operands[0] / dimension_of_unit(_SECOND)
    if tree.function == "sqrt":
        return operands[0] ** Fraction(1, 2)
    if tree.function in ("abs", "floor"):
        return operands[0]
    if tree.function == "sign":
        return PLAIN
    if not operands[0].agrees(PLAIN):
        raise tree.place.refuse(
            f"unit clash: {tree.function}() of something in {operands[0]}; it must be a plain"
            " number"
        )
    return PLAIN


def _check_time(tree: Call, by: Dimension) -> None:
    if not by.agrees(dimension_of_unit(_SECOND)):
        raise tree.place.refuse(f"unit clash: delay() by something in {by}; it must be a time in s")


def _alike(tree: Operation | Call, operands: list[Dimension]) -> Dimension:
    # A bare number takes the dimension of what it stands beside.
    known = [operand for operand in operands if not operand.literal]
    for dimension in known[1:]:
        if not known[0].agrees(dimension):
            operator = tree.operator if isinstance(tree, Operation) else f"{tree.function}()"
            raise tree.place.refuse(f"unit clash: {operator!r} of {known[0]} and {dimension}")
    return known[0] if known else LITERAL


def _power(tree: Operation, operands: list[Dimension]) -> Dimension:
    base, exponent = operands
    if not exponent.agrees(PLAIN):
        raise tree.place.refuse(
            f"unit clash: an exponent must be a plain number, not in {exponent}"
        )
    # A plain number stays one, whatever the exponent.
    if base.agrees(PLAIN):
        return base
    power = _literal(tree.operands[1])
    if power is None:
        raise tree.place.refuse(
            f"unit clash: something in {base} can only be raised to a literal number"
        )
    # 0.3333 is meant as a third.
    return base ** Fraction(power).limit_denominator(64)


def _literal(tree: Node) -> float | None:
    if isinstance(tree, Number):
        return tree.value
    if (
        isinstance(tree, Operation)
        and tree.operator == "neg"
        and isinstance(tree.operands[0], Number)
    ):
        return -tree.operands[0].value
    return None


def _sorted(powers: Mapping[str, Fraction]) -> tuple[tuple[str, Fraction], ...]:
    return tuple(sorted((base, exponent) for base, exponent in powers.items() if exponent))


def _short(name: str) -> str:
    return {
        "kilogram": "kg",
        "meter": "m",
        "second": "s",
        "ampere": "A",
        "kelvin": "K",
        "radian": "rad",
    }.get(name, name)
