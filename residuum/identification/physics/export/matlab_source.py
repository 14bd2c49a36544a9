"""A model as a MATLAB function file."""

from __future__ import annotations

from typing import Any

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.export.explicit_model import ExplicitModel


def matlab_source(model: ExplicitModel) -> str:
    """`[y, x] = NAME(t, u, p)`: outputs and states at the times t for inputs u (n, inputs), held; p
    overrides parameters.
    """
    return "\n".join(
        [
            f"function [y, x] = {model.name}(t, u, p)",
            *model.head("%"),
            *(f"% u(:, {k + 1}): {model.described(n)}" for k, n in enumerate(model.inputs)),
            *(f"% x(:, {k + 1}): {model.described(n)}" for k, n in enumerate(model.states)),
            *(f"% y(:, {k + 1}): {model.described(n)}" for k, n in enumerate(model.outputs)),
            *(f"q.{n} = {model.values[n]!r}; % {model.described(n)}" for n in model.parameters),
            "if nargin > 2, for name = fieldnames(p)', q.(name{1}) = p.(name{1}); end, end",
            (
                # Ten fixed steps a sample: what a reader can follow, and no toolbox is needed.
                f"n = numel(t); substeps = 10; x = zeros(n, {len(model.states)}); y = zeros(n,"
                f" {len(model.outputs)});"
            ),
            "x(1, :) = first_states(t(1), u(1, :), q);",
            "for k = 1:n",
            "    y(k, :) = outputs(t(k), x(k, :), u(k, :), q);",
            "    if k == n, break, end",
            "    h = (t(k + 1) - t(k)) / substeps; s = x(k, :);",
            "    for i = 0:substeps - 1",
            "        now = t(k) + i * h;",
            "        k1 = rates(now, s, u(k, :), q);",
            "        k2 = rates(now + h / 2, s + h / 2 * k1, u(k, :), q);",
            "        k3 = rates(now + h / 2, s + h / 2 * k2, u(k, :), q);",
            "        k4 = rates(now + h, s + h * k3, u(k, :), q);",
            "        s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);",
            "    end",
            "    x(k + 1, :) = s;",
            "end",
            "end",
            "",
            *_function(model, "first_states(time, u, q)", model.initial, ("u",)),
            *_function(model, "rates(time, x, u, q)", model.rates, ("x", "u")),
            *(
                line
                for key, part in model.components.items()
                for line in [
                    f"% {part.title} [{part.unit}]",
                    *_function(
                        model, f"{key}_of(time, x, u, q)", {key: part.expression}, ("x", "u")
                    ),
                ]
            ),
            *_function(model, "outputs(time, x, u, q)", model.outputs, ("x", "u")),
        ]
    )


def _function(
    model: ExplicitModel, signature: str, expressions: Any, arrays: tuple[str, ...]
) -> list[str]:
    # No directions in MATLAB texts: sign(v) of an exact zero is 0, as their head says.
    expressions = {name: model.with_signs(e) for name, e in expressions.items()}
    used = model.symbols_in(expressions)
    families = {"x": model.states, "u": model.inputs}
    local = [
        f"{n} = {a}({k + 1});"
        for a in arrays
        for k, n in enumerate(families[a])
        if model.symbols[n] in used
    ]
    local += [f"{n} = q.{n};" for n in model.parameters if model.symbols[n] in used]
    local += [
        f"{key} = {key}_of(time, x, u, q);"
        for key in model.components
        if model.symbols[key] in used
    ]
    local += [f"{n} = {sp.octave_code(e)};" for n, e in model.defined_in(used).items()]
    values = ", ".join(f"({sp.octave_code(e)})" for e in expressions.values())
    return [f"function value = {signature}", *local, f"value = [{values}];", "end", ""]
