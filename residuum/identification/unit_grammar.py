"""The grammar of units: a product of words to powers, read within bounds before anything is
computed or looked up.

    product = factor {("*" | "/" | blank | "per") factor};  factor = ("1" | word | "(" product ")") ["**" number];
    number = ["-"] digits | "(" number ["/" number] ")"

Whoever can send a unit can send `9**9**9`: so no number is multiplied here, and none is raised to
another.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from residuum.identification.errors import BadUnit

MOST_FACTORS = 10
"""Words of a unit."""
DEEPEST = 4
"""Parentheses inside each other."""
LARGEST_POWER = 16.0
"""Exponent of a word, all parentheses around it included; the largest in use is the fourth power of
a temperature.
"""

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
