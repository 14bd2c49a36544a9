"""Models made of parts: `use` names model files, whose names get the part's as a prefix; `connect`
joins balances of theirs, so that the sums at a node make themselves.

Balances that are joined have one variable in common, their velocity, temperature, level or current:
that of the first which stores something, v. Where a member's is v_j = r_j·v with a constant ratio
r_j (a gear, a rack), power is kept, F·v = F_j·v_j, and so its terms count r_j times in the sum and
its storage r_j² times:

    (S + Σ r_j² S_j) dv/dt = Σ F_k + Σ r_j F_jk

Every other member's variable, and its position, become names for r_j·v and r_j·x.

Reference: D. C. Karnopp, D. L. Margolis, R. C. Rosenberg, *System Dynamics*, 2012, ch. 3 (junctions
and transformers).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType

from residuum.identification.physics.files.dimension import dimension_of, dimension_of_unit
from residuum.identification.physics.files.expression import (
    Call,
    Expression,
    Name,
    Node,
    Place,
    folded,
    parse,
    walk,
    with_definitions,
)
from residuum.identification.physics.files.yaml_tree import (
    MOST_CHARACTERS,
    Listing,
    Scalar,
    Table,
)
from residuum.identification.physics.model import ROLE_UNITS, Balance, PhysicalModel, State
from residuum.identification.units import parse_unit
from residuum.nearest_names import known_names

MOST_PARTS = 100
"""Of a model, those of its parts included. Chosen: so many within each other, five calls each, are
half of what Python allows.
"""
_FILE = re.compile(r"[A-Za-z_][\w-]{0,60}\.ya?ml")

Definitions = Mapping[str, Expression]
Read = Callable[[str, str, Path | None], PhysicalModel]


@cache
def library() -> Mapping[str, str]:
    """The parts that come with the product: name → text of the model file."""
    # Read once a process: every model with parts asks for them.
    folder = files("residuum.identification.physics") / "parts"
    return {
        file.name.removesuffix(".yaml").replace("_", "-"): file.read_text(encoding="utf-8")
        for file in sorted(folder.iterdir(), key=lambda file: file.name)
        if file.name.endswith(".yaml")
    }


@dataclass(frozen=True)
class Assembly:
    """The parts of a model as one: `model` with every name prefixed, what is connected joined.

    `definitions` are the names that stand for something else: the outputs of the parts, and
    variables that were joined to another's.
    """

    model: PhysicalModel
    definitions: Definitions


def parts_of(use: Table, folder: Path | None, read: Read) -> dict[str, PhysicalModel]:
    """The parts that `use` names, each with its prefix before its names.

    Raises
    ------
    BadModel
        With line and column: no such part or file, anything wrong in a part.
    """
    return {
        name: prefixed(_part(use.scalar(name, "use"), folder, read), f"{name}_")
        for name in use.entries
    }


def assembled(
    parts: Mapping[str, PhysicalModel], use: Table, connect: Table, own: PhysicalModel
) -> Assembly:
    """The parts and the model's `own` sections as one, joined as `connect` says.

    Raises
    ------
    BadModel
        With line and column: a name that is declared twice, no such balance, balances of different
        kinds without a ratio, a ratio that is no constant.
    """
    model = own
    definitions = dict[str, Expression]()
    for name, part in parts.items():
        definitions |= {output.name: output.value for output in part.outputs.values()}
        model = _beside(model, part, use.keys[name])
    for node, place in connect.keys.items():
        members = list(_members(connect, node, model))
        model, joined = _joined(model, node, members, place)
        definitions |= joined
    return Assembly(model, definitions)


def _part(named: Scalar, folder: Path | None, read: Read) -> PhysicalModel:
    name = named.text
    # A name without an ending is one of the library.
    if not _FILE.fullmatch(name):
        parts = library()
        if name not in parts:
            raise named.place.refuse(
                f"use: no part {name!r}; {known_names(name, parts, 'there are')}, and files"
                " beside the model, as gear.yaml"
            )
        return read(parts[name], f"part {name}", None)
    if folder is None:
        raise named.place.refuse(
            f"use: {name!r}: a model that is given as a text has no files beside it; give the"
            " parts' text in one file, or use those of the library"
        )
    try:
        with (folder / name).open(encoding="utf-8") as file:
            text = file.read(MOST_CHARACTERS + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise named.place.refuse(
            f"use: {name!r} cannot be read beside the model file ({error.__class__.__name__})"
        ) from None
    return read(text, name, folder)


def prefixed(model: PhysicalModel, prefix: str) -> PhysicalModel:
    """The model with the prefix before each of its names, but for the clock's."""
    names = {name: prefix + name for name in _names_of_its_own(model)}
    definitions = {name: parse(new) for name, new in names.items()}

    def renamed(name: str | None) -> str | None:
        return None if name is None else names.get(name, name)

    return replace(
        model,
        inputs={
            names.get(name, name): replace(
                signal, name=names.get(name, name), default=renamed(signal.default)
            )
            for name, signal in model.inputs.items()
        },
        states={
            names[name]: replace(_state_called(names[name], state), rate=renamed(state.rate))
            for name, state in model.states.items()
        },
        parameters={
            names[name]: replace(parameter, name=names[name])
            for name, parameter in model.parameters.items()
        },
        balances={
            prefix + name: replace(rewritten(balance, definitions), name=prefix + name)
            for name, balance in model.balances.items()
        },
        outputs={
            prefix + name: replace(
                output, name=prefix + name, value=with_definitions(output.value, definitions)
            )
            for name, output in model.outputs.items()
        },
        initial={names[name]: value for name, value in model.initial.items()},
    )


