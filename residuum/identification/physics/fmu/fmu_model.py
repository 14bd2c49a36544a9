"""An FMU as a model of balances: a balance a state, whose term is what the FMU computes, so that
effects can be added to it.

With model exchange and without events every state has its own balance: a state whose derivative is
another state needs none. Any other FMU is simulated by itself (`simulated_model`): then only what
happens on its outputs can be judged.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from residuum.identification.errors import BadUnit
from residuum.identification.physics.compile.expression_meaning import EXTERNAL
from residuum.identification.physics.compile.kernel import EXTERNAL_TEXT
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.physics.files.expression import (
    Call,
    Expression,
    Name,
    Number,
    Place,
    parse,
)
from residuum.identification.physics.fmu.description import Description, Variable, unit_of
from residuum.identification.physics.fmu.loaded_library import LoadedLibrary
from residuum.identification.physics.model import Balance, Input, Output, PhysicalModel, State
from residuum.identification.units import parse_unit

# Points at which a rate is held against a state, and the part by which they may differ.
_POINTS = 8
_ALIKE = 1e-7


def exchange_model(
    library: LoadedLibrary, parameters: Mapping[str, Parameter] = MappingProxyType({})
) -> PhysicalModel:
    """The model of an FMU whose library is loaded for model exchange, with parameters of it.

    Examples
    --------
    `residuum explain drive.fmu record.csv` makes one in a process of its own.
    """
    described = library.description
    states, inputs, outputs = names_of(described)
    units = [unit_of(v) for v in described.states]
    rates = _rates(library)
    arguments = (*states, *inputs, *library.parameters)

    def external(k: int) -> Expression:
        place = Place(described.name)
        names = tuple(Name(name, place) for name in arguments)
        tree = Call(EXTERNAL, (Number(float(k), place), *names), place)
        # the text is a part of the key under which compiled code is kept
        text = EXTERNAL_TEXT.format(library=library.name, k=k, arguments=", ".join(arguments))
        return Expression(text, tree)

    sections: dict[str, dict[str, Any]] = {
        "inputs": {
            name: Input(name, unit_of(v)) for name, v in zip(inputs, described.inputs, strict=True)
        },
        "states": {
            name: State(name, units[k], states[rates[k]] if k in rates else None)
            for k, name in enumerate(states)
        },
        "balances": _balances(states, units, rates, external),
        "outputs": {
            name: Output(name, external(len(states) + k), unit_of(v))
            for k, (name, v) in enumerate(zip(outputs, described.outputs, strict=True))
        },
    }
    held: dict[str, Any] = {key: MappingProxyType(value) for key, value in sections.items()}
    return PhysicalModel(described.name, parameters=MappingProxyType(dict(parameters)), **held)


def _balances(
    states: Sequence[str],
    units: Sequence[str],
    rates: Mapping[int, int],
    external: Callable[[int], Expression],
) -> dict[str, Balance]:
    """A balance for each state, but for those whose derivative is another state: there is nothing
    to balance.
    """
    positions: dict[int, str] = {}
    for position, velocity in rates.items():
        # of several positions with one velocity the first counts
        positions.setdefault(velocity, states[position])
    balances = {}
    for k, (name, unit) in enumerate(zip(states, units, strict=True)):
        if k in rates:
            continue
        kind, roles = _kind(name, unit, positions.get(k))
        balances[name] = Balance(
            name, kind, parse(f"der({name})"), {"fmu": external(k)}, roles, f"{unit or '1'}/s"
        )
    return balances


def _rates(library: LoadedLibrary) -> dict[int, int]:
    """State → the state that is its derivative, as is seen at points drawn around the start."""
    n = len(library.description.states)
    rng = np.random.default_rng(0)
    points = [
        np.concatenate([[0.0], library.start + rng.normal(size=library.start.size)])
        for _ in range(_POINTS)
    ]
    with library.instance.lock:
        values = np.array([library.value(point)[:n] for point in points])
    x = np.array(points)[:, 1 : 1 + n]
    rates: dict[int, int] = {}
    for q in range(n):
        near = [
            v
            for v in range(n)
            if v != q and np.all(np.abs(values[:, q] - x[:, v]) <= _ALIKE * (1 + np.abs(x[:, v])))
        ]
        # Two states that are each other's rate cannot be: the first stays.
        if near and near[0] not in rates:
            rates[q] = near[0]
    return rates


def _kind(name: str, unit: str, position: str | None) -> tuple[str, dict[str, str]]:
    """The kind of a state's balance by its unit, and the roles of variables there."""
    for kind, like, role in _KINDS:
        if _like(unit, like):
            roles = {role: name}
            return kind, ({"position": position} if position and role == "velocity" else {}) | roles
    return "signal", {}


_KINDS = (
    ("torque", "rad/s", "velocity"),
    ("force", "m/s", "velocity"),
    ("voltage", "A", "current"),
    ("heat", "K", "temperature"),
    ("volume", "m", "level"),
)


def _like(unit: str, reference: str) -> bool:
    """Whether a unit is of the dimension of another; 1/s is not rad/s unless it says so."""
    try:
        return bool(unit) and parse_unit(unit).base == parse_unit(reference).base
    except BadUnit:
        return False


def names_of(described: Description) -> tuple[list[str], list[str], list[str]]:
    """Names of states, inputs and outputs as expressions take them, none twice; an output may be
    called as a state is.
    """
    inputs = _given(described.inputs, set())
    states = _given(described.states, set(inputs))
    return states, inputs, _given(tuple(map(_without_prefix, described.outputs)), set(inputs))


def _given(variables: tuple[Variable, ...], taken: set[str]) -> list[str]:
    """Identifiers of variables, all of them others than those that are taken."""
    identifiers: list[str] = []
    for variable in variables:
        plain = re.sub(r"[^A-Za-z0-9_]+", "_", variable.name).strip("_")
        name = plain if plain and not plain[0].isdigit() else f"v_{plain}"
        while name in taken or name in identifiers:
            name += "_"
        identifiers.append(name)
    return identifiers


def _without_prefix(variable: Variable) -> Variable:
    """`y.speed` as `speed`: our own exports write an output so where a state has its name."""
    return Variable(variable.name.removeprefix("y."), variable.reference, variable.unit)
