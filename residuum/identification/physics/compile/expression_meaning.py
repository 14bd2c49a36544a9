"""What a parsed expression means in SymPy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from importlib import import_module
from itertools import pairwise
from typing import Any

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.files.expression import (
    Call,
    Name,
    Node,
    Number,
    Operation,
    smooth,
)

EXTERNAL = "external"
"""Name of the function that a compiled library holds; no model file can call it."""
_FUNCTIONS: Mapping[str, str] = {"abs": "Abs", "min": "Min", "max": "Max"}


@lru_cache(maxsize=4096)
def _within(x: Any, left: Any, right: Any) -> Any:
    """Kept, since the rows of a table of two places ask for it again and SymPy takes long."""
    return sp.Min(sp.Max(x, left), right)


def _where_positive(test: Any, yes: Any, no: Any) -> Any:
    return sp.Piecewise((yes, test > 0), (no, True))


_WRITTEN: Mapping[str, Callable[..., Any]] = {
    "hypot": lambda a, b: sp.sqrt(a**2 + b**2),
    "mod": lambda a, b: a - b * sp.floor(a / b),
    "where": lambda condition, a, b: sp.Piecewise((a, condition), (b, True)),
    # Half of what follows x are places, half values.
    "table": lambda x, *knots: _straight_lines(
        x, knots[: len(knots) // 2], knots[len(knots) // 2 :]
    ),
    "cubic": lambda x, *knots: smooth(
        x, knots[: len(knots) // 2], knots[len(knots) // 2 :], _within, _where_positive
    ),
}
"""What is put together from other operations."""
_OPERATORS: Mapping[str, Callable[..., Any]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "**": lambda a, b: a**b,
    "neg": lambda a: -a,
}
_CONDITIONS: Mapping[str, str] = {
    "<": "Lt", "<=": "Le", ">": "Gt", ">=": "Ge", "==": "Eq", "!=": "Ne",
    "and": "And", "or": "Or", "not": "Not",
}  # fmt: skip


def meaning(node: Operation | Call) -> Callable[..., Any]:
    """The operation or function of a node, on SymPy expressions."""
    if isinstance(node, Operation):
        return _OPERATORS.get(node.operator) or getattr(sp, _CONDITIONS[node.operator])
    if node.function == EXTERNAL:
        # their classes need SymPy, which texts without such a call do not
        functions = import_module("residuum.identification.physics.compile.equation_functions")
        value = functions.ExternalValue
        t = sp.Symbol("t", real=True)
        return lambda number, *operands: value(number, t, *operands)
    return _WRITTEN.get(node.function) or getattr(sp, _FUNCTIONS.get(node.function, node.function))


def _straight_lines(x: Any, places: Sequence[Any], values: Sequence[Any]) -> Any:
    """y₁ + Σ_k (y_{k+1} − y_k) / (x_{k+1} − x_k) · (min(max(x, x_k), x_{k+1}) − x_k): held beyond
    the places.
    """
    knots = zip(pairwise(places), pairwise(values), strict=True)
    return values[0] + sum(
        (b - a) / (right - left) * (_within(x, left, right) - left)
        for (left, right), (a, b) in knots
    )


def number(node: Number) -> Any:
    """A literal; a whole one stays exact."""
    return (
        # Whole literals as integers: x**2 is then written as a product.
        sp.Integer(int(node.value)) if node.value == int(node.value) else sp.Float(node.value, 17)
    )


def symbolic(tree: Node, names: Mapping[str, Any], signs: Mapping[str, Any]) -> Any:
    """The expression with its names replaced; `sign(name)` is what `signs` has for the name, where
    it has something.
    """
    if isinstance(tree, Number):
        return number(tree)
    if isinstance(tree, Name):
        return names[tree.name]
    # sign() of a name that can stand still is the direction that the integrator switches.
    first = tree.operands[0]
    if (
        isinstance(tree, Call)
        and tree.function == "sign"
        and isinstance(first, Name)
        and first.name in signs
    ):
        return signs[first.name]
    return meaning(tree)(*(symbolic(operand, names, signs) for operand in tree.operands))