def _names_of_its_own(model: PhysicalModel) -> set[str]:
    """Names of a model's quantities. The clock is one for all parts, whatever their prefix."""
    inputs = {name for name, signal in model.inputs.items() if not signal.is_clock}
    defined = {balance.defines for balance in model.balances.values() if balance.defines}
    return inputs | defined | model.states.keys() | model.parameters.keys()


def _state_called(name: str, state: State) -> State:
    of_record = state.of_record
    if of_record is not None:
        of_record = replace(of_record, name=name)
    return replace(state, name=name, of_record=of_record)


def rewritten(balance: Balance, definitions: Definitions) -> Balance:
    """The balance with what is defined put in for its name; a role is left out where its variable
    is then more than a name.
    """
    stand_for = {
        role: definitions[name].tree if name in definitions else Name(name, Place())
        for role, name in balance.variables.items()
    }
    return replace(
        balance,
        storage=with_definitions(balance.storage, definitions),
        terms=MappingProxyType(
            {name: with_definitions(term, definitions) for name, term in balance.terms.items()}
        ),
        variables=MappingProxyType(
            # r·v is no variable that an effect could act through.
            {role: tree.name for role, tree in stand_for.items() if isinstance(tree, Name)}
        ),
    )


def _beside(model: PhysicalModel, part: PhysicalModel, place: Place) -> PhysicalModel:
    """Both in one; what the model declares itself stands for the part's declaration."""
    declared = {**model.states, **model.parameters, **model.balances}
    own_of_record = {name for name, state in model.states.items() if state.of_record}
    # Parameters and inputs may be declared anew, which changes them; states and balances are the
    # part's own.
    for name in (*part.states, *part.balances):
        if name in declared:
            raise place.refuse(f"use: {name!r} of the part is declared in the model already")
    return replace(
        model,
        # The model's own first, in order and in what they say.
        inputs={**model.inputs, **part.inputs, **model.inputs},
        states={**model.states, **part.states},
        parameters={
            name: parameter
            for name, parameter in {**part.parameters, **model.parameters}.items()
            if name not in own_of_record
        },
        balances={**model.balances, **part.balances},
        initial={**part.initial, **model.initial},
    )


@dataclass(frozen=True)
class _Member:
    """A balance that is joined, and the ratio of its variable to the node's."""

    balance: Balance
    ratio: Expression


def _members(connect: Table, node: str, model: PhysicalModel) -> Iterator[_Member]:
    entry = connect.entries[node]
    if isinstance(entry, Listing):
        texts = [(_scalar(item, node), Scalar("1", entry.place)) for item in entry.items]
    elif isinstance(entry, Table):
        texts = [
            (Scalar(name, place), entry.scalar(name, f"connect, {node!r}"))
            for name, place in entry.keys.items()
        ]
    else:
        texts = []
    if len(texts) < 2:
        raise connect.keys[node].refuse(
            f"connect: {node!r} must be a list of two balances or more, [motor.shaft, load.shaft],"
            " or {motor.shaft: 1, load.shaft: 1/n} with the ratio of each one's variable"
        )
    for named, ratio in texts:
        # motor.shaft is the balance shaft of the part motor: motor_shaft.
        name = named.text.replace(".", "_")
        if name not in model.balances:
            known = known_names(name, sorted(model.balances), "there are")
            raise named.place.refuse(f"connect: {named.text!r} is no balance of a part; {known}")
        yield _Member(model.balances[name], _ratio(ratio, model))


def _scalar(item: object, node: str) -> Scalar:
    if isinstance(item, Scalar):
        return item
    place = item.place if isinstance(item, Listing | Table) else Place()
    raise place.refuse(f"connect, {node!r}: names a balance of a part, as motor.shaft")


def _ratio(text: Scalar, model: PhysicalModel) -> Expression:
    ratio = parse(text.text, text.place)
    for name in sorted(ratio.names - model.parameters.keys()):
        raise text.place.refuse(
            f"connect: a ratio is made of parameters and constants; {name!r} is none of the model"
        )
    return ratio


