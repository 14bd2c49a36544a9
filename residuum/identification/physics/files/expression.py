"""Expressions of model files: a whitelist parser (nothing is ever evaluated as Python) and what can
be asked of the tree.

Grammar, lowest precedence first::

    sum       = product (("+" | "-") product)*
    product   = sign (("*" | "/") sign)*
    sign      = ("+" | "-") sign | power
    power     = atom ("**" sign)?
    atom      = number | name | function "(" sum ("," sum)* ")" | "(" sum ")"
              | "where" "(" condition "," sum "," sum ")"
              | "table" "(" sum "," list "," list ("," "cubic")? ")"
              | "table" "(" sum "," sum "," list "," list "," "[" list ("," list)* "]" ")"
    list      = "[" sum ("," sum)* "]"
    condition = both ("or" both)*
    both      = either ("and" either)*
    either    = "not" either | sum ("<" | "<=" | ">" | ">=" | "==" | "!=") sum | "(" condition ")"

Functions: those of `FUNCTIONS`. Everything else is refused with its place.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeGuard, TypeVar

from residuum.identification.errors import BadModel
from residuum.nearest_names import known_names

FUNCTIONS: Mapping[str, tuple[int, int]] = {
    "der": (1, 1),
    "sin": (1, 1),
    "cos": (1, 1),
    "tan": (1, 1),
    "asin": (1, 1),
    "acos": (1, 1),
    "atan": (1, 1),
    "atan2": (2, 2),
    "sinh": (1, 1),
    "cosh": (1, 1),
    "tanh": (1, 1),
    "exp": (1, 1),
    "log": (1, 1),
    "sqrt": (1, 1),
    "abs": (1, 1),
    "sign": (1, 1),
    "floor": (1, 1),
    "mod": (2, 2),
    "hypot": (2, 2),
    "min": (2, 8),
    "max": (2, 8),
    "delay": (2, 2),
    "where": (3, 3),
    "table": (3, 3),
}
COMPARISONS = ("<=", ">=", "==", "!=", "<", ">")
MOST_KNOTS, MOST_VALUES = 200, 1000
"""Of a table of one place, and of one of two places."""
# Texts come from anybody: what one may ask of the reader is bounded.
LONGEST_EXPRESSION = 20_000
DEEPEST_EXPRESSION, LARGEST_EXPONENT = 60, 20
MOST_IN_A_ROW = 200
"""Terms of a sum, or factors of a product: each is a level of the tree, which is walked down."""
MOST_NODES, DEEPEST_TREE, MOST_LEVELS = 200_000, 120, 220
"""Of an expression with everything that its names stand for, each time that it is named: a sum is
one of its depths, however many terms it has, and a level a term.
"""
_SUM = ("+", "-")

_INSTEAD = {
    "|": "; write abs(x)",
    "^": "; write x**2",
    "·": "; write *",
    "×": "; write *",
    "²": "; write **2",
}
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    r"|(?P<name>[A-Za-z_][A-Za-z_0-9]*)"
    r"|(?P<mark>\*\*|[<>=!]=|[-+*/(),<>\[\]])"
    r"|(?P<bad>\S))"
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
    """`+ - * / **` of two nodes, unary `-` (operator "neg") of one; in a `where`'s condition
    comparisons, `and or not`, too.
    """

    operator: str
    operands: tuple[Node, ...]
    place: Place = field(compare=False)


@dataclass(frozen=True)
class Call:
    """One of `FUNCTIONS` applied to its arguments; of a table (`cubic`: a smooth one) they are what
    is looked up, the places, and the values there. One of two places is a table of tables.
    """

    function: str
    operands: tuple[Node, ...]
    place: Place = field(compare=False)


Node = Number | Name | Operation | Call
T = TypeVar("T")


@dataclass(frozen=True)
class Expression:
    """The text of an expression and its tree.

    Where the text would be too long with what its names stand for written out, `where` has these
    names, and the tree what they stand for.
    """

    text: str
    tree: Node
    where: Mapping[str, Expression] = field(default_factory=dict, compare=False)

    @property
    def place(self) -> Place:
        """Where the expression begins."""
        return self.tree.place

    @cached_property
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
    """The node and everything below it, once where it stands in several places."""
    walked = set[int]()
    open_ = [tree]
    while open_:
        node = open_.pop()
        # By identity: definitions are shared nodes, and equal ones may stand in many places.
        if id(node) in walked:
            continue
        walked.add(id(node))
        yield node
        if isinstance(node, Operation | Call):
            # Reversed onto a stack: the first operand is walked first.
            open_ += reversed(node.operands)


def folded(tree: Node, combine: Callable[[Node, list[T]], T]) -> T:
    """What `combine(node, what its operands gave)` gives of the tree; a node that stands in several
    places is asked once.
    """
    done = dict[int, T]()
    open_ = [tree]
    while open_:
        node = open_[-1]
        operands = node.operands if isinstance(node, Operation | Call) else ()
        # A stack of its own, not Python's: a tree may be deeper than its calls may go.
        waiting = [operand for operand in operands if id(operand) not in done]
        if waiting:
            open_ += reversed(waiting)
            continue
        open_.pop()
        if id(node) not in done:
            done[id(node)] = combine(node, [done[id(operand)] for operand in operands])
    return done[id(tree)]


def parse(text: str | float, place: Place | None = None) -> Expression:
    """Parse `text` by the grammar above.

    Raises
    ------
    BadModel
        With line and column: unknown character or function, missing bracket, wrong number of
        arguments, longer than 20000 characters, brackets more than 60 deep.

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
        raise start.refuse(
            f"expression has {len(source)} characters; at most {LONGEST_EXPRESSION} are allowed"
        )
    tree = _Parser(source, start).parse()
    _check_size(tree, tree.place)
    return Expression(source.strip(), tree)


