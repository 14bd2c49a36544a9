"""Physical units of channels and parameters: parsing, checking, converting.

Units are written as engineers write them in column heads (`rad/s`, `N*m`, `°C`, `%`, `rpm`, `g`).
Products of common units are read here; pint reads everything else, and is loaded when it is first
needed.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.identification.common_units import COMMON_UNITS, LARGEST_POWER, NamedUnit
from residuum.identification.errors import BadUnit
from residuum.identification.unit_spellings import canonical

_LONGEST = 80  # characters of a unit
# base units without a dimension
_COUNTS = {"radian", "bit", "count", "decibel"}
# what units that are known are made of, by name and, where `dimension` shortens it, by symbol
_BASES = frozenset(
    (
        *(
            "ampere",
            "bit",
            "candela",
            "count",
            "kelvin",
            "kilogram",
            "meter",
            "mole",
            "radian",
            "second",
            "absorbance_unit",
        ),
        *("pixel", "refractive_index_unit", "A", "K", "kg", "m", "rad", "s"),
    )
)
# a factor of a product of common units, with the sign before it and its exponent
_FACTOR = re.compile(r"([*/]?)(1|[A-Za-zµ%_]+)(?:\*\*(-?\d+(?:\.\d+)?))?")
# by name: pint is loaded when the first unit comes that is not common
_REGISTRY = "residuum.identification.unit_registry"


@dataclass(frozen=True)
class Unit:
    """A product of named units to powers."""

    factors: tuple[tuple[NamedUnit, float], ...] = ()

    @property
    def scale(self) -> float:
        """The unit in base units (one rpm is 0.1047 rad/s)."""
        return float(np.prod([named.scale**power for named, power in self.factors]))

    @property
    def offset(self) -> float:
        """Where the unit's zero lies in base units: 273.15 K for °C, 0 for most."""
        return (
            self.factors[0][0].offset if len(self.factors) == 1 and self.factors[0][1] == 1 else 0.0
        )

    @property
    def base(self) -> dict[str, float]:
        """Base units with their exponents, radians among them."""
        powers: dict[str, float] = {}
        for named, power in self.factors:
            for name, exponent in named.base:
                powers[name] = powers.get(name, 0.0) + power * exponent
        return {name: power for name, power in powers.items() if power}

    @property
    def dimension(self) -> Mapping[str, float]:
        """Base units with their exponents, without those that only count."""
        return {name: power for name, power in self.base.items() if name not in _COUNTS}

    @property
    def symbols(self) -> dict[str, float]:
        """Symbol of each named unit with its exponent."""
        return {named.symbol: power for named, power in self.factors}

    def __mul__(self, other: Unit) -> Unit:
        return Unit(_merged((*self.factors, *other.factors)))

    def __truediv__(self, other: Unit) -> Unit:
        return self * other**-1

    def __pow__(self, power: float) -> Unit:
        return Unit(tuple((named, exponent * power) for named, exponent in self.factors))


@lru_cache(maxsize=1024)
def parse_unit(text: str) -> Unit:
    """Return the unit that `text` names; a word that nobody knows (`ticks`) is a unit of its own
    dimension.

    What it takes is bounded before anything is computed: length, words, parentheses inside each
    other, exponents. Raises BadUnit when the text is no unit, or one whose size in base units is no
    number; the message repeats the text.

    >>> compatible("ticks/s", "ticks/min"), compatible("ticks", "rad")
    (True, False)

    >>> parse_unit("N·m/A").dimension == parse_unit("V*s/rad").dimension
    True
    """
    spelled = text.strip()
    if len(spelled) > _LONGEST:
        raise BadUnit(f"unit {spelled[:20]!r}…: longer than {_LONGEST} characters")
    spelled = canonical(spelled) if spelled else "dimensionless"
    factors = _common(spelled)
    try:
        unit = Unit(
            _merged(factors if factors is not None else import_module(_REGISTRY).factors(spelled))
        )
        if any(abs(power) > LARGEST_POWER for _, power in unit.factors):
            raise BadUnit(
                f"unit {text!r}: not a known unit: an exponent is larger than {LARGEST_POWER:g}"
            )
        # a scale beyond double precision converts to nothing but zero and infinity
        if not 0 < unit.scale < np.inf:
            raise OverflowError(spelled)
    except BadUnit as error:  # it shows the registry's spelling, or one word of it
        says = str(error)
        raise BadUnit(f"unit {text!r}: {says[says.rindex('not a known unit') :]}") from None
    except Exception as error:
        # pint raises many unrelated types (tokenizer, attribute, definition errors)
        raise BadUnit(f"unit {text!r}: not a known unit") from error
    return unit


