"""A model as dx/dt = f(t, x, u, p), y = h(t, x, u, p) with names that every language takes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from residuum.identification.errors import BadModel
from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.compile.composition import TIME, compose
from residuum.identification.physics.model import PhysicalModel, missing_name

LIMITS = (
    "Standstill: where the model has dry friction, sign(v) of an exactly zero velocity is 0 here.",
    "The original holds a machine at rest until the forces exceed the friction; here it may creep by a step's length.",
)
"""What the text cannot do as the original does; stands in its head."""


@dataclass(frozen=True, eq=False)
class ExplicitModel:
    """Names, units and expressions of one model.

    `states`, `inputs`, `parameters` are identifiers in order; `symbols` has the symbol of each, and `time`; `rates` and `initial`
    are by state, `outputs` by identifier; `units` and `meanings` by identifier; `values` by parameter.
    """

    name: str
    title: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    symbols: Mapping[str, Any]
    rates: Mapping[str, Any]
    initial: Mapping[str, Any]
    outputs: Mapping[str, Any]
    units: Mapping[str, str]
    meanings: Mapping[str, str]
    values: Mapping[str, float]

    def head(self, comment: str) -> list[str]:
        """The first lines of any text: what it is, and its limits."""
        rubs = any(rate.has(sp.sign) for rate in self.rates.values())
        lines = [
            f"Model {self.title!r}, written by Residuum. Inputs, states, outputs and parameters in the units named beside them."
        ]
        return [f"{comment} {line}" for line in [*lines, *(LIMITS if rubs else ())]]

    def described(self, name: str) -> str:
        """`full name [unit]`."""
        unit = self.units.get(name, "")
        return f"{self.meanings[name]} [{unit}]" if unit else self.meanings[name]


def explicit(model: PhysicalModel) -> ExplicitModel:
    """The model's equations with its effects, unknown terms left out.

    Raises
    ------
    BadModel
        An input that an effect delays: no text here has a memory of its inputs.
    """
    equations = compose(model)
    if equations.delays:
        delayed = next(iter(equations.delays))
        raise BadModel(
            f"export: input {delayed!r} is delayed (input-delay), which no exported text can hold; take the effect out"
        )
    missing = {equations.p[missing_name(balance)]: sp.S.Zero for balance in model.balances}
    own = [name for name in equations.p if name not in {missing_name(balance) for balance in model.balances}]
    taken: set[str] = {"time", "t", "x", "u", "p", "y", "dx"}
    states, inputs = _identifiers(equations.x, taken), _identifiers(model.inputs, taken)
    parameters, outputs = _identifiers(own, taken), _identifiers(equations.outputs, taken)
    symbols = {new: sp.Symbol(new, real=True) for family in (states, inputs, parameters) for new in family.values()}
    symbols["time"] = sp.Symbol("time", real=True)
    swap = missing | {TIME: symbols["time"]}
    for family, known in ((equations.x, states), (equations.u, inputs), (equations.p, parameters)):
        swap |= {symbol: symbols[known[name]] for name, symbol in family.items() if name in known}
    at = list(equations.x)
    swap |= {direction: sp.sign(symbols[states[at[k]]]) for k, direction in equations.surfaces.items()}

    def put(expression: Any) -> Any:
        return sp.sympify(expression).subs(swap)

    own_first = {name: put(equations.initial.get(old, model.initial.get(old, 0.0))) for old, name in states.items()}
    first = {symbols[name]: value for name, value in own_first.items()}
    return ExplicitModel(
        name=_identifier(model.name),
        title=model.name,
        states=tuple(states.values()),
        inputs=tuple(inputs.values()),
        parameters=tuple(parameters.values()),
        symbols=symbols,
        rates={new: put(rate) for new, rate in zip(states.values(), equations.rates, strict=True)},
        initial={name: value.subs(first).subs(first) for name, value in own_first.items()},
        outputs={new: put(equations.outputs[old]) for old, new in outputs.items()},
        units=_units(model, states, inputs, parameters, outputs),
        meanings={new: old for family in (states, inputs, parameters, outputs) for old, new in family.items()},
        values={new: model.values[old] for old, new in parameters.items()},
    )


def _units(model: PhysicalModel, *families: Mapping[str, str]) -> dict[str, str]:
    states, inputs, parameters, outputs = families
    known = {new: model.states[old].unit for old, new in states.items() if old in model.states}
    known |= {new: model.inputs[old].unit for old, new in inputs.items()}
    known |= {new: model.all_parameters[old].unit for old, new in parameters.items()}
    return known | {new: model.outputs[old].unit for old, new in outputs.items()}


def _identifiers(names: Iterable[str], taken: set[str]) -> dict[str, str]:
    """Name → an identifier that no other name has."""
    found = {}
    for name in names:
        plain = new = _identifier(name)
        count = 2
        while new in taken:
            new, count = f"{plain}_{count}", count + 1
        taken.add(new)
        found[name] = new
    return found


def _identifier(name: str) -> str:
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return plain if plain and plain[0].isalpha() else f"m_{plain}"
