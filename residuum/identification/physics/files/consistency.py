"""What must hold of a model read from a file before it is composed: names, states, units, no
division by zero.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from residuum.identification.errors import NoExplicitEquations, said
from residuum.identification.physics.files.dimension import (
    Dimension,
    dimension_of,
    dimension_of_unit,
)
from residuum.identification.physics.files.expression import (
    Call,
    Expression,
    Name,
    Node,
    Operation,
    Place,
    evaluate,
    walk,
)
from residuum.identification.physics.files.yaml_tree import Table
from residuum.identification.physics.model import (
    BALANCE_KINDS,
    ROLE_UNITS,
    Balance,
    Output,
    PhysicalModel,
    State,
)
from residuum.nearest_names import known_names

_OTHER_UNITS: Mapping[str, tuple[str, ...]] = {
    "torque": ("mN*m", "N*cm", "N*mm", "kN*m"),
    "force": ("mN", "kN"),
    "voltage": ("mV", "kV"),
    "heat": ("mW", "kW", "MW", "J/min", "kJ/min", "J/hour", "kJ/hour"),
    "volume": (
        "cm**3/s",
        "mm**3/s",
        "l/s",
        "l/min",
        "cm**3/min",
        "m**3/min",
        "m**3/hour",
        "l/hour",
    ),
}
"""Units a balance may be kept in besides its kind's SI unit, when all its terms agree on it."""


def check(model: PhysicalModel, tree: Table) -> PhysicalModel:
    """The model with the unit of each balance filled in; BadModel with line and column for the
    first thing wrong.
    """
    _unique_names(tree)
    _known_names(model)
    _inputs(model, tree)
    _delays(model)
    _states_have_rates(model, tree)
    _variables(model, tree)
    for expression in model.expressions:
        _no_division_by_zero(expression, model.values)
    for balance in model.balances.values():
        _storage_is_not_zero(balance, model.values)
    _defined_variables_can_be_solved(model)
    return _with_units(_with_roles(model))


def _unique_names(tree: Table) -> None:
    declared: dict[str, str] = {}
    for section in ("inputs", "states", "parameters", "constants", "let"):
        for name, place in tree.table(section, "model file").keys.items():
            if name in declared:
                raise place.refuse(f"{name!r} is declared in {declared[name]} already")
            declared[name] = section


def _known_names(model: PhysicalModel) -> None:
    defined = [variable for b in model.balances.values() if (variable := b.defines)]
    known = {*model.inputs, *model.states, *model.parameters, *defined}
    for expression in model.expressions:
        for node in walk(expression.tree):
            if isinstance(node, Name) and node.name not in known:
                raise node.place.refuse(
                    f"name {node.name!r} is not declared;"
                    f" {known_names(node.name, sorted(known), 'there are')}"
                )


def _inputs(model: PhysicalModel, tree: Table) -> None:
    for name, signal in model.inputs.items():
        if signal.is_clock:
            if not dimension_of_unit(signal.unit).agrees(dimension_of_unit("s")):
                place = tree.table("inputs", "model file").keys[name]
                raise place.refuse(f"input {name!r}: a clock is in s, not {signal.unit!r}")
        elif (
            signal.default is not None
            and signal.default not in model.parameters
            and not _is_number(signal.default)
        ):
            place = tree.table("inputs", "model file").keys[name]
            raise place.refuse(
                f"input {name!r}: default {signal.default!r} is neither a number, a parameter nor"
                " 'clock'"
            )


def _delays(model: PhysicalModel) -> None:
    """Each delay() is of inputs, by a parameter that is no negative time; an input has one delay
    wherever it stands.
    """
    # what a balance names by its role is not delayed there
    used: dict[str, set[str]] = {
        name: {""} for b in model.balances.values() for name in b.variables.values()
    }
    for expression in model.expressions:
        for by, node in _delayed_names(expression.tree, ""):
            if by:
                _check_can_be_delayed(node, model)
            delays = used.setdefault(node.name, set())
            delays.add(by)
            if node.name in model.inputs:
                _check_single_delay(node, delays)
        for call in walk(expression.tree):
            if isinstance(call, Call) and call.function == "delay":
                _check_delay(call, model)


def _check_can_be_delayed(node: Name, model: PhysicalModel) -> None:
    # a kernel looks delayed values up in the record: states have no past there
    if node.name not in model.inputs and node.name not in model.parameters:
        raise node.place.refuse(
            f"delay() of {node.name!r}: what is delayed is made of inputs; that a reading is late"
            " is the effect output-lag, that a quantity is transported a state more"
        )


