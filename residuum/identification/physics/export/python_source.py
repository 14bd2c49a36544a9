"""A model as a Python file that needs NumPy alone."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.export.explicit_model import ExplicitModel


def python_source(model: ExplicitModel) -> str:
    """One file with `PARAMETERS`, `rates`, `outputs` and `simulate(t, u, parameters=None,
    initial=None, tolerance=1e-9)`.

    Each effect's term is a function of its own, named after it.
    """
    parameters = [
        f'    "{name}": {model.values[name]!r},  # {model.described(name)}'
        for name in model.parameters
    ]
    return "\n".join(
        [
            *model.head("#", at_rest=True),
            "import functools  # noqa: F401",
            "",
            "import numpy as np",
            "",
            f"STATES = {list(model.states)!r}",
            f"INPUTS = {list(model.inputs)!r}",
            f"OUTPUTS = {list(model.outputs)!r}",
            (
                f"SURFACES = {[model.states.index(v) for v in model.directions]!r}  # states that"
                " can stand still"
            ),
            "PARAMETERS = {",
            *parameters,
            "}",
            "",
            "",
            *_function(model, "first_states", model.initial, "time, u, p"),
            *(line for key in model.components for line in _component(model, key)),
            *_function(model, "rates_by_direction", model.rates, "time, x, u, p, s"),
            *_function(model, "outputs", model.outputs, "time, x, u, p"),
            _SIMULATE,
        ]
    )


_SIMULATE = '''def at_rest(time, x, u, p, s, j):
    """Direction of surface j, whose velocity is zero, and 0 where it rests: while f+ <= 0 <= f- on its two sides."""
    s = list(s)
    s[j] = 1.0
    forward = rates_by_direction(time, x, u, p, s)[SURFACES[j]]
    s[j] = -1.0
    backward = rates_by_direction(time, x, u, p, s)[SURFACES[j]]
    if forward > 0.0 and forward + backward >= 0.0:
        return 1.0, 1.0
    if backward < 0.0:
        return -1.0, 1.0
    return 0.0, 1.0 if forward == backward else 0.0


def directions(time, x, u, p):
    """Direction of each surface and whether it moves."""
    s, m = [float(np.sign(x[i])) for i in SURFACES], [1.0] * len(SURFACES)
    for j, i in enumerate(SURFACES):
        if x[i] == 0.0:
            s[j], m[j] = at_rest(time, x, u, p, s, j)
    return s, m


def moving(time, x, u, p, s, m):
    """dx/dt with these directions; a surface that rests has none."""
    dx = np.array(rates_by_direction(time, x, u, p, s), dtype=float)
    for j, i in enumerate(SURFACES):
        dx[i] *= m[j]
    return dx


def rates(time, x, u, p):
    """dx/dt."""
    return moving(time, x, u, p, *directions(time, x, u, p))


NODES = (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0)
WEIGHTS = (
    (),
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
ERRORS = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)


def tried(time, h, x, u, p, s, m, tolerance):
    """A step of Dormand and Prince, and the largest part that its error is of what the tolerance allows."""
    k = []
    for node, weights in zip(NODES, WEIGHTS):
        y = x + h * sum((w * rate for w, rate in zip(weights, k)), np.zeros(len(x)))
        k.append(moving(time + node * h, y, u, p, s, m))
    size = np.abs(x) + np.abs(h * k[0]) + np.abs(y - x) + 1e-200
    wrong = np.abs(h * sum(e * rate for e, rate in zip(ERRORS, k)))
    return y, float(np.max(wrong / (tolerance * size), initial=0.0))


def turned(time, y, u, p, s, m):
    """Whether a step left the side of a surface that it was computed for, or a surface that rested breaks away."""
    for j, i in enumerate(SURFACES):
        if (m[j] and s[j] * y[i] < 0.0) or (not m[j] and at_rest(time, y, u, p, s, j)[1]):
            return True
    return False


def advance(time, h, x, u, p, tolerance):
    """States h later, inputs held; steps end where a velocity passes zero or a machine breaks away."""
    done, step = 0.0, h
    while done < h:
        s, m = directions(time + done, x, u, p)
        step = min(step, h - done)
        y, error = tried(time + done, step, x, u, p, s, m, tolerance)
        while error > 1.0 and step > 1e-12 * h:
            step *= max(0.1, 0.9 * error**-0.2)
            y, error = tried(time + done, step, x, u, p, s, m, tolerance)
        if not np.isfinite(error):
            return np.full(len(x), np.nan)
        grown = step * min(5.0, 0.9 * (error + 1e-10) ** -0.2)
        if turned(time + done + step, y, u, p, s, m):
            before, after = 0.0, step
            while after - before > 1e-15 * h and before < 0.5 * (before + after) < after:
                middle = 0.5 * (before + after)
                y, _ = tried(time + done, middle, x, u, p, s, m, tolerance)
                before, after = (before, middle) if turned(time + done + middle, y, u, p, s, m) else (middle, after)
            y, _ = tried(time + done, after, x, u, p, s, m, tolerance)
            for j, i in enumerate(SURFACES):
                if m[j] and s[j] * y[i] < 0.0:
                    y[i] = 0.0
            step = after
        x, done = y, h if step >= h - done else done + step
        step = grown
    return x


def simulate(t, u, parameters=None, initial=None, tolerance=1e-9):
    """Outputs (n, outputs) at the times t (n,) for inputs u (n, inputs), held from each time to the next."""
    p = {**PARAMETERS, **(parameters or {})}
    u = np.asarray(u, dtype=float).reshape(len(t), -1)
    x = np.asarray(first_states(t[0], u[0], p) if initial is None else initial, dtype=float)
    y = np.empty((len(t), len(OUTPUTS)))
    for k in range(len(t)):
        y[k] = outputs(t[k], x, u[k], p)
        if k + 1 < len(t):
            x = advance(t[k], t[k + 1] - t[k], x, u[k], p, tolerance)
    return y
'''


def _component(model: ExplicitModel, key: str) -> list[str]:
    part = model.components[key]
    lines = _function(model, key, {key: part.expression}, "time, x, u, p, s")
    return [lines[0], f'    """{part.title} [{part.unit}]."""', *lines[1:]]


def _function(model: ExplicitModel, name: str, expressions: Any, arguments: str) -> list[str]:
    used = model.symbols_in(expressions)
    # Imported with the first text: SymPy takes a fifth of a second.
    printed = import_module("sympy.printing.numpy").NumPyPrinter()
    local = _locals(model, used, arguments.split(", "))
    local += [f"    {n} = {_code(printed, e)}" for n, e in model.defined_in(used).items()]
    now = {model.symbols[key]: sp.Symbol(f"{key}_now", real=True) for key in model.components}
    values = [_code(printed, sp.sympify(e).subs(now)) for e in expressions.values()]
    body = (
        [f"    return {values[0]}"]
        if name in model.components
        else ["    return [", *(f"        {v}," for v in values), "    ]"]
    )
    return [f"def {name}({arguments}):", *local, *body, "", ""]


def _locals(model: ExplicitModel, used: set[Any], arguments: Sequence[str]) -> list[str]:
    """A variable for each symbol that expressions name: an element of an argument, or an effect's
    term.
    """
    lines = []
    for letter, names in (("u", model.inputs), ("x", model.states)):
        if letter in arguments:
            lines += [
                f"{n} = {letter}[{k}]" for k, n in enumerate(names) if model.symbols[n] in used
            ]
    lines += [f'{n} = p["{n}"]' for n in model.parameters if model.symbols[n] in used]
    lines += [f"{d.name} = s[{k}]" for k, d in enumerate(model.directions.values()) if d in used]
    # an effect's term has the name of the function that gives it
    terms = [key for key in model.components if model.symbols[key] in used]
    lines += [f"{key}_now = {key}(time, x, u, p, s)" for key in terms]
    return [f"    {line}" for line in lines]


def _code(printer: Any, expression: Any) -> str:
    return str(printer.doprint(expression)).replace("numpy.", "np.")
