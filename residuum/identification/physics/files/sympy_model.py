"""SymPy expressions of time derivatives as the table of a model file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import sympy as sp
from sympy.printing.str import StrPrinter

from residuum.identification.errors import BadModel
from residuum.identification.physics.model import BALANCE_KINDS
from residuum.nearest_names import known_names

_FUNCTIONS = {
    sp.sin: "sin",
    sp.cos: "cos",
    sp.tan: "tan",
    sp.asin: "asin",
    sp.acos: "acos",
    sp.atan: "atan",
    sp.atan2: "atan2",
    sp.sinh: "sinh",
    sp.cosh: "cosh",
    sp.tanh: "tanh",
    sp.floor: "floor",
    sp.exp: "exp",
    sp.log: "log",
    sp.Abs: "abs",
    sp.sign: "sign",
    sp.Min: "min",
    sp.Max: "max",
}
_ROLES = {
    "torque": "velocity",
    "force": "velocity",
    "voltage": "current",
    "heat": "temperature",
    "volume": "level",
}

Units = tuple[Mapping[str, str], Mapping[str, str], Mapping[str, tuple[float, str]]]
"""Units of states and inputs; values and units of parameters."""


class _Text(StrPrinter):
    """Expressions as model files have them."""

    def _print_Function(self, expression: Any) -> str:
        name = _FUNCTIONS.get(type(expression))
        if name is None:
            written = expression.func.__name__
            known = known_names(written, _FUNCTIONS.values(), "there are")
            raise BadModel(f"equations: {written} is not known in models; {known}")
        return f"{name}({', '.join(map(self._print, expression.args))})"

    _print_Abs = _print_sign = _print_Min = _print_Max = _print_LatticeOp = _print_ExpBase = (
        _print_Function
    )

    def _print_Float(self, expression: Any) -> str:
        return repr(float(expression))

    def _print_Rational(self, expression: Any) -> str:
        return f"{expression.p}/{expression.q}"

    def _print_Piecewise(self, expression: Any) -> str:
        *cases, (last, condition) = expression.args
        if condition != sp.true:
            raise BadModel(
                "equations: the last case of a Piecewise must hold whatever else does (True)"
            )
        text = self._print(last)
        # From the inside out: the first case stands outermost, so it is asked first.
        for value, condition in reversed(cases):
            text = f"where({self._condition(condition)}, {self._print(value)}, {text})"
        return text

    def _condition(self, condition: Any) -> str:
        if condition.is_Relational:
            return f"{self._print(condition.lhs)} {condition.rel_op} {self._print(condition.rhs)}"
        parts = [f"({self._condition(part)})" for part in condition.args]
        if isinstance(condition, sp.Not):
            return f"not {parts[0]}"
        if isinstance(condition, sp.And | sp.Or):
            return (" and " if isinstance(condition, sp.And) else " or ").join(parts)
        raise BadModel(
            f"equations: the condition {condition} is not known in models; write it with"
            " comparisons, and, or, not"
        )


def model_table(
    name: str,
    rates: Mapping[str, Any],
    outputs: Mapping[str, Any],
    units: Units,
    kinds: Mapping[str, str],
) -> dict[str, Any]:
    """The table of a model file: a balance a state, with the rate as its one term; see
    `residuum.library.foreign_models`.
    """
    states, inputs, parameters = units
    printer = _Text()
    text = {state: printer.doprint(sp.sympify(rate)) for state, rate in rates.items()}
    # A rate that is nothing but another state: that one is its velocity.
    positions = {state: rate for state, rate in text.items() if rate in states}
    table: dict[str, Any] = {
        "name": name,
        "inputs": dict(inputs),
        "states": {
            state: {"unit": unit} | ({"rate": positions[state]} if state in positions else {})
            for state, unit in states.items()
        },
        "parameters": {
            key: {"value": float(value), "unit": unit} for key, (value, unit) in parameters.items()
        },
        "balances": {},
        "outputs": {
            key: {
                "value": printer.doprint(sp.sympify(value)),
                "unit": _unit_of(value, states, inputs),
            }
            for key, value in outputs.items()
        },
    }
    for state in states:
        if state not in positions:
            table["balances"][state] = _balance(state, text[state], states[state], kinds, positions)
    return table


def _balance(
    state: str, rate: str, unit: str, kinds: Mapping[str, str], positions: Mapping[str, str]
) -> dict[str, Any]:
    kind = kinds.get(state, "signal")
    if kind not in BALANCE_KINDS:
        raise BadModel(
            f"equations, kind of {state!r}: {kind!r} is not known;"
            f" {known_names(kind, BALANCE_KINDS, 'there are')}"
        )
    balance: dict[str, Any] = {"kind": kind, "storage": f"der({state})", "terms": {"rate": rate}}
    if kind in _ROLES:
        balance[_ROLES[kind]] = state
    # The state whose rate this one is.
    position = next((name for name, rate_of in positions.items() if rate_of == state), None)
    if position is not None and _ROLES.get(kind) == "velocity":
        balance["position"] = position
    return balance


def _unit_of(value: Any, states: Mapping[str, str], inputs: Mapping[str, str]) -> str:
    """The unit of an output that is one state or input; any other has none unless its file is
    written by hand.
    """
    return {**states, **inputs}.get(str(value), "")