def _check_single_delay(node: Name, delays: Collection[str]) -> None:
    # a kernel looks an input up at one time of a step only
    if len(delays) > 1:
        raise node.place.refuse(
            f"input {node.name!r} stands in the model with more than one delay; declare a second"
            " input and map it to the same column:"
            f" {said('map', {f'{node.name}_late': node.name})}"
        )


def _delayed_names(tree: Node, by: str) -> Iterator[tuple[str, Name]]:
    """Names in a tree with what each is delayed by; "" where it is not."""
    if isinstance(tree, Name):
        yield by, tree
    elif isinstance(tree, Call) and tree.function == "delay":
        yield from _delayed_names(
            tree.operands[0], tree.operands[1].name if isinstance(tree.operands[1], Name) else "?"
        )
    elif isinstance(tree, Operation | Call):
        for operand in tree.operands:
            yield from _delayed_names(operand, by)


def _check_delay(call: Call, model: PhysicalModel) -> None:
    signal, by = call.operands
    if any(isinstance(node, Call) and node.function == "delay" for node in walk(signal)):
        raise call.place.refuse("delay() of a delay(): one is enough, by the sum of both")
    if not isinstance(by, Name) or by.name not in model.parameters:
        raise call.place.refuse(
            "delay() is by a parameter or a constant; declare one, constants: {T: 0.5 s}"
        )
    parameter = model.parameters[by.name]
    if min(parameter.value, parameter.value if parameter.fixed else parameter.lower) < 0.0:
        raise call.place.refuse(
            f"parameter {by.name!r} is a delay; it must not be negative, and has to say so:"
            " lower: 0"
        )


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _states_have_rates(model: PhysicalModel, tree: Table) -> None:
    declared = [tree.table(section, "model file").keys for section in ("parameters", "states")]
    # A value for each record was declared among the parameters.
    places = dict(declared[0]) | dict(declared[1])  # of a value for each record: its parameter's
    owners: dict[str, str] = {}
    for balance in model.balances.values():
        for node in _derivatives(balance.storage):
            _check_der(node, balance, model, owners)
        if not owners_of(balance) and balance.storage.text not in ("0", "0.0"):
            raise balance.storage.place.refuse(
                f"balance {balance.name!r}: storage has no der() of a state and is not 0"
            )
    _no_derivative_outside_of_storages(model)
    for name, state in model.states.items():
        _check_rate(state, model, owners, places[name])


def _no_derivative_outside_of_storages(model: PhysicalModel) -> None:
    elsewhere = [term for balance in model.balances.values() for term in balance.terms.values()]
    elsewhere += [output.value for output in model.outputs.values()]
    for expression in elsewhere:
        for node in _derivatives(expression):
            raise node.place.refuse("der() may only stand in a storage")


def _check_rate(
    state: State, model: PhysicalModel, owners: Mapping[str, str], place: Place
) -> None:
    name = state.name
    rate = state.rate
    if rate is None:
        if name not in owners and state.of_record is None:
            raise place.refuse(
                f"state without a balance: no storage has der({name}) and it has no 'rate'"
            )
        return
    if rate not in model.states:
        raise place.refuse(f"state {name!r}: rate {rate!r} is not a state")
    if name in owners:
        raise place.refuse(
            f"state {name!r} has a 'rate' and der({name}) in balance {owners[name]!r}; only one"
            " may be"
        )
    change = dimension_of_unit(state.unit) / dimension_of_unit("s")
    if not change.agrees(dimension_of_unit(model.states[rate].unit)):
        raise place.refuse(
            f"unit clash: the rate of {name!r} is in {change}, {rate!r} is in"
            f" {model.states[rate].unit}"
        )


def _derivatives(expression: Expression) -> list[Call]:
    return [
        node for node in walk(expression.tree) if isinstance(node, Call) and node.function == "der"
    ]


def owners_of(balance: Balance) -> list[str]:
    """The states whose derivative stands in the storage of a balance."""
    derivatives = _derivatives(balance.storage)
    return [node.operands[0].name for node in derivatives if isinstance(node.operands[0], Name)]


def _check_der(node: Call, balance: Balance, model: PhysicalModel, owners: dict[str, str]) -> None:
    operand = node.operands[0]
    if not isinstance(operand, Name) or operand.name not in model.states:
        raise node.place.refuse(
            f"der() takes the name of a state; there are {', '.join(model.states) or 'none'}"
        )
    if owners.setdefault(operand.name, balance.name) != balance.name:
        raise node.place.refuse(
            f"der({operand.name}) stands in balances {owners[operand.name]!r} and {balance.name!r}"
        )
    if len(set(owners_of(balance))) > 1:
        raise node.place.refuse(
            f"balance {balance.name!r}: storage has the derivative of more than one state"
        )


