"""pint's registry of units: what `common_units` does not list, and words that nobody knows.

`unit_spellings` puts a text into the registry's spelling first. The registry itself reads nearly
any word as a prefix and a unit (`pH`: picohenry, `pct`: pico-centitonne), so only symbols that are
listed and names that are written out are taken from it. It is asked for single words alone: a whole
text it would compute (`9**9**9`). Nothing that is asked is entered into it.

A text is a product of words to powers, read within bounds before anything is computed or looked up:

    product = factor {("*" | "/" | blank | "per") factor};  factor = ("1" | word | "(" product ")") ["**" number];
    number = ["-"] digits | "(" number ["/" number] ")"

Whoever can send a unit can send `9**9**9`: so no number is multiplied here, and none is raised to
another.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import pint

from residuum.identification.common_units import LARGEST_POWER, NamedUnit
from residuum.identification.errors import BadUnit
from residuum.identification.unit_spellings import KNOWN_SYMBOLS, LOOKALIKES

_REGISTRY: pint.UnitRegistry[float] = pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
_WORD = re.compile(r"[A-Za-z_µΔ][A-Za-z_µΔ0-9]*")
# letters of a name that is written out, at least
_NAME = 4


def factors(text: str) -> tuple[tuple[NamedUnit, float], ...]:
    """The named units with their exponents that a text multiplies; a word that nobody knows becomes
    a unit of its own.

    Raises BadUnit for what is no product of words, or one beyond the bounds.
    """
    return tuple((_named(word), power) for word, power in read_product(text))


@lru_cache(maxsize=4096)
def _named(word: str) -> NamedUnit:
    """The unit that a word names: the registry's where it means what a person does, else one of its
    own dimension.
    """
    if word in KNOWN_SYMBOLS or _is_name(word) or (not _WORD.fullmatch(word) and _is_known(word)):
        return _of_registry(word)
    if not _WORD.fullmatch(word):
        raise BadUnit(f"unit {word!r}: not a known unit")
    # A base unit of its own: the registry would read `pH` as a picohenry, and convert it.
    own = f"own_{word}" if _is_known(word) else word
    return NamedUnit(own, 1.0, ((own, 1.0),))


def _of_registry(name: str) -> NamedUnit:
    unit = _REGISTRY.Unit(name)
    unity: Any = _REGISTRY.Quantity(
        1.0, _REGISTRY.Unit(f"delta_{name}") if _shifted(name) else unit
    ).to_base_units()
    zero: Any = _REGISTRY.Quantity(0.0, unit).to_base_units().magnitude
    base = tuple((base, float(power)) for base, power in unity.unit_items())
    return NamedUnit(_symbol(unit), float(unity.magnitude), base, float(zero))


def _symbol(unit: Any) -> str:
    """The short symbol of a unit, or its name where the symbol would not be read back as this unit
    (`kn` of the knot).
    """
    short = f"{unit:~C}".replace("Ω", "ohm")
    return short if short in KNOWN_SYMBOLS or not short.isascii() else f"{unit:C}"


def _shifted(name: str) -> bool:
    """Whether zero in this unit is not zero in base units (°C, °F)."""
    return bool(_REGISTRY.Quantity(0.0, name).to_base_units().magnitude)


def _is_known(word: str) -> bool:
    """Whether the registry reads a word in any way."""
    return bool(_REGISTRY.parse_unit_name(word))


def _is_name(word: str) -> bool:
    """Whether a word is the written-out name of one unit, with a written-out prefix at most."""
    if len(word) < _NAME or word in LOOKALIKES:
        return False
    return any(
        len(name) >= _NAME and f"{prefix}{name}" in (word, word.removesuffix("s"))
        for prefix, name, _ in _REGISTRY.parse_unit_name(word)
    )


# The grammar of units.

MOST_FACTORS = 10
"""Words of a unit."""
DEEPEST = 4
"""Parentheses inside each other."""

_TOKEN = re.compile(
    r"\s*(?:(?P<number>\d+(?:\.\d*)?(?:[eE][-+]?\d+)?(?!\w))|(?P<word>[^\W\d]\w*)|(?P<sign>\*\*|[-+*/()]))"
)

Factors = list[tuple[str, float]]


def read_product(text: str) -> Factors:
    """The words of a unit with their exponents, in their order.

    Raises BadUnit, in one line, for what is no product of words, or one that exceeds a bound.

    >>> read_product("N*m/(rad per s)**2")
    [('N', 1.0), ('m', 1.0), ('rad', -2.0), ('s', 2.0)]
    """
    return _Reader(text).whole()


class _Reader:
    """A text and the place in it."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._tokens = list(_tokens(text))
        self._place = 0

    def whole(self) -> Factors:
        """All of the text."""
        factors = self._product(0)
        if self._next() is not None:
            raise self._refusal()
        return factors

    def _product(self, depth: int) -> Factors:
        if depth > DEEPEST:
            raise self._refusal(f"more than {DEEPEST} parentheses inside each other")
        factors, sign = self._factor(depth), 1.0
        while (token := self._next()) is not None and token != ")":
            # A sign holds for the one factor behind it: J/kg*K is J·K/kg.
            if token in ("*", "/", "per"):
                sign = 1.0 if token == "*" else -1.0
                self._place += 1
            else:
                sign = 1.0
            factors += _raised(self._factor(depth), sign)
            if len(factors) > MOST_FACTORS:
                raise self._refusal(f"more than {MOST_FACTORS} units are multiplied")
        return factors

    def _factor(self, depth: int) -> Factors:
        token = self._take()
        if token == "(":
            factors = self._product(depth + 1)
            self._expect(")")
        elif token[:1].isdecimal() and float(token) == 1.0:
            factors = []
        elif token[:1].isalpha() or token[:1] == "_":
            factors = [(token, 1.0)]
        else:
            raise self._refusal()
        if self._next() == "**":
            self._place += 1
            factors = _raised(factors, self._number())
        if any(abs(power) > LARGEST_POWER for _, power in factors):
            raise self._refusal(f"an exponent is larger than {LARGEST_POWER:g}")
        return factors

    def _number(self) -> float:
        token = self._take()
        if token == "(":
            number = self._number()
            if self._next() == "/":
                self._place += 1
                # A division by zero is NaN, which the bound below refuses, being no smaller than
                # it.
                number /= self._number() or float("nan")
            self._expect(")")
        elif token in ("-", "+"):
            number = self._number() * (-1.0 if token == "-" else 1.0)
        elif token[:1].isdecimal():
            number = float(token)
        else:
            raise self._refusal("an exponent must be a number")
        if not abs(number) <= LARGEST_POWER:
            raise self._refusal(f"an exponent is larger than {LARGEST_POWER:g}")
        return number

    def _next(self) -> str | None:
        return self._tokens[self._place] if self._place < len(self._tokens) else None

    def _take(self) -> str:
        token = self._next()
        if token is None:
            raise self._refusal()
        self._place += 1
        return token

    def _expect(self, wanted: str) -> None:
        if self._take() != wanted:
            raise self._refusal()

    def _refusal(self, rule: str = "") -> BadUnit:
        return BadUnit(f"unit {self._text!r}: not a known unit{f': {rule}' if rule else ''}")


def _tokens(text: str) -> Iterator[str]:
    place, end = 0, len(text.rstrip())
    while place < end:
        match = _TOKEN.match(text, place)
        if match is None:
            raise BadUnit(f"unit {text!r}: not a known unit")
        yield str(match[match.lastgroup or 0])
        place = match.end()


def _raised(factors: Factors, power: float) -> Factors:
    return [(word, exponent * power) for word, exponent in factors]
