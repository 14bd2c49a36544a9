"""Expressions of model files: a whitelist parser (nothing is ever evaluated as Python) and what can be asked of the tree.

Grammar, lowest precedence first::

    sum     = product (("+" | "-") product)*
    product = sign (("*" | "/") sign)*
    sign    = ("+" | "-") sign | power
    power   = atom ("**" sign)?
    atom    = number | name | function "(" sum ("," sum)* ")" | "(" sum ")"

Functions: `der sin cos tanh exp log sqrt abs sign min max`. Everything else is refused with its place.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from residuum.identification.errors import BadModel
from residuum.nearest_names import known_names

FUNCTIONS: Mapping[str, tuple[int, int]] = {
    "der": (1, 1),
    "sin": (1, 1),
    "cos": (1, 1),
    "tanh": (1, 1),
    "exp": (1, 1),
    "log": (1, 1),
    "sqrt": (1, 1),
    "abs": (1, 1),
    "sign": (1, 1),
    "min": (2, 8),
    "max": (2, 8),
}
LONGEST_EXPRESSION = 4000
DEEPEST_EXPRESSION, LARGEST_EXPONENT = 60, 20

_INSTEAD = {"|": "; write abs(x)", "^": "; write x**2", "·": "; write *", "×": "; write *", "²": "; write **2"}
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_][A-Za-z_0-9]*)|(?P<mark>\*\*|[-+*/(),])|(?P<bad>\S))"
)


@dataclass(frozen=True)
class Place:
    """Where a text stands: file (or what was given), line and column, both counted from 1."""

    source: str = "expression"
    line: int = 1
    column: int = 1

    def right(self, columns: int) -> Place:
        """The place `columns` characters further on the same line."""
        return Place(self.source, self.line, self.column + columns)

    def refuse(self, message: str, error: type[BadModel] = BadModel) -> BadModel:
        """The error that says `message` of this place."""
        return error(f"{self.source}, line {self.line}, column {self.column}: {message}")


@dataclass(frozen=True)
class Number:
    """A literal."""

    value: float
    place: Place = field(compare=False)


@dataclass(frozen=True)
class Name:
    """A state, input, parameter or variable of the model."""

    name: str
    place: Place = field(compare=False)


@dataclass(frozen=True)
class Operation:
    """`+ - * / **` of two nodes, or unary `-` (operator "neg") of one."""

    operator: str
    operands: tuple[Node, ...]
    place: Place = field(compare=False)


@dataclass(frozen=True)
class Call:
    """One of `FUNCTIONS` applied to its arguments."""

    function: str
    operands: tuple[Node, ...]
    place: Place = field(compare=False)


Node = Number | Name | Operation | Call


@dataclass(frozen=True)
class Expression:
    """The text of an expression and its tree."""

    text: str
    tree: Node

    @property
    def place(self) -> Place:
        """Where the expression begins."""
        return self.tree.place

    @property
    def names(self) -> frozenset[str]:
        """Every name that occurs.

        >>> sorted(parse("J * der(omega) - K*i").names)
        ['J', 'K', 'i', 'omega']
        """
        return frozenset(node.name for node in walk(self.tree) if isinstance(node, Name))


def _is_steep(node: Node) -> bool:
    if isinstance(node, Number):
        return abs(node.value) > LARGEST_EXPONENT
    return isinstance(node, Operation) and node.operator == "**"


def walk(tree: Node) -> Iterator[Node]:
    """The node and everything below it."""
    yield tree
    if isinstance(tree, Operation | Call):
        for operand in tree.operands:
            yield from walk(operand)


def parse(text: str | float, place: Place | None = None) -> Expression:
    """Parse `text` by the grammar above.

    Raises
    ------
    BadModel
        With line and column: unknown character or function, missing bracket, wrong number of arguments,
        longer than 4000 characters, brackets more than 60 deep.

    Examples
    --------
    >>> parse("-R*i").tree.operator
    '*'
    >>> parse("open(x)")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    residuum.identification.errors.BadModel: expression, line 1, column 1: function 'open' is not known; there are der, ...
    """
    start = place or Place()
    source = str(text)
    if len(source) > LONGEST_EXPRESSION:
        raise start.refuse(f"expression has {len(source)} characters; at most {LONGEST_EXPRESSION} are allowed")
    return Expression(source.strip(), _Parser(source, start).parse())


def evaluate(tree: Node, values: Mapping[str, float]) -> float:
    """The number that the tree gives for these names; nan where it is undefined (a division by zero, a negative root).

    `der()` counts as 1, so that a storage gives what multiplies the derivative.

    >>> evaluate(parse("(J + m*r**2) * der(w)").tree, {"J": 1.0, "m": 3.0, "r": 2.0})
    13.0
    """
    if isinstance(tree, Number):
        return tree.value
    if isinstance(tree, Name):
        return values.get(tree.name, math.nan)
    numbers = [evaluate(operand, values) for operand in tree.operands]
    try:
        return float(_MEANING[tree.operator if isinstance(tree, Operation) else tree.function](*numbers))
    except (ZeroDivisionError, ValueError, OverflowError, TypeError):
        return math.nan


_MEANING: Mapping[str, Callable[..., float]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "**": lambda a, b: a**b,
    "neg": lambda a: -a,
    "der": lambda a: 1.0,
    "sin": math.sin,
    "cos": math.cos,
    "tanh": math.tanh,
    "exp": math.exp,
    "log": math.log,
    "sqrt": math.sqrt,
    "abs": abs,
    "sign": lambda a: math.copysign(1.0, a) if a else 0.0,
    "min": min,
    "max": max,
}


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    place: Place


def _tokens(text: str, start: Place) -> Iterator[_Token]:
    position = 0
    while match := _TOKEN.match(text, position):
        kind = str(match.lastgroup)
        place = start.right(match.start(kind))
        if kind == "bad":
            hint = _INSTEAD.get(match[kind], "")
            raise place.refuse(f"character {match[kind]!r} is not allowed in an expression{hint}")
        yield _Token(kind, match[kind], place)
        position = match.end()
    yield _Token("end", "", start.right(len(text)))


class _Parser:
    """Recursive descent over the grammar of this module, with a bound on the depth."""

    def __init__(self, text: str, start: Place) -> None:
        self._tokens = list(_tokens(text, start))
        self._next = 0
        self._depth = 0

    def parse(self) -> Node:
        tree = self._sum()
        if self._peek.kind != "end":
            raise self._peek.place.refuse(f"{self._peek.text!r} is not expected here")
        return tree

    @property
    def _peek(self) -> _Token:
        return self._tokens[self._next]

    def _take(self) -> _Token:
        token = self._peek
        self._next += 1
        return token

    def _accept(self, *marks: str) -> _Token | None:
        return self._take() if self._peek.kind == "mark" and self._peek.text in marks else None

    def _expect(self, mark: str) -> None:
        if not self._accept(mark):
            raise self._peek.place.refuse(f"{mark!r} is missing")

    def _sum(self) -> Node:
        tree = self._product()
        while token := self._accept("+", "-"):
            tree = Operation(token.text, (tree, self._product()), token.place)
        return tree

    def _product(self) -> Node:
        tree = self._sign()
        while token := self._accept("*", "/"):
            tree = Operation(token.text, (tree, self._sign()), token.place)
        return tree

    def _sign(self) -> Node:
        self._depth += 1
        if self._depth > DEEPEST_EXPRESSION:
            raise self._peek.place.refuse(f"brackets and signs are nested more than {DEEPEST_EXPRESSION} deep")
        if token := self._accept("-", "+"):
            operand = self._sign()
            tree = Operation("neg", (operand,), token.place) if token.text == "-" else operand
        else:
            tree = self._power()
        self._depth -= 1
        return tree

    def _power(self) -> Node:
        tree = self._atom()
        if token := self._accept("**"):
            exponent = self._sign()
            if any(_is_steep(node) for node in walk(exponent)):
                raise token.place.refuse(f"an exponent is at most {LARGEST_EXPONENT}, and no power itself")
            return Operation("**", (tree, exponent), token.place)
        return tree

    def _atom(self) -> Node:
        token = self._take()
        if token.kind == "number":
            return Number(float(token.text), token.place)
        if token.kind == "name":
            return self._call(token) if self._accept("(") else Name(token.text, token.place)
        if token.text == "(":
            tree = self._sum()
            self._expect(")")
            return tree
        what = repr(token.text) if token.text else "the end"
        raise token.place.refuse(f"a number, a name or '(' is expected, not {what}")

    def _call(self, function: _Token) -> Node:
        if function.text not in FUNCTIONS:
            raise function.place.refuse(
                f"function {function.text!r} is not known; {known_names(function.text, FUNCTIONS, 'there are')}"
            )
        operands = [self._sum()]
        while self._accept(","):
            operands.append(self._sum())
        self._expect(")")
        fewest, most = FUNCTIONS[function.text]
        if not fewest <= len(operands) <= most:
            count = str(fewest) if fewest == most else f"{fewest} to {most}"
            raise function.place.refuse(f"{function.text}() takes {count} argument(s), not {len(operands)}")
        return Call(function.text, tuple(operands), function.place)