def _common(spelled: str) -> list[tuple[NamedUnit, float]] | None:
    """The factors of a product of common units (`kg*m**2/s`); None for anything else."""
    if spelled == "dimensionless":
        return []
    factors, place = [], 0
    while place < len(spelled):
        match = _FACTOR.match(spelled, place)
        if (
            match is None
            # a sign before every factor but the first
            or bool(match[1]) != bool(place)
            or (match[2] not in COMMON_UNITS and match[2] != "1")
        ):
            return None
        power = float(match[3] or 1.0) * (-1.0 if match[1] == "/" else 1.0)
        factors += [(COMMON_UNITS[match[2]], power)] if match[2] != "1" else []
        place = match.end()
    return factors


def _merged(factors: Any) -> tuple[tuple[NamedUnit, float], ...]:
    """Each named unit once; within a product a temperature is a difference."""
    powers: dict[NamedUnit, float] = {}
    factors = list(factors)
    alone = len(factors) == 1 and factors[0][1] == 1
    for named, power in factors:
        of = (
            named
            if alone or not named.offset
            else NamedUnit(f"Δ{named.symbol}", named.scale, named.base)
        )
        powers[of] = powers.get(of, 0.0) + power
    return tuple((named, power) for named, power in powers.items() if power)


def read_registry() -> None:
    """Read the registry of units that are not common, which takes .3 s: for who cannot wait when
    the first of them comes.
    """
    import_module(_REGISTRY)


def registry_is_read() -> bool:
    """Whether any unit is read in less than a millisecond from now on."""
    return hasattr(sys.modules.get(_REGISTRY), "factors")


def is_own(word: str) -> bool:
    """Whether a base unit is a word that nobody knows.

    >>> is_own("ticks"), is_own("second")
    (True, False)
    """
    return word not in _BASES


def compatible(first: str, second: str) -> bool:
    """Whether values in unit `first` can be converted to unit `second`.

    A frequency becomes a speed of rotation only where somebody says what one cycle is (`rev/s`,
    `rad/s`).

    >>> compatible("rpm", "rad/s"), compatible("Hz", "rpm")
    (True, False)
    """
    given, wanted = _read_together(first, second)
    return bool(given.dimension == wanted.dimension) and not _cycles_against_turns(given, wanted)


def _read_together(first: str, second: str) -> tuple[Unit, Unit]:
    """Two units that are held against each other: `C` is the coulomb beside a charge, and
    everywhere else the degree Celsius.
    """
    left, right = parse_unit(first), parse_unit(second)
    charge = parse_unit("A*s")
    if first.strip() == "C" and right.dimension == charge.dimension:
        return charge, right
    if second.strip() == "C" and left.dimension == charge.dimension:
        return left, charge
    return left, right


def _cycles_against_turns(first: Unit, second: Unit) -> bool:
    """Whether one is a frequency and the other a speed of rotation: nothing says how much of a turn
    a cycle is.
    """
    rotation = {"radian": 1.0, "second": -1.0}
    return sorted((first.base, second.base), key=len) == [{"second": -1.0}, rotation]


def convert(
    values: npt.ArrayLike, source: str, target: str, *, what: str = "value", column: str = ""
) -> npt.NDArray[np.float64]:
    """Convert absolute values from unit `source` to unit `target` (°C to K shifts, rpm to rad/s
    scales).

    Raises BadUnit when the two are incompatible; `what` names the quantity, `column` whose unit may
    be said.

    >>> float(convert(60.0, "rpm", "rad/s"))  # doctest: +ELLIPSIS
    6.283...
    >>> float(convert(20.0, "°C", "K"))
    293.15
    """
    array = np.asarray(values, dtype=float)
    if source == target:
        return array
    given, wanted = _read_together(source, target)
    if _cycles_against_turns(given, wanted):
        raise BadUnit(
            f"{what}: unit {source!r} and {target!r} are a frequency and a speed of rotation;"
            " nothing says what one cycle is",
            way_on=[("units", {column: "rev/s"}, "if it is a turn")] if column else (),
        )
    if not compatible(source, target):
        says = f"unit {_shown(source)} cannot be converted to {_shown(target)}"
        own = [word for word in given.base if is_own(word)]
        when = f", nobody knows {own[0]!r}" if own else ""
        way = (
            "units",
            {column: target},
            f"if the column is in {target!r}" + ("" if own else " all the same"),
        )
        raise BadUnit(f"{what}: {says}{when}", way_on=[way] if column else ())
    # without an offset one product, which rounds once
    if given.offset == wanted.offset:
        return np.asarray(array * (given.scale / wanted.scale))
    return np.asarray((array * given.scale + (given.offset - wanted.offset)) / wanted.scale)


def _shown(unit: str) -> str:
    return repr(unit) if unit else "none"