def with_definitions(expression: Expression, definitions: Mapping[str, Expression]) -> Expression:
    """The expression with each name that is defined replaced by what it stands for, in brackets
    where that is more than a name. A text that were longer than 20000 characters keeps its names.

    >>> with_definitions(parse("2 * Re + T"), {"Re": parse("rho*v + 1"), "T": parse("T_1")}).text
    '2 * (rho*v + 1) + T_1'
    """
    used = {name: definitions[name] for name in expression.names & definitions.keys()}
    if not used:
        return expression
    tree = _replaced(expression.tree, {name: definition.tree for name, definition in used.items()})
    _check_size(tree, expression.place)
    text, where = _written_out(expression, used)
    if len(text) > LONGEST_EXPRESSION:
        # Formulas that name formulas grow with every level: from here on the names stay.
        text = expression.text
        where = used
    return Expression(text, tree, where)


def _written_out(
    expression: Expression, used: Mapping[str, Expression]
) -> tuple[str, Mapping[str, Expression]]:
    if expression.where:
        raise expression.place.refuse(
            "too long for a part: with its definitions it has more than"
            f" {LONGEST_EXPRESSION} characters; write what it holds into the model itself"
        )
    texts = {name: _in_brackets(definition) for name, definition in used.items()}
    text = _NAMES.sub(lambda name: texts.get(name[0], name[0]), expression.text)
    where: dict[str, Expression] = {}
    for definition in used.values():
        where |= definition.where
    return text, where


def _check_size(tree: Node, place: Place) -> None:
    """BadModel for a tree that is too large or too deep for the questions that are asked of it."""

    def measures(node: Node, inner: list[tuple[int, int, int]]) -> tuple[int, int, int]:
        # A sum in a sum is one sum to a reader: a + b + c counts as one depth, though its tree has
        # two.
        depths = [depth + 1 for _, depth, _ in inner]
        if _is_sum(node) and _is_sum(node.operands[0]):
            depths[0] -= 1
        levels = [level + 1 for _, _, level in inner]
        return 1 + sum(size for size, _, _ in inner), max(depths, default=1), max(levels, default=1)

    size, depth, levels = folded(tree, measures)
    if size > MOST_NODES or depth > DEEPEST_TREE or levels > MOST_LEVELS:
        raise place.refuse(
            f"with its definitions it has {size} numbers, names and operations, {depth} within each"
            f" other, in {levels} levels; at most {MOST_NODES}, {DEEPEST_TREE} and {MOST_LEVELS}"
            " are allowed: make a state of a quantity that it names"
        )


