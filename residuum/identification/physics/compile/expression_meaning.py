"""What a parsed expression means in SymPy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.files.expression import Call, Name, Node, Number, Operation

EXTERNAL = "external"
"""Name of the function that a compiled library holds; no model file can call it."""
_FUNCTIONS: Mapping[str, str] = {"abs": "Abs", "min": "Min", "max": "Max"}
_OPERATORS: Mapping[str, Callable[..., Any]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "**": lambda a, b: a**b,
    "neg": lambda a: -a,
}


def meaning(node: Operation | Call) -> Callable[..., Any]:
    """The operation or function of a node, on SymPy expressions."""
    if isinstance(node, Operation):
        return _OPERATORS[node.operator]
    if node.function == EXTERNAL:
        value = import_module("residuum.identification.physics.compile.external").ExternalValue
        return lambda number, *operands: value(number, sp.Symbol("t", real=True), *operands)
    return getattr(sp, _FUNCTIONS.get(node.function, node.function))


def number(node: Number) -> Any:
    """A literal; a whole one stays exact."""
    return sp.Integer(int(node.value)) if node.value == int(node.value) else sp.Float(node.value, 17)


def symbolic(tree: Node, names: Mapping[str, Any], signs: Mapping[str, Any]) -> Any:
    """The expression with its names replaced; `sign(name)` is what `signs` has for the name, where it has something."""
    if isinstance(tree, Number):
        return number(tree)
    if isinstance(tree, Name):
        return names[tree.name]
    first = tree.operands[0]
    if isinstance(tree, Call) and tree.function == "sign" and isinstance(first, Name) and first.name in signs:
        return signs[first.name]
    return meaning(tree)(*(symbolic(operand, names, signs) for operand in tree.operands))