def _variables(model: PhysicalModel, tree: Table) -> None:
    section = tree.table("balances", "model file")
    defined: set[str] = set()
    for name, balance in model.balances.items():
        table = section.table(name, "balances")
        declared = {*model.states, *model.inputs, *model.parameters}
        if balance.storage.text in ("0", "0.0"):
            defined.add(_defined_variable(balance, declared | defined, section.keys[name]))
            continue
        for role, variable in balance.variables.items():
            if variable not in declared:
                raise table.scalar(role, name).place.refuse(
                    f"balance {name!r}: {role} {variable!r} is not declared"
                )


def _defined_variable(balance: Balance, taken: Container[str], place: Place) -> str:
    """The variable that a balance without storage defines, which no other one may."""
    name = balance.name
    if balance.defines is None:
        raise place.refuse(
            f"balance {name!r}: storage is 0, so it must name the variable that it defines"
        )
    if balance.defines in taken:
        raise place.refuse(f"balance {name!r}: {balance.defines!r} is defined elsewhere already")
    if not any(balance.defines in term.names for term in balance.terms.values()):
        raise place.refuse(
            f"balance {name!r}: no term contains {balance.defines!r}, which it must define"
        )
    return balance.defines


def _with_roles(model: PhysicalModel) -> PhysicalModel:
    """The model with the variables that its balances do not name: a heat balance that stores C
    der(T) is that of temperature T.

    Without them effects that act through a variable, a second store of heat or a friction, would
    not be known to fit there.
    """
    balances = {}
    for name, balance in model.balances.items():
        (own,) = owners_of(balance)[:1] or ("",)
        places = [state.name for state in model.states.values() if own and state.rate == own]
        # What a balance stores the derivative of is its variable; a state whose rate that is, its
        # position.
        roles = dict.fromkeys(("velocity", "current", "temperature", "level"), own) | {
            "position": (*places, "")[0]
        }
        inferred = {
            role: roles[role]
            for role in BALANCE_KINDS[balance.kind][1]
            if role not in balance.variables
            and roles.get(role)
            # In the unit of that role alone: a storage of der(x) may be anything.
            and _is_in(model.states[roles[role]].unit, role, balance.kind)
        }
        balances[name] = replace(
            balance, variables=MappingProxyType({**balance.variables, **inferred})
        )
    return replace(model, balances=MappingProxyType(balances))


def _is_in(unit: str, role: str, kind: str) -> bool:
    return dimension_of_unit(unit).exponents == dimension_of_unit(ROLE_UNITS[role][kind]).exponents


def _no_division_by_zero(expression: Expression, values: Mapping[str, float]) -> None:
    for node in walk(expression.tree):
        if (
            isinstance(node, Operation)
            and node.operator == "/"
            and evaluate(node.operands[1], values) == 0
        ):
            raise node.place.refuse(
                f"division by zero: the divisor in {expression.text!r} is 0 at the given parameter"
                " values"
            )


def _storage_is_not_zero(balance: Balance, values: Mapping[str, float]) -> None:
    if balance.defines is None and evaluate(balance.storage.tree, values) == 0:
        raise balance.storage.place.refuse(
            f"division by zero: storage {balance.storage.text!r} is 0 at the given parameter values"
        )


def _defined_variables_can_be_solved(model: PhysicalModel) -> None:
    """Each balance without storage is linear in its variable with a slope that is not zero, and
    none define each other, but those that name a start value.
    """
    defined = {
        variable: balance for balance in model.balances.values() if (variable := balance.defines)
    }
    needs = {}
    for variable, balance in defined.items():
        in_terms = {name for term in balance.terms.values() for name in term.names}
        needs[variable] = in_terms & (set(defined) - {variable})
    zero = dict.fromkeys([*model.states, *model.inputs, *defined], 0.0) | dict(model.values)
    for variable, balance in defined.items():
        if balance.start is not None:  # Newton's method solves it, whatever its form
            continue
        _check_linear(balance, variable, zero)
        if _reaches(needs, variable, variable):
            raise balance.storage.place.refuse(
                f"algebraic loop: balance {balance.name!r} and another define each other's"
                " variables; give each a value to solve from, start: 1.0",
                NoExplicitEquations,
            )


def _check_linear(balance: Balance, variable: str, zero: Mapping[str, float]) -> None:
    """NoExplicitEquations where a balance is not linear in the variable that it defines, or its
    slope by it is zero; `zero` has the parameters' values, and 0 for everything else.
    """
    for term in balance.terms.values():
        if _degree(term.tree, variable) > 1:
            raise term.place.refuse(
                f"algebraic loop: balance {balance.name!r} has no storage and is not linear in"
                f" {variable!r}, which it defines; give it a value to solve from, start: 1.0",
                NoExplicitEquations,
            )
    # of linear terms the difference between the variable at 1 and at 0 is the slope
    slope = [
        evaluate(term.tree, {**zero, variable: 1.0}) - evaluate(term.tree, zero)
        for term in balance.terms.values()
    ]
    if sum(slope) == 0:
        raise balance.storage.place.refuse(
            f"division by zero: the terms with {variable!r}, which balance {balance.name!r}"
            " defines, add up to 0",
            NoExplicitEquations,
        )