# Not behind a digit or a dot, so that numbers stay whole.
_NAMES = re.compile(r"(?<![\w.])[A-Za-z_]\w*")
"""Names in a text; the e of 1e5 is none."""


def _in_brackets(expression: Expression) -> str:
    return expression.text if isinstance(expression.tree, Name) else f"({expression.text})"


def _is_sum(node: Node) -> TypeGuard[Operation]:
    return isinstance(node, Operation) and node.operator in _SUM


def _replaced(tree: Node, trees: Mapping[str, Node]) -> Node:
    """The tree with names replaced; what stands in several places stays one."""

    def combine(node: Node, operands: list[Node]) -> Node:
        if isinstance(node, Name):
            return trees.get(node.name, node)
        return node if isinstance(node, Number) else replace(node, operands=tuple(operands))

    return folded(tree, combine)


def evaluate(tree: Node, values: Mapping[str, float]) -> float:
    """The number that the tree gives for these names; nan where it is undefined (a division by
    zero, a negative root).

    `der()` counts as 1, so that a storage gives what multiplies the derivative.

    >>> evaluate(parse("(J + m*r**2) * der(w)").tree, {"J": 1.0, "m": 3.0, "r": 2.0})
    13.0
    """

    def combine(node: Node, numbers: list[float]) -> float:
        if isinstance(node, Number):
            return node.value
        if isinstance(node, Name):
            return values.get(node.name, math.nan)
        try:
            return float(
                _MEANING[node.operator if isinstance(node, Operation) else node.function](*numbers)
            )
        # TypeError: a negative number to a fractional power is complex.
        except (ZeroDivisionError, ValueError, OverflowError, TypeError):
            return math.nan

    return folded(tree, combine)


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
    "tan": math.tan,
    "asin": math.asin,
    "acos": math.acos,
    "atan": math.atan,
    "atan2": math.atan2,
    "sinh": math.sinh,
    "cosh": math.cosh,
    "floor": math.floor,
    "mod": lambda a, b: a - b * math.floor(a / b),
    "hypot": math.hypot,
    "delay": lambda signal, by: signal,
    "where": lambda condition, a, b: a if condition else b,
    "table": lambda x, *knots: interpolated(x, knots[: len(knots) // 2], knots[len(knots) // 2 :]),
    "cubic": lambda x, *knots: smooth(
        x, knots[: len(knots) // 2], knots[len(knots) // 2 :], _within, _where_positive
    ),
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
    "==": lambda a, b: a == b,
    "!=": lambda a, b: a != b,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
}


def interpolated(x: float, places: Sequence[float], values: Sequence[float]) -> float:
    """The straight line between the values at neighbouring places; the first and the last value
    hold beyond them.

    >>> interpolated(1.5, [0.0, 1.0, 2.0], [0.0, 10.0, 30.0])
    20.0
    >>> interpolated(9.0, [0.0, 1.0], [0.0, 10.0])
    10.0
    """
    if x <= places[0]:
        return values[0]
    for (left, right), (low, high) in zip(pairwise(places), pairwise(values), strict=True):
        if x <= right:
            return low + (high - low) * (x - left) / (right - left)
    return values[-1]


def _within(x: float, left: float, right: float) -> float:
    return min(max(x, left), right)


def _where_positive(test: float, yes: float, no: float) -> float:
    return yes if test > 0 else no


def smooth(
    x: Any,
    places: Sequence[Any],
    values: Sequence[Any],
    within: Callable[[Any, Any, Any], Any],
    where_positive: Callable[[Any, Any, Any], Any],
) -> Any:
    """The cubic between the values at neighbouring places that rises and falls only where they do;
    held beyond them.

    Numbers and SymPy's expressions alike: `within` bounds x, `where_positive` chooses by the sign
    of its first argument.

    Reference: F. N. Fritsch, J. Butland, SIAM J. Sci. Stat. Comput. 5 (1984) 300.
    """
    total = values[0]
    slopes = _monotone_slopes(places, values, where_positive)
    for (a, b), (low, high), (at_a, at_b) in zip(
        pairwise(places), pairwise(values), pairwise(slopes), strict=True
    ):
        # Each piece adds what it rises by: outside of it t is 0 or 1, so that the sum is the curve.
        t = (within(x, a, b) - a) / (b - a)
        total += t * t * (3 - 2 * t) * (high - low) + t * (1 - t) * (b - a) * (
            (1 - t) * at_a - t * at_b
        )
    return total


def _monotone_slopes(
    places: Sequence[Any], values: Sequence[Any], where_positive: Callable[[Any, Any, Any], Any]
) -> list[Any]:
    # Widths and slopes of the pieces.
    h = [b - a for a, b in pairwise(places)]
    m = [(b - a) / width for (a, b), width in zip(pairwise(values), h, strict=True)]
    if len(m) == 1:
        return [m[0], m[0]]

    def end(h0: Any, h1: Any, m0: Any, m1: Any) -> Any:
        # One-sided three-point slope, cut where it would turn or overshoot.
        d = ((2 * h0 + h1) * m0 - h0 * m1) / (h0 + h1)
        bounded = where_positive(-m0 * m1, where_positive(abs(d) - 3 * abs(m0), 3 * m0, d), d)
        return where_positive(d * m0, bounded, 0 * m0)

    inner = []
    for (h0, h1), (m0, m1) in zip(pairwise(h), pairwise(m), strict=True):
        # Weighted harmonic mean of two slopes of one sign; 0 where the data turn: so no piece
        # overshoots.
        w0 = 2 * h1 + h0
        w1 = h1 + 2 * h0
        below = w0 * m1 + w1 * m0
        inner.append(
            where_positive(
                m0 * m1, (w0 + w1) * m0 * m1 / where_positive(m0 * m1, below, 1 + 0 * m0), 0 * m0
            )
        )
    return [end(h[0], h[1], m[0], m[1]), *inner, end(h[-1], h[-2], m[-1], m[-2])]


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    place: Place


def _tokens(text: str, start: Place) -> Iterator[_Token]:
    position = 0
    # Blanks belong to the token behind them.
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
        return self._row(self._product, "+", "-")

    def _product(self) -> Node:
        return self._row(self._sign, "*", "/")

    def _row(self, part: Callable[[], Node], *operators: str) -> Node:
        tree = part()
        count = 1
        while token := self._accept(*operators):
            count += 1
            if count > MOST_IN_A_ROW:
                raise token.place.refuse(
                    f"more than {MOST_IN_A_ROW} terms or factors stand in a row; put parts of them"
                    " in brackets"
                )
            tree = Operation(token.text, (tree, part()), token.place)
        return tree

    def _sign(self) -> Node:
        self._depth += 1
        if self._depth > DEEPEST_EXPRESSION:
            raise self._peek.place.refuse(
                f"brackets and signs are nested more than {DEEPEST_EXPRESSION} deep"
            )
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
            # M**9**9 would be a power of 387 420 489.
            if any(_is_steep(node) for node in walk(exponent)):
                raise token.place.refuse(
                    f"an exponent is at most {LARGEST_EXPONENT}, and no power itself"
                )
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
        text = repr(token.text) if token.text else "the end"
        raise token.place.refuse(f"a number, a name or '(' is expected, not {text}")

    def _call(self, function: _Token) -> Node:
        if function.text not in FUNCTIONS:
            raise function.place.refuse(
                f"function {function.text!r} is not known;"
                f" {known_names(function.text, FUNCTIONS, 'there are')}"
            )
        if function.text == "table":
            return self._table(function)
        operands = [self._condition() if function.text == "where" else self._sum()]
        while self._accept(","):
            operands.append(self._sum())
        self._expect(")")
        fewest, most = FUNCTIONS[function.text]
        if not fewest <= len(operands) <= most:
            count = str(fewest) if fewest == most else f"{fewest} to {most}"
            raise function.place.refuse(
                f"{function.text}() takes {count} argument(s), not {len(operands)}"
            )
        return Call(function.text, tuple(operands), function.place)

    def _table(self, function: _Token) -> Node:
        first = self._sum()
        self._expect(",")
        # A list follows: a table of one place.
        second = None if self._peek.text == "[" else self._sum()
        if second is not None:
            self._expect(",")
        places = self._list(self._sum)
        self._expect(",")
        if second is None:
            values = self._list(self._sum)
            name = "table"
            if self._accept(","):
                if not self._accept_word("cubic"):
                    raise self._peek.place.refuse(
                        "'cubic' or ')' is expected after the values of a table()"
                    )
                name = "cubic"
        else:
            inner = self._list(self._sum)
            self._expect(",")
            rows = self._list(lambda: self._list(self._sum))
            name = "table"
            # Each value is a term of the equations, with slopes of its own.
            if len(rows) * len(inner) > MOST_VALUES:
                raise function.place.refuse(
                    f"table() has {len(rows) * len(inner)} values; must be at most {MOST_VALUES}"
                )
            # A map is a table of tables: its values at the first places are tables of the second.
            values = [self._looked_up(function, "table", second, inner, row) for row in rows]
        self._expect(")")
        return self._looked_up(function, name, first, places, values)

    def _looked_up(
        self, function: _Token, name: str, x: Node, places: list[Node], values: list[Node]
    ) -> Node:
        if len(places) != len(values) or not 2 <= len(places) <= MOST_KNOTS:
            raise function.place.refuse(
                f"table() has {len(places)} places and {len(values)} values; must be as many of"
                f" both, 2 to {MOST_KNOTS}"
            )
        # Without values: a name among the places is NaN, and rises nowhere.
        numbers = [evaluate(place, {}) for place in places]
        if not all(left < right for left, right in pairwise(numbers)):
            raise function.place.refuse(
                "the places of a table() must be numbers that rise; only its values may hold names"
            )
        known = tuple(
            Number(number, place.place) for number, place in zip(numbers, places, strict=True)
        )
        return Call(name, (x, *known, *values), function.place)

    def _list(self, item: Callable[[], T]) -> list[T]:
        self._expect("[")
        items = [item()]
        while self._accept(","):
            items.append(item())
        self._expect("]")
        return items

    def _condition(self) -> Node:
        tree = self._both()
        while token := self._accept_word("or"):
            tree = Operation("or", (tree, self._both()), token.place)
        return tree

    def _both(self) -> Node:
        tree = self._either()
        while token := self._accept_word("and"):
            tree = Operation("and", (tree, self._either()), token.place)
        return tree

    def _either(self) -> Node:
        self._depth += 1
        if self._depth > DEEPEST_EXPRESSION:
            raise self._peek.place.refuse(
                f"conditions are nested more than {DEEPEST_EXPRESSION} deep"
            )
        if token := self._accept_word("not"):
            tree: Node = Operation("not", (self._either(),), token.place)
        else:
            tree = self._comparison()
        self._depth -= 1
        return tree

    def _comparison(self) -> Node:
        start = self._next
        depth = self._depth
        if self._accept("("):  # a condition in brackets, or a sum that begins with one
            try:
                tree = self._condition()
                self._expect(")")
            # It was a sum after all: read once more from the bracket on.
            except BadModel:
                self._next = start
                self._depth = depth
            else:
                # An operator behind the bracket: it was the first part of a sum.
                if self._peek.text not in (*COMPARISONS, "+", "-", "*", "/", "**"):
                    return tree
                self._next = start
        left = self._sum()
        token = self._accept(*COMPARISONS)
        if token is None:
            raise self._peek.place.refuse(
                f"a condition compares two values ({' '.join(COMPARISONS)})"
            )
        return Operation(token.text, (left, self._sum()), token.place)

    def _accept_word(self, word: str) -> _Token | None:
        return self._take() if self._peek.kind == "name" and self._peek.text == word else None
