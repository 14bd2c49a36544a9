"""A model as C99: rates, outputs, first states and steps, without any dependency but <math.h>."""

from __future__ import annotations

from typing import Any

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.export.c_stepping import c_stepping
from residuum.identification.physics.export.explicit_model import ExplicitModel


def c_source(model: ExplicitModel) -> str:
    """One file: `NAME_parameters`, `NAME_initial`, `NAME_rates`, `NAME_outputs`, `NAME_step` and `NAME_advance` (inputs held).

    Each effect's term is a function of its own, `NAME_EFFECT_PLACE`.
    """
    name = model.name
    counts = {
        "STATES": len(model.states),
        "INPUTS": len(model.inputs),
        "OUTPUTS": len(model.outputs),
        "PARAMETERS": len(model.parameters),
        "COMPONENTS": len(model.components),
    }
    values = ", ".join(repr(model.values[p]) for p in model.parameters) or "0.0"
    of_all = "double t, const double *x, const double *u, const double *p"
    surfaces = [model.states.index(v) for v in model.directions]
    return "\n".join(
        [
            *model.head("//", at_rest=True),
            "#include <math.h>",
            "",
            *(f"#define {name.upper()}_{key} {count}" for key, count in counts.items()),
            *_table(model, "x", model.states),
            *_table(model, "u", model.inputs),
            *_table(model, "p", model.parameters),
            *_table(model, "y", tuple(model.outputs)),
            *(f"// s[{k}]: direction of {model.described(v)}" for k, v in enumerate(model.directions)),
            "",
            "static inline double residuum_sign(double v) { return (v > 0.0) - (v < 0.0); }",
            f"const double {name}_parameters[] = {{{values}}};",
            "",
            *_function(model, f"void {name}_initial(double t, const double *u, const double *p, double *x)", "x", model.initial),
            *(line for key in model.components for line in _component(model, key, of_all)),
            *_function(model, f"void {name}_rates_by_direction({of_all}, const double *s, double *dx)", "dx", model.rates),
            *_function(model, f"void {name}_outputs({of_all}, double *y)", "y", model.outputs),
            *c_stepping(name, len(model.states), surfaces),
            "",
        ]
    )


def _component(model: ExplicitModel, key: str, of_all: str) -> list[str]:
    part = model.components[key]
    signature = f"double {model.name}_{key}({of_all}, const double *s)"
    return [f"// {part.title} [{part.unit}]", *_function(model, signature, "return", {key: part.expression})]


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
    local += [f"    const double {d.name} = s[{k}];" for k, d in enumerate(model.directions.values()) if d in used]
    local += [
        f"    const double {key} = {model.name}_{key}(t, x, u, p, s);" for key in model.components if model.symbols[key] in used
    ]
    clock = ["    const double time = t;"] if model.symbols["time"] in used else ["    (void)t;"]
    letters = (*arrays, "s")
    unused = [f"    (void){letter};" for letter in letters if f"*{letter}," in signature.replace(")", ",") and letter != target]
    places = ["return"] if target == "return" else [f"{target}[{k}] =" for k in range(len(expressions))]
    body = [f"    {place} {_code(e)};" for place, e in zip(places, expressions.values(), strict=True)]
    return [signature, "{", *clock, *unused, *local, *body, "}", ""]


def _code(expression: Any) -> str:
    return str(sp.ccode(sp.sympify(expression).evalf(17), standard="c99", user_functions={"sign": "residuum_sign"}))
