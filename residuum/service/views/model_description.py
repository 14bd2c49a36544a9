"""A physical model as a page shows it: signals, parameters, balances as expression trees, effects with their history."""

from __future__ import annotations

from typing import Any

from residuum.identification.physics import PhysicalModel
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.physics.files.expression import Call, Name, Node, Number


def describe(model: PhysicalModel) -> dict[str, Any]:
    """The model as plain values; an expression is a tree of `["+", a, b]`, names (text) and numbers."""
    return {
        "name": model.name,
        "inputs": [
            {"name": signal.name, "unit": signal.unit, "required": signal.default is None} for signal in model.inputs.values()
        ],
        "outputs": [
            {"name": output.name, "unit": output.unit, "value": _tree(output.value.tree)} for output in model.outputs.values()
        ],
        "states": [{"name": state.name, "unit": state.unit, "rate": state.rate} for state in model.states.values()],
        "parameters": [_parameter(name, parameter) for name, parameter in model.all_parameters.items()],
        "balances": [
            {
                "name": balance.name,
                "kind": balance.kind,
                "unit": balance.unit,
                "storage": _tree(balance.storage.tree),
                "terms": [{"name": name, "value": _tree(term.tree)} for name, term in balance.terms.items()],
            }
            for balance in model.balances.values()
        ],
        "effects": [
            {
                "effect": use.id,
                "title": use.effect.title,
                "equation": use.effect.equation,
                "target": use.target,
                "label": use.label,
                "parameters": [_parameter(name, parameter) for name, parameter in use.parameters.items()],
                "provenance": dict(use.provenance),
            }
            for use in model.effects
        ],
    }


def _parameter(name: str, parameter: Parameter) -> dict[str, Any]:
    return {
        "name": name,
        "value": parameter.value,
        "unit": parameter.unit,
        "lower": parameter.lower,
        "upper": parameter.upper,
        "fixed": parameter.fixed,
        "meaning": parameter.meaning,
    }


def _tree(node: Node) -> Any:
    if isinstance(node, Number):
        return node.value
    if isinstance(node, Name):
        return node.name
    if isinstance(node, Call) and node.function in ("table", "cubic"):
        first, *knots = map(_tree, node.operands)
        return ["table", first, ["[]", *knots[: len(knots) // 2]], ["[]", *knots[len(knots) // 2 :]]]
    return [node.function if isinstance(node, Call) else node.operator, *map(_tree, node.operands)]
