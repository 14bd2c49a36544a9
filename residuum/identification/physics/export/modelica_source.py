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
    defined = [f"  Real {n};" for n in model.defined]
    terms = [f'  Real {n} "{part.title} [{part.unit}]";' for n, part in model.components.items()]
    outputs = [f'  output Real y_{n} "{model.described(n)}";' for n in model.outputs]
    return "\n".join(
        [
            *model.head("//"),
            f'model {model.name} "{model.title}"',
            *parameters,
            *inputs,
            *states,
            *defined,
            *terms,
            *outputs,
            "initial equation",
            *(f"  {n} = {_code(e)};" for n, e in model.initial.items()),
            "equation",
            *(f"  {n} = {_code(model.with_signs(e))};" for n, e in model.defined.items()),
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
    """An expression in Modelica's syntax. What SymPy writes otherwise, anywhere in it, is printed
    apart and put in for a name.
    """
    expression = sp.sympify(expression)
    if isinstance(expression, sp.Piecewise):
        return _piecewise_code(expression)
    if expression.is_Relational:
        relation = "<>" if expression.rel_op == "!=" else expression.rel_op
        return f"{_code(expression.lhs)} {relation} {_code(expression.rhs)}"
    if isinstance(expression, sp.And | sp.Or | sp.Not):
        return _logic_code(expression)
    if isinstance(expression, sp.Min | sp.Max):
        return _extreme_code(expression)
    names = {
        part: sp.Symbol(f"residuum_part_{k}", real=True)
        for k, part in enumerate(dict.fromkeys(_chosen_parts(expression)))
    }
    # Parts first, by themselves: SymPy's printer would write Min, Max and Piecewise its own way.
    texts = {symbol.name: _code(part) for part, symbol in names.items()}
    # 17 digits say every double exactly.
    printed = sp.sstr(expression.xreplace(names).evalf(17))
    return re.sub(
        r"residuum_part_\d+",
        lambda name: texts[name[0]],
        printed.replace("**", "^").replace("Abs(", "abs("),
    )


def _piecewise_code(expression: Any) -> str:
    """if … then … else, which are no events for Modelica's solver (`noEvent`)."""
    *cases, (last, _) = expression.args
    parts = [
        f"{'else' if k else ''}if {_code(condition)} then {_code(value)} "
        for k, (value, condition) in enumerate(cases)
    ]
    return f"(noEvent({''.join(parts)}else {_code(last)}))" if parts else _code(last)


def _logic_code(expression: Any) -> str:
    parts = [f"({_code(part)})" for part in expression.args]
    if isinstance(expression, sp.Not):
        return f"not {parts[0]}"
    return (" and " if isinstance(expression, sp.And) else " or ").join(parts)


def _extreme_code(expression: Any) -> str:
    """min(min(a, b), c): Modelica's functions take two numbers."""
    name = expression.func.__name__.lower()
    (first, *operands) = expression.args
    text = _code(first)
    for operand in operands:
        text = f"{name}({text}, {_code(operand)})"
    return text


def _chosen_parts(expression: Any) -> Iterator[Any]:
    """What is written otherwise than SymPy writes it, the outermost of each."""
    # Not below such a part: `_code` of it looks for its own.
    if isinstance(expression, sp.Piecewise | sp.Min | sp.Max):
        yield expression
    else:
        for part in expression.args:
            yield from _chosen_parts(part)
