"""A model as a Python file that needs NumPy alone."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.export.explicit_model import ExplicitModel


def python_source(model: ExplicitModel) -> str:
    """One file with `PARAMETERS`, `rates`, `outputs` and `simulate(t, u, parameters=None, initial=None, substeps=10)`."""
    parameters = [f'    "{name}": {model.values[name]!r},  # {model.described(name)}' for name in model.parameters]
    return "\n".join(
        [
            *model.head("#"),
            "import functools  # noqa: F401",
            "",
            "import numpy as np",
            "",
            f"STATES = {list(model.states)!r}",
            f"INPUTS = {list(model.inputs)!r}",
            f"OUTPUTS = {list(model.outputs)!r}",
            "PARAMETERS = {",
            *parameters,
            "}",
            "",
            "",
            *_function(model, "first_states", model.initial, with_states=False),
            *_function(model, "rates", model.rates),
            *_function(model, "outputs", model.outputs),
            _SIMULATE,
        ]
    )


_SIMULATE = '''def simulate(t, u, parameters=None, initial=None, substeps=10):
    """Outputs (n, outputs) at the times t (n,) for inputs u (n, inputs), held from each time to the next."""
    p = {**PARAMETERS, **(parameters or {})}
    u = np.asarray(u, dtype=float).reshape(len(t), -1)
    x = np.asarray(first_states(t[0], u[0], p) if initial is None else initial, dtype=float)
    y = np.empty((len(t), len(OUTPUTS)))
    for k in range(len(t)):
        y[k] = outputs(t[k], x, u[k], p)
        if k + 1 == len(t):
            break
        h = (t[k + 1] - t[k]) / substeps
        for i in range(substeps):
            now = t[k] + i * h
            k1 = np.asarray(rates(now, x, u[k], p))
            k2 = np.asarray(rates(now + h / 2, x + h / 2 * k1, u[k], p))
            k3 = np.asarray(rates(now + h / 2, x + h / 2 * k2, u[k], p))
            k4 = np.asarray(rates(now + h, x + h * k3, u[k], p))
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return y
'''


def _function(model: ExplicitModel, name: str, expressions: Any, *, with_states: bool = True) -> list[str]:
    used = set().union(*(sp.sympify(e).free_symbols for e in expressions.values())) if expressions else set()
    families = [("u", model.inputs), *([("x", model.states)] if with_states else [])]
    local = [f"    {n} = {letter}[{k}]" for letter, names in families for k, n in enumerate(names) if model.symbols[n] in used]
    local += [f'    {n} = p["{n}"]' for n in model.parameters if model.symbols[n] in used]
    printed = import_module("sympy.printing.numpy").NumPyPrinter()
    values = [f"        {_code(printed, e)}," for e in expressions.values()]
    arguments = "time, x, u, p" if with_states else "time, u, p"
    return [f"def {name}({arguments}):", *local, "    return [", *values, "    ]", "", ""]


def _code(printer: Any, expression: Any) -> str:
    return str(printer.doprint(sp.sympify(expression))).replace("numpy.", "np.")