def _joined(
    model: PhysicalModel, node: str, members: Sequence[_Member], place: Place
) -> tuple[PhysicalModel, dict[str, Expression]]:
    """The model with these balances as one of the node's name, and what their variables now stand
    for.
    """
    _check_name_is_free(node, members, model, place)
    first = _first_storing(members)
    v = _variable(first.balance, model, place)
    positions = [_position(member.balance, model, place) for member in members]
    position = _common_position(node, first, members, positions)
    states = dict(model.states)
    if position is not None and position not in positions:
        unit = ROLE_UNITS["position"].get(first.balance.kind, "")
        states[position] = State(position, unit, rate=v)
    definitions = dict[str, Expression]()
    terms = dict[str, Expression]()
    storages = list[str]()
    for member, own_position in zip(members, positions, strict=True):
        r = _relative(member, first, place)
        variable = _variable(member.balance, model, place)
        if member is not first:
            definitions[variable] = _times(r, v, place)
            # A name of a part must not change its unit by being joined.
            check_unit(variable, model.unit_of(variable), definitions[variable], model)
            states.pop(variable, None)
        if own_position is not None and position not in (None, own_position):
            definitions[own_position] = _times(r, position, place)
            states.pop(own_position, None)
        # Power is kept: v_j = r·v, so terms count r times and storages r² times.
        storages += _scaled_storage(member, variable, v, r)
        terms |= _scaled_terms(member.balance, r)
    joined = Balance(
        node,
        first.balance.kind,
        parse(" + ".join(storages) or "0", first.balance.storage.place),
        MappingProxyType(terms),
        _roles(members, first, v, position),
        first.balance.unit,
        next((m.balance.start for m in members if m.balance.start is not None), None),
    )
    return _with_joined(model, joined, members, states, definitions), definitions


def _check_name_is_free(
    node: str, members: Iterable[_Member], model: PhysicalModel, place: Place
) -> None:
    if node in model.balances and all(member.balance.name != node for member in members):
        raise place.refuse(f"connect: {node!r} is the name of a balance that is not joined here")


def _first_storing(members: Sequence[_Member]) -> _Member:
    """The first member that stores something: it has a state, which the other members' variables
    are ratios of. The first of all where none has one.
    """
    return next((member for member in members if member.balance.defines is None), members[0])


def _common_position(
    node: str, first: _Member, members: Sequence[_Member], positions: Sequence[str | None]
) -> str | None:
    """The position of the first member; a new one's name where others alone have one."""
    for member, position in zip(members, positions, strict=True):
        if member is first and position is not None:
            return position
    return f"{node}_position" if any(positions) else None


def _with_joined(
    model: PhysicalModel,
    joined: Balance,
    members: Iterable[_Member],
    states: Mapping[str, State],
    definitions: Definitions,
) -> PhysicalModel:
    """The model with one balance in place of the members, and these states alone."""
    replaced = {member.balance.name for member in members}
    balances = {name: b for name, b in model.balances.items() if name not in replaced}
    balances[joined.name] = joined
    return replace(
        model,
        states=states,
        balances={name: rewritten(b, definitions) for name, b in balances.items()},
        initial={name: value for name, value in model.initial.items() if name in states},
    )


def _variable(balance: Balance, model: PhysicalModel, place: Place) -> str:
    """What a balance has in common with those it is joined to: the state whose derivative it
    stores, or the variable that it defines.
    """
    if balance.defines is not None:
        return balance.defines
    for node in walk(balance.storage.tree):
        if isinstance(node, Call) and node.function == "der":
            (operand,) = node.operands
            if isinstance(operand, Name) and operand.name in model.states:
                return operand.name
    raise place.refuse(f"connect: balance {balance.name!r} stores no derivative of a state")


def _position(balance: Balance, model: PhysicalModel, place: Place) -> str | None:
    v = _variable(balance, model, place)
    return next((state.name for state in model.states.values() if state.rate == v), None)


def _relative(member: _Member, first: _Member, place: Place) -> str:
    """The ratio to the first one's variable, as text; "1" where they are the same."""
    r = member.ratio.text
    of_first = first.ratio.text
    # Equal ratios, a 1 of both included: no scaling.
    if r == of_first:
        if member.balance.kind != first.balance.kind:
            raise place.refuse(
                f"connect: {member.balance.name!r} is a {member.balance.kind} balance and"
                f" {first.balance.name!r} a {first.balance.kind} balance; say the ratio of their"
                " variables, {motor.shaft: 1, door.carriage: r}"
            )
        return "1"
    return r if of_first == "1" else f"({r}) / ({of_first})"


