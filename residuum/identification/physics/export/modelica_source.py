"""A model as Modelica text."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.export.explicit_model import ExplicitModel


def modelica_source(model: ExplicitModel) -> str:
    """A flat model: parameters, inputs, outputs, states with their first values, and one equation
    each.
    """
    parameters = [
        f'  parameter Real {n} = {model.values[n]!r} "{model.described(n)}";'
        for n in model.parameters
    ]
    inputs = [f'  input Real {n} "{model.described(n)}";' for n in model.inputs]
    states = [f'  Real {n} "{model.described(n)}";' for n in model.states]
    terms = [f'  Real {n} "{part.title} [{part.unit}]";' for n, part in model.components.items()]
    outputs = [f'  output Real y_{n} "{model.described(n)}";' for n in model.outputs]
    return "\n".join(
        [
            *model.head("//"),
            f'model {model.name} "{model.title}"',
            *parameters,
            *inputs,
            *states,
            *terms,
            *outputs,
            "initial equation",
            *(f"  {n} = {_code(e)};" for n, e in model.initial.items()),
            "equation",
            *(f"  der({n}) = {_code(model.with_signs(e))};" for n, e in model.rates.items()),
            *(
                f"  {n} = {_code(model.with_signs(part.expression))};"
                for n, part in model.components.items()
            ),
            *(f"  y_{n} = {_code(e)};" for n, e in model.outputs.items()),
            f"end {model.name};",
            "",
        ]
    )


def _code(expression: Any) -> str:
    expression = sp.sympify(expression)
    if isinstance(expression, sp.Piecewise):
        *cases, (last, _) = expression.args
        parts = [
            f"{'else' if k else ''}if {_code(condition)} then {_code(value)} "
            for k, (value, condition) in enumerate(cases)
        ]
        return f"(noEvent({''.join(parts)}else {_code(last)}))" if parts else _code(last)
    if expression.is_Relational:
        return (
            f"{_code(expression.lhs)} {'<>' if expression.rel_op == '!=' else expression.rel_op}"
            f" {_code(expression.rhs)}"
        )
    if isinstance(expression, sp.And | sp.Or):
        return (" and " if isinstance(expression, sp.And) else " or ").join(
            f"({_code(part)})" for part in expression.args
        )
    if isinstance(expression, sp.Not):
        return f"not ({_code(expression.args[0])})"
    if isinstance(expression, sp.Min | sp.Max):
        name, (first, *operands) = expression.func.__name__.lower(), expression.args
        text = _code(first)
        for operand in operands:
            text = f"{name}({text}, {_code(operand)})"
        return text
    names = {
        part: sp.Symbol(f"residuum_part_{k}", real=True)
        for k, part in enumerate(dict.fromkeys(_chosen_parts(expression)))
    }
    texts = {symbol.name: _code(part) for part, symbol in names.items()}
    printed = sp.sstr(expression.xreplace(names).evalf(17))
    return re.sub(
        r"residuum_part_\d+",
        lambda name: texts[name[0]],
        printed.replace("**", "^").replace("Abs(", "abs("),
    )


def _chosen_parts(expression: Any) -> Iterator[Any]:
    """What is written otherwise than SymPy writes it, the outermost of each."""
    if isinstance(expression, sp.Piecewise | sp.Min | sp.Max):
        yield expression
    else:
        for part in expression.args:
            yield from _chosen_parts(part)