def _reaches(needs: Mapping[str, set[str]], start: str, goal: str) -> bool:
    # Along the names, in any number of steps.
    visited = set()
    open_ = set(needs[start])
    while open_:
        name = open_.pop()
        if name == goal:
            return True
        visited.add(name)
        open_ |= needs[name] - visited
    return False


def _degree(tree: Node, name: str) -> int:
    """0: `name` does not occur; 1: linearly, or as sign() or abs() of it alone; 2: otherwise."""
    if isinstance(tree, Name):
        return int(tree.name == name)
    if not isinstance(tree, Operation | Call):
        return 0
    degrees = [_degree(operand, name) for operand in tree.operands]
    if max(degrees) == 0:
        return 0
    if isinstance(tree, Call):
        # on either side of standstill sign(v) is a constant, and abs(v) linear
        return 1 if tree.function in ("sign", "abs") and isinstance(tree.operands[0], Name) else 2
    return _degree_of_operation(tree.operator, degrees)


def _degree_of_operation(operator: str, degrees: Sequence[int]) -> int:
    """The degree of a sum, product, quotient or power of operands of these degrees."""
    if operator in ("+", "-", "neg"):
        return max(degrees)
    if operator == "*" and min(degrees) == 0:
        return max(degrees)
    if operator == "/" and degrees[1] == 0:
        return degrees[0]
    return 2


def _with_units(model: PhysicalModel) -> PhysicalModel:
    declared = [*model.inputs, *model.states, *model.parameters]
    names = {name: dimension_of_unit(model.unit_of(name)) for name in declared}
    names |= {
        v: dimension_of_unit(model.unit_of(v))
        for b in model.balances.values()
        if (v := b.defines) and v not in names
    }
    units = list(
        dict.fromkeys(
            u for name in declared if (u := model.unit_of(name)) not in ("", "1", "%", "percent")
        )
    )
    # Coefficients without a unit: normalised models hide units in them.
    plain = {name for name, parameter in model.parameters.items() if parameter.unit in ("", "1")}
    balances = {
        name: _with_unit(balance, names, units, plain) for name, balance in model.balances.items()
    }
    for output in model.outputs.values():
        _check_output(output, names)
    return replace(model, balances=MappingProxyType(balances))


def _with_unit(
    balance: Balance, names: Mapping[str, Dimension], units: Iterable[str], plain: set[str]
) -> Balance:
    """The balance with the unit of its terms: its kind's own, a usual multiple, or any other (a
    level in volts, a textbook's normalised motor).

    Terms have to agree with the storage. A term with a parameter that is a `plain` number is taken
    to be in the balance's unit: so normalised models are written, whose coefficients hide the
    units.
    """
    scale = _common_dimension(balance, names, plain)
    if scale is None or balance.kind == "signal":
        return balance
    # the shortest spelling first: the kind's own units, then those that the model is written in
    usual = (balance.unit, *_OTHER_UNITS[balance.kind])
    rates = [f"{unit}/{time}" for unit in units for time in ("s", "min", "hour")]
    for unit in (*usual, *units, *rates):
        if scale.agrees(dimension_of_unit(unit)):
            return replace(balance, unit=unit)
    return replace(balance, unit=str(scale))


def _common_dimension(
    balance: Balance, names: Mapping[str, Dimension], plain: set[str]
) -> Dimension | None:
    """What storage and terms of a balance are in; None where all of them are numbers."""
    scale: Dimension | None = None
    sides = {"storage": balance.storage}
    sides |= {f"term {name!r}": term for name, term in balance.terms.items()}
    for side, expression in sides.items():
        dimension = dimension_of(expression.tree, names)
        if dimension.literal:
            continue
        if scale is None:
            scale = dimension
        elif not dimension.agrees(scale) and not plain & set(expression.names):
            raise expression.place.refuse(
                f"unit clash: {side} of {balance.kind} balance {balance.name!r} is in {dimension};"
                f" the balance is in {scale}"
            )
    return scale


def _check_output(output: Output, names: Mapping[str, Dimension]) -> None:
    dimension = dimension_of(output.value.tree, names)
    declared = dimension_of_unit(output.unit)
    if not dimension.agrees(declared):
        raise output.value.place.refuse(
            f"unit clash: the value of output {output.name!r} is in {dimension}, declared is"
            f" {output.unit!r}, {declared}; declare the unit of the value: a record in another unit"
            " is converted when it is read"
        )