def check_unit(name: str, unit: str, stands_for: Expression, model: PhysicalModel) -> None:
    """BadModel where a name of a part, which is in this unit, stands for something in another; °C
    and K are two, by their zero.
    """
    place = stands_for.place
    text = stands_for.text
    dimensions = {used: dimension_of_unit(model.unit_of(used)) for used in stands_for.names}
    given = dimension_of(stands_for.tree, dimensions)
    declared = dimension_of_unit(unit)
    if not given.agrees(declared):
        raise place.refuse(
            f"unit clash: {name!r} of a part is in {unit!r}; {text!r}, which it stands for, is in"
            f" {given}"
        )
    # °C and K have one dimension: their zeros tell them apart.
    zero = parse_unit(unit).offset
    for used, dimension in dimensions.items():
        if dimension.agrees(declared) and parse_unit(model.unit_of(used)).offset != zero:
            raise place.refuse(
                f"unit clash: {name!r} of a part is in {unit!r}, {used!r} in"
                f" {model.unit_of(used)!r}; declare both in one of them, records are converted"
            )


def _times(r: str, name: str, place: Place) -> Expression:
    return parse(name if r == "1" else f"({r}) * {name}", place)


def _scaled_storage(member: _Member, variable: str, v: str, r: str) -> list[str]:
    storage = member.balance.storage
    if member.balance.defines is not None:
        return []
    text = with_definitions(storage, {variable: parse(v, storage.place)}).text
    if r == "1":
        return [text]
    # The ratio would stand inside of such a storage, too.
    outside = folded(storage.tree, lambda node, inner: _depends_on(variable, node, inner))
    if outside:
        raise storage.place.refuse(
            f"connect: the storage of {member.balance.name!r} depends on {variable!r} itself; it"
            " can only be joined with ratio 1"
        )
    return [f"({r})**2 * ({text})"]


def _depends_on(variable: str, node: Node, inner: list[bool]) -> bool:
    """Whether a variable stands in a node otherwise than by its derivative."""
    if isinstance(node, Name):
        return node.name == variable
    return any(inner) and not (isinstance(node, Call) and node.function == "der")


def _scaled_terms(balance: Balance, r: str) -> dict[str, Expression]:
    """The terms by the names of balance and term, so that those of two parts are told apart."""
    return {
        f"{balance.name}_{name}": (
            term if r == "1" else parse(f"({r}) * ({term.text})", term.place)
        )
        for name, term in balance.terms.items()
    }


def _roles(
    members: Iterable[_Member], first: _Member, v: str, position: str | None
) -> Mapping[str, str]:
    """The variables that the joined balance names: its own, and others that a member of the same
    kind names (an ambient temperature).
    """
    named = {
        role: name
        for member in members
        if member.balance.kind == first.balance.kind
        for role, name in member.balance.variables.items()
        # What members have in common is the node's; what else they name (an ambient temperature) is
        # kept.
        if role not in ("position", "velocity", "current", "temperature", "level")
    }
    own = {
        role: v if role != "position" else position
        for role in first.balance.variables
        if role not in named
    }
    return MappingProxyType({role: name for role, name in (own | named).items() if name})


def with_places_of_parts(model: PhysicalModel, tree: Table) -> Table:
    """The tree with a place for each name that came from a part: where the part, or the node that
    it was joined at, stands in the file.
    """
    use = tree.table("use", "model file")
    connect = tree.table("connect", "model file")
    origins = {f"{name}_": place for name, place in use.keys.items()} | dict(connect.keys)
    if not origins:
        return tree
    entries = dict(tree.entries)
    # What the model declares itself has its own place.
    own = tree.table("parameters", "model file").keys
    sections = {"inputs": model.inputs, "states": model.states, "balances": model.balances}
    for section, names in sections.items():
        table = tree.table(section, "model file")
        keys = {name: _origin_of(name, origins, use.place) for name in names if name not in own}
        entries[section] = Table(table.entries, keys | dict(table.keys), table.place)
    return Table(entries, tree.keys, tree.place)


def _origin_of(name: str, origins: Mapping[str, Place], otherwise: Place) -> Place:
    """The place of the first origin that a name begins with."""
    return next((at for origin, at in origins.items() if name.startswith(origin)), otherwise)


def resolved(definitions: Definitions) -> dict[str, Expression]:
    """The definitions with those that they name put in; BadModel for one that comes back to
    itself.
    """
    done = dict[str, Expression]()

    def settle(name: str, above: tuple[str, ...]) -> Expression:
        if name in done:
            return done[name]
        # Names on the way to this one: met again, it names itself.
        if name in above:
            raise definitions[name].place.refuse(f"let: {name!r} is defined by itself")
        inner = {
            named: settle(named, (*above, name))
            for named in sorted(definitions[name].names & definitions.keys())
        }
        done[name] = with_definitions(definitions[name], inner)
        return done[name]

    for name in definitions:
        settle(name, ())
    return done
