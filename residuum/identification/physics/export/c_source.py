"""A model as C99: rates, outputs, first states and a Runge–Kutta step, without any dependency but <math.h>."""

from __future__ import annotations

from typing import Any

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.export.explicit_model import ExplicitModel


def c_source(model: ExplicitModel) -> str:
    """One file: `NAME_parameters`, `NAME_initial`, `NAME_rates`, `NAME_outputs`, `NAME_step` (inputs held over the step)."""
    name, n = model.name, max(len(model.states), 1)
    counts = {
        "STATES": len(model.states),
        "INPUTS": len(model.inputs),
        "OUTPUTS": len(model.outputs),
        "PARAMETERS": len(model.parameters),
    }
    values = ", ".join(repr(model.values[p]) for p in model.parameters) or "0.0"
    of_all = "double t, const double *x, const double *u, const double *p"
    stages = ("0.0", "0.5 * h", "0.5 * h", "h")
    return "\n".join(
        [
            *model.head("//"),
            "#include <math.h>",
            "",
            *(f"#define {name.upper()}_{key} {count}" for key, count in counts.items()),
            *_table(model, "x", model.states),
            *_table(model, "u", model.inputs),
            *_table(model, "p", model.parameters),
            *_table(model, "y", tuple(model.outputs)),
            "",
            "static inline double residuum_sign(double v) { return (v > 0.0) - (v < 0.0); }",
            f"const double {name}_parameters[] = {{{values}}};",
            "",
            *_function(model, f"void {name}_initial(double t, const double *u, const double *p, double *x)", "x", model.initial),
            *_function(model, f"void {name}_rates({of_all}, double *dx)", "dx", model.rates),
            *_function(model, f"void {name}_outputs({of_all}, double *y)", "y", model.outputs),
            f"void {name}_step(double t, double h, double *x, const double *u, const double *p)",
            "{",
            f"    double k[4][{n}], at[{n}];",
            *(line for stage, part in enumerate(stages) for line in _stage(name, stage, part, len(model.states))),
            f"    for (int i = 0; i < {len(model.states)}; ++i)",
            "        x[i] += h / 6.0 * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]);",
            "}",
            "",
        ]
    )


def _stage(name: str, stage: int, part: str, n: int) -> list[str]:
    last = f" + {part} * k[{stage - 1}][i]" if stage else ""
    return [
        f"    for (int i = 0; i < {n}; ++i) at[i] = x[i]{last};",
        f"    {name}_rates(t + {part}, at, u, p, k[{stage}]);",
    ]


def _table(model: ExplicitModel, letter: str, names: tuple[str, ...]) -> list[str]:
    return [f"// {letter}[{k}]: {model.described(name)}" for k, name in enumerate(names)]


def _function(model: ExplicitModel, signature: str, target: str, expressions: Any) -> list[str]:
    arrays = {"x": model.states, "u": model.inputs, "p": model.parameters}
    used = set().union(*(sp.sympify(e).free_symbols for e in expressions.values())) if expressions else set()
    local = [
        f"    const double {name} = {letter}[{k}];"
        for letter, names in arrays.items()
        for k, name in enumerate(names)
        if model.symbols[name] in used and not (letter == "x" and target == "x")
    ]
    clock = ["    const double time = t;"] if model.symbols["time"] in used else ["    (void)t;"]
    unused = [f"    (void){letter};" for letter in arrays if f"*{letter}," in signature + "," and letter != target]
    body = [f"    {target}[{k}] = {_code(e)};" for k, e in enumerate(expressions.values())]
    return [signature, "{", *clock, *unused, *local, *body, "}", ""]


def _code(expression: Any) -> str:
    return str(sp.ccode(sp.sympify(expression).evalf(17), standard="c99", user_functions={"sign": "residuum_sign"}))
