"""Model files: YAML text → PhysicalModel, with every refusal at its line and column, and back."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import yaml

from residuum.identification.errors import BadInput, BadModel, BadUnit
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.effects.base import Parameter, Prior
from residuum.identification.physics.files.consistency import check
from residuum.identification.physics.files.effect_file import WrittenEffect, effects_of
from residuum.identification.physics.files.expression import (
    Expression,
    Place,
    parse,
    with_definitions,
)
from residuum.identification.physics.files.parts import (
    MOST_PARTS,
    assembled,
    check_unit,
    parts_of,
    resolved,
    rewritten,
    with_places_of_parts,
)
from residuum.identification.physics.files.table_file import with_table_files
from residuum.identification.physics.files.yaml_tree import (
    Listing,
    Scalar,
    Table,
    read_text,
    read_tree,
)
from residuum.identification.physics.model import (
    BALANCE_KINDS,
    CLOCK,
    Balance,
    EffectUse,
    Input,
    Output,
    PhysicalModel,
    State,
)
from residuum.identification.units import parse_unit
from residuum.nearest_names import known_names

T = TypeVar("T")

BUILT_IN = ("gate-drive", "oven", "linear-axis", "oscillator", "two-tanks", "process")
LINEAR = (".json", ".mat")
"""Endings of files that hold a transfer function or a state space."""
KEYS = (
    "name",
    "notes",
    "use",
    "connect",
    "inputs",
    "states",
    "parameters",
    "constants",
    "let",
    "balances",
    "outputs",
    "own_effects",
    "effects",
    "initial",
)
INPUT_KEYS, OUTPUT_KEYS = ("unit", "default"), ("value", "unit")
STATE_KEYS = ("unit", "rate", "start")
PARAMETER_KEYS = ("value", "unit", "lower", "upper", "fixed", "meaning", "prior", "std", "per")
EFFECT_KEYS = ("id", "balance", "input", "output", "parameters", "provenance")
"""What each entry of a section may hold; balances also name the variables of their kind."""
TIME = "time"
"""Name of the time since the record's begin, which need not be declared."""
_TAKES_FMUS = (
    "the commands compare, explain, improve, estimate and train take it, in a process of its own,"
    " and `rs.fmu` in Python"
)
_NAME = re.compile(r"[A-Za-z_][A-Za-z_0-9]*")
_UNCERTAIN = re.compile(r"(\S+?)\s*(?:±|\+-|\+/-)\s*(\S+)")
"""A number and its standard deviation."""
_RESERVED = {
    "der",
    "sin",
    "cos",
    "tanh",
    "exp",
    "log",
    "sqrt",
    "abs",
    "sign",
    "min",
    "max",
    "and",
    "or",
    "not",
}


def load_model(name_or_path: str | Path) -> PhysicalModel:
    """The built-in model of this name, or the model in this file.

    Raises
    ------
    BadModel
        Neither a built-in name nor a readable file, or anything wrong in the file (with line and
        column).

    Examples
    --------
    >>> load_model("linear-axis").free
    ('M',)
    """
    if str(name_or_path) in BUILT_IN:
        resource = (
            files("residuum.identification.physics")
            / "models"
            / f"{str(name_or_path).replace('-', '_')}.yaml"
        )
        return read_model(resource.read_text(encoding="utf-8"), str(name_or_path))
    path = Path(name_or_path)
    if path.suffix.lower() == ".fmu":
        raise BadModel(f"model {str(path)!r}: is an FMU; {_TAKES_FMUS}")
    if not path.is_file():
        raise BadModel(
            f"model {str(name_or_path)!r}: no such file;"
            f" {known_names(path.stem, BUILT_IN, 'the built-in models are')}"
        )
    if path.suffix.lower() in LINEAR:
        # SciPy, for these alone
        from residuum.identification.physics.files.linear_model import (  # noqa: PLC0415
            read_linear_file,
        )

        return read_model(read_linear_file(path), path.name)
    return read_model(read_text(path), path.name, path.parent)


def read_model(text: str, source: str = "model", folder: Path | None = None) -> PhysicalModel:
    """The model that a YAML text describes (docs/reference/model-files.md says the format);
    `source` names it in refusals, the files of its tables stand in `folder`.
    """
    model, tree = _composed(text, source, folder, iter(range(MOST_PARTS)))
    if not model.balances:
        raise tree.keys["balances"].refuse("balances: is empty; a model has at least one")
    model = check(_with_clock(model), with_places_of_parts(model, tree))
    return with_effects(model, tree)


def _composed(
    text: str, source: str, folder: Path | None, more: Iterator[int]
) -> tuple[PhysicalModel, Table]:
    """The model that a text describes, its parts joined, before anything is checked of it as a
    whole; and its tree. `more` counts the parts that there still may be.
    """
    tree = with_table_files(read_tree(text, source), folder)
    if "fmu" in tree.entries:
        raise tree.keys["fmu"].refuse(f"fmu: the model is an FMU; {_TAKES_FMUS}")
    tree.only(KEYS, "model file")
    use = tree.table("use", "model file")
    connect = tree.table("connect", "model file")
    # A model made of parts may have no balance of its own.
    for section in ("outputs",) if list(use) else ("balances", "outputs"):
        if not list(tree.table(section, "model file", required=True)):
            raise tree.keys[section].refuse(f"{section}: is empty; a model has at least one")

    def read(text: str, source: str, folder: Path | None) -> PhysicalModel:
        if next(more, None) is None:
            raise use.place.refuse(
                f"use: more than {MOST_PARTS} parts, those of parts included; does one use itself?"
            )
        return _part_without_effects(text, source, folder, more)

    parts = parts_of(use, folder, read)
    own, let = _own_sections(tree, parts)
    assembly = assembled(parts, use, connect, own)
    # What parts define, then what the model defines in their place.
    definitions = resolved({**assembly.definitions, **let})
    model = assembly.model
    _check_units_of_defined(let, definitions, model)
    balances = {name: rewritten(b, definitions) for name, b in model.balances.items()}
    outputs = {
        name: replace(output, value=with_definitions(output.value, definitions))
        for name, output in own.outputs.items()
    }
    composed = replace(
        model,
        inputs=_without_defined(model.inputs, let),
        parameters=_without_defined(model.parameters, let),
        states=MappingProxyType(model.states),
        initial={**model.initial, **_initial(tree, model)},
        balances=MappingProxyType(balances),
        outputs=MappingProxyType(outputs),
    )
    return composed, tree


def _part_without_effects(
    text: str, source: str, folder: Path | None, more: Iterator[int]
) -> PhysicalModel:
    """A part as `_composed` reads it. One with effects is refused: their parameters have no names
    in the model that uses it.
    """
    part, tree = _composed(text, source, folder, more)
    for key in ("own_effects", "effects"):
        if key in tree.entries:
            raise tree.keys[key].refuse(
                f"{key}: a part has none; put them into the model that uses it"
            )
    return part


def _check_units_of_defined(
    let: Collection[str], definitions: Mapping[str, Expression], model: PhysicalModel
) -> None:
    """What the model defines in place of a part's input or parameter is in the unit of that one."""
    for name in let:
        for declared in (model.inputs, model.parameters):
            if name in declared:
                check_unit(name, declared[name].unit, definitions[name], model)


def _without_defined(declared: Mapping[str, T], defined: Collection[str]) -> Mapping[str, T]:
    """What a part declares, but for what the model that uses it defines."""
    return MappingProxyType(
        {name: entry for name, entry in declared.items() if name not in defined}
    )


def _own_sections(
    tree: Table, parts: Mapping[str, PhysicalModel]
) -> tuple[PhysicalModel, Mapping[str, Expression]]:
    """What the file itself declares, and what it defines under `let`."""
    of_parts: dict[str, Parameter] = {}
    for part in parts.values():
        of_parts |= part.parameters

    def entries(section: str, read: Callable[[str, Table], T]) -> dict[str, T]:
        table = tree.table(section, "model file")
        return {name: read(name, table) for name in _names(tree, section)}

    inputs = entries("inputs", _input)
    states = entries("states", _state)
    parameters = entries(
        "parameters", lambda name, table: read_parameter(name, table, of_parts.get(name))
    )
    parameters |= entries("constants", _constant)
    balances = entries("balances", _balance)
    outputs = entries("outputs", _output)
    # a value for each record is a state that stands still: each experiment begins at its own
    for name in _of_records(tree.table("parameters", "model file")):
        of_record = parameters.pop(name)
        states[name] = State(name, of_record.unit, of_record=of_record)
    let = entries("let", lambda name, table: _expression(table.scalar(name, "let")))
    name = tree.scalar("name", "model file").text
    return PhysicalModel(name, inputs, states, parameters, balances, outputs), let


def _with_clock(model: PhysicalModel) -> PhysicalModel:
    """The model with `time` among its inputs, where an expression names it and nothing declares
    it.
    """
    declared = {
        *model.inputs,
        *model.states,
        *model.parameters,
        *(b.defines for b in model.balances.values()),
    }
    # Declared by the file it is an input like any other.
    if TIME in declared or not any(TIME in expression.names for expression in model.expressions):
        return model
    return replace(model, inputs=MappingProxyType({**model.inputs, TIME: Input(TIME, "s", CLOCK)}))


def write_model(model: PhysicalModel) -> str:
    """The YAML text of a model, effects and their provenance included; `read_model` gives the same
    model back.
    """
    states = {}
    parameters = {}
    for name, parameter in model.parameters.items():
        parameters[name] = written_parameter(parameter)
    for name, state in model.states.items():
        if state.of_record is None:
            states[name] = _written_state(state)
        else:
            parameters[name] = written_parameter(state.of_record) | {"per": "record"}
    document: dict[str, Any] = {
        "name": model.name,
        "inputs": {name: _written_input(signal) for name, signal in model.inputs.items()},
        "states": states,
        "parameters": parameters,
    }
    if definitions := model.definitions:
        document["let"] = {name: definition.text for name, definition in definitions.items()}
    document["balances"] = {
        balance.name: _written_balance(balance) for balance in model.balances.values()
    }
    document["outputs"] = {
        o.name: {"value": o.value.text, "unit": o.unit} for o in model.outputs.values()
    }
    if model.initial:
        document["initial"] = dict(model.initial)
    return dumped(document | written_effects(model))


def written_effects(model: PhysicalModel) -> dict[str, Any]:
    """The sections of a model file that hold a model's effects; `with_effects` reads them."""
    sections: dict[str, Any] = {}
    if own := {
        use.id: use.effect.definition
        for use in model.effects
        if isinstance(use.effect, WrittenEffect)
    }:
        sections["own_effects"] = list(own.values())
    if model.effects:
        sections["effects"] = [_written_use(use) for use in model.effects]
    return sections


def dumped(document: dict[str, Any]) -> str:
    """The text of a model file, in the order that its keys have."""
    return str(
        yaml.dump(
            document,
            Dumper=_Dumper,
            sort_keys=False,
            allow_unicode=True,
            default_flow_style=None,
            width=120,
        )
    )


def _written_input(signal: Input) -> str | dict[str, str]:
    if signal.default is None:
        return signal.unit
    return {"unit": signal.unit, "default": signal.default}


def _written_state(state: State) -> dict[str, Any]:
    written: dict[str, Any] = {"unit": state.unit}
    if state.rate:
        written["rate"] = state.rate
    if state.start is not None:
        written["start"] = state.start
    return written


def _written_balance(balance: Balance) -> dict[str, Any]:
    terms = {name: term.text for name, term in balance.terms.items()}
    start = {} if balance.start is None else {"start": balance.start}
    return {
        "kind": balance.kind,
        "storage": balance.storage.text,
        "terms": terms,
        **start,
        **balance.variables,
    }


def _written_use(use: EffectUse) -> dict[str, Any]:
    parameters = {name: written_parameter(parameter) for name, parameter in use.parameters.items()}
    provenance = {"provenance": dict(use.provenance)} if use.provenance else {}
    return {"id": use.id, use.effect.place: use.target, "parameters": parameters, **provenance}


class _Dumper(yaml.SafeDumper):
    """SafeDumper without anchors (the reader refuses them)."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _names(tree: Table, section: str) -> list[str]:
    table = tree.table(section, "model file")
    for name, place in table.keys.items():
        # Outputs and balances are not named in expressions: they may be called as they like.
        if section not in ("outputs", "balances") and (
            not _NAME.fullmatch(name) or name in _RESERVED
        ):
            raise place.refuse(
                f"{section}: {name!r} is not a name (letters, digits and _; no function's name)"
            )
    return list(table)


def _unit(text: Scalar) -> str:
    try:
        parse_unit(text.text)
    except BadUnit as error:
        raise text.place.refuse(str(error)) from None
    return text.text


def _input(name: str, section: Table) -> Input:
    tree = section.entries[name]
    if isinstance(tree, Scalar):
        return Input(name, _unit(tree))
    table = section.table(name, "inputs")
    table.only(INPUT_KEYS, f"input {name!r}")
    default = table.optional("default", f"input {name!r}")
    return Input(
        name, _unit(table.scalar("unit", f"input {name!r}")), default.text if default else None
    )


def _state(name: str, section: Table) -> State:
    label = f"state {name!r}"
    table = section.table(name, "states")
    table.only(STATE_KEYS, label)
    rate = table.optional("rate", label)
    start = table.optional("start", label)
    return State(
        name,
        _unit(table.scalar("unit", label)),
        rate.text if rate else None,
        start=None if start is None else start.number(f"{label}: start"),
    )


def read_parameter(name: str, section: Table, of_part: Parameter | None = None) -> Parameter:
    """An entry of the section `parameters`; one of a part keeps what is not said of it here."""
    label = f"parameter {name!r}"
    entry = section.entries[name]
    if of_part is not None and isinstance(entry, Scalar):
        # `R: 0.5` beside a part: its value alone.
        section = Table({name: _alone("value", entry)}, section.keys, section.place)
    table = section.table(name, "parameters")
    table.only(PARAMETER_KEYS, label)
    # What the model does not say anew stays as the part has it.
    before = of_part or Parameter(name, 0.0, "")
    unit = table.optional("unit", label)
    fixed = table.optional("fixed", label)
    meaning = table.optional("meaning", label)
    lower = _number(table.optional("lower", label), f"{label}: lower", before.lower)
    upper = _number(table.optional("upper", label), f"{label}: upper", before.upper)
    if of_part is not None and "value" not in table.entries:
        number = of_part.value
        prior = of_part.prior
        place = table.place
    else:
        number, prior = _value_and_prior(table, label)
        place = table.scalar("value", label).place
    _check_bounds(label, number, (lower, upper), table.place, place)
    return Parameter(
        name,
        number,
        _unit(unit) if unit else before.unit,
        lower,
        upper,
        fixed=fixed.truth(f"{label}: fixed") if fixed else before.fixed,
        meaning=meaning.text if meaning else before.meaning,
        prior=prior,
    )


def _check_bounds(
    label: str, number: float, bounds: tuple[float, float], at_entry: Place, at_value: Place
) -> None:
    lower, upper = bounds
    if lower >= upper:
        raise at_entry.refuse(
            f"{label}: lower is {lower:g} and upper is {upper:g}; lower must be below upper"
        )
    if not lower <= number <= upper:
        raise at_value.refuse(
            f"{label}: value is {number:g}; must be within {lower:g} to {upper:g}"
        )


def _of_records(section: Table) -> list[str]:
    """The parameters that have a value for each record (`per: record`)."""
    of_records = []
    for name, entry in section.entries.items():
        # A value for each record is said by `per: record`.
        if not isinstance(entry, Table) or "per" not in entry.entries:
            continue
        label = f"parameter {name!r}"
        per = entry.scalar("per", label)
        if per.text != "record":
            raise per.place.refuse(f"{label}: per is {per.text!r}; must be 'record'")
        for key in ("lower", "upper", "fixed", "prior"):
            if key in entry.entries:
                raise entry.keys[key].refuse(
                    f"{label}: has a value for each record, which neither bounds nor a prior hold;"
                    f" leave out {key!r} or 'per'"
                )
        value = entry.optional("value", label)
        if value is not None and _UNCERTAIN.fullmatch(value.text.strip()):
            raise value.place.refuse(
                f"{label}: has a value for each record, which no prior holds; leave out the ± or"
                " 'per'"
            )
        of_records.append(name)
    return of_records


def _alone(key: str, entry: Scalar) -> Table:
    return Table({key: entry}, {key: entry.place}, entry.place)


def _number(text: Scalar | None, label: str, default: float) -> float:
    return default if text is None else text.number(label)


def _value_and_prior(table: Table, label: str) -> tuple[float, Prior | None]:
    """`value: 0.07 ± 0.01`, or a value that has left its `prior: 0.07 ± 0.01`."""
    number, prior = _uncertain(table.scalar("value", label), f"{label}: value")
    known = table.optional("prior", label)
    if known is None:
        return number, prior
    before = _uncertain(known, f"{label}: prior")[1]
    if before is None:
        raise known.place.refuse(
            f"{label}: prior is {known.text!r}; must be a value and its standard deviation, '0.07 ±"
            " 0.01'"
        )
    if prior is not None:
        raise known.place.refuse(
            f"{label}: its value has a standard deviation and there is a 'prior'; only one may be"
        )
    return number, before


def _uncertain(text: Scalar, label: str) -> tuple[float, Prior | None]:
    """A number, and the normal prior that it is where its standard deviation stands behind it."""
    match = _UNCERTAIN.fullmatch(text.text.strip())
    if match is None:
        return text.number(label), None
    mean = Scalar(match[1], text.place).number(label)
    std = Scalar(match[2], text.place).number(f"{label}: standard deviation")
    if std <= 0.0:
        raise text.place.refuse(
            f"{label} is {text.text!r}; its standard deviation must be positive (fixed: true holds"
            " a value)"
        )
    return mean, Prior(mean, std)


def _constant(name: str, section: Table) -> Parameter:
    """`g: 9.81 m/s**2`: a number with its unit, which nothing estimates."""
    text = section.scalar(name, "constants")
    # One text: a number, a blank, a unit, which may hold blanks itself.
    number, _, unit = text.text.partition(" ")
    value = Scalar(number, text.place).number(f"constant {name!r}")
    return Parameter(
        name,
        value,
        _unit(Scalar(unit.strip(), text.place.right(len(number) + 1))) if unit.strip() else "",
        fixed=True,
    )


def _expression(text: Scalar) -> Expression:
    return parse(text.text, text.place)


def _balance(name: str, section: Table) -> Balance:
    label = f"balance {name!r}"
    table = section.table(name, "balances")
    kind = table.scalar("kind", label)
    if kind.text not in BALANCE_KINDS:
        raise kind.place.refuse(
            f"{label}: kind {kind.text!r} is not known;"
            f" {known_names(kind.text, BALANCE_KINDS, 'there are')}"
        )
    roles = BALANCE_KINDS[kind.text][1]
    table.only(("kind", "storage", "terms", "start", *roles), label)
    start = table.optional("start", label)
    terms = table.table("terms", label, required=True)
    return Balance(
        name,
        kind.text,
        _expression(table.scalar("storage", label)),
        MappingProxyType(
            {term: _expression(terms.scalar(term, f"{label}, terms")) for term in terms}
        ),
        MappingProxyType(
            {role: table.scalar(role, label).text for role in roles if role in table.entries}
        ),
        BALANCE_KINDS[kind.text][0],
        None if start is None else start.number(f"{label}: start"),
    )


def _output(name: str, section: Table) -> Output:
    table = section.table(name, "outputs")
    table.only(OUTPUT_KEYS, f"output {name!r}")
    value = table.scalar("value", f"output {name!r}")
    unit = table.optional("unit", f"output {name!r}")
    return Output(name, _expression(value), _unit(unit) if unit else "")


def _initial(tree: Table, model: PhysicalModel) -> Mapping[str, float]:
    table = tree.table("initial", "model file")
    for name, place in table.keys.items():
        if name not in model.states:
            raise place.refuse(
                f"initial: {name!r} is not a state; {known_names(name, model.states, 'there are')}"
            )
    return {name: table.scalar(name, "initial").number(f"initial: {name}") for name in table}


def with_effects(model: PhysicalModel, tree: Table) -> PhysicalModel:
    """The model with the effects that a file names."""
    if "own_effects" in tree.entries:
        # Before the effects are read, which may name them.
        EFFECTS.use_here(*effects_of(tree.entries["own_effects"], tree))
    listing = tree.entries.get("effects")
    if listing is None:
        return model
    if not isinstance(listing, Listing):
        raise listing.place.refuse("effects must be a list")
    for item in listing.items:
        if not isinstance(item, Table):
            raise item.place.refuse("effects: each entry is a mapping with 'id'")
        model = _with_effect(model, item)
    return model


def _with_effect(model: PhysicalModel, item: Table) -> PhysicalModel:
    label = "effect"
    item.only(EFFECT_KEYS, label)
    targets = [key for key in ("balance", "input", "output") if key in item.entries]
    if len(targets) != 1:
        raise item.place.refuse(
            "effect: exactly one of 'balance', 'input', 'output' says where it is"
        )
    target = item.scalar(targets[0], label)
    table = item.table("parameters", label)
    values: dict[str, float] = {}
    priors: dict[str, Prior | None] = {}
    fixed: list[str] = []
    for name in table:
        entry = table.entries[name]
        named = f"effect parameter {name!r}"
        values[name], priors[name] = (
            _uncertain(entry, named)
            if isinstance(entry, Scalar)
            else _value_and_prior(table.table(name, label), named)
        )
        if isinstance(entry, Table):
            entry.only(PARAMETER_KEYS, named)
            flag = entry.optional("fixed", label)
            fixed += [name] if flag and flag.truth(label) else []
    provenance = {
        key: _plain(tree) for key, tree in item.table("provenance", label).entries.items()
    }
    try:
        id = item.scalar("id", label).text
        return model.with_effect(
            id, target.text, values, fixed=fixed, priors=priors, provenance=provenance
        )
    # The effect knows what is wrong, the file where.
    except BadInput as error:
        raise item.place.refuse(str(error)) from None


def _plain(tree: Scalar | Listing | Table) -> Any:
    if isinstance(tree, Scalar):
        return (
            yaml.safe_load(tree.text)
            if re.fullmatch(r"[-+.\deE]+|true|false|null", tree.text)
            else tree.text
        )
    if isinstance(tree, Listing):
        return [_plain(item) for item in tree.items]
    return {key: _plain(value) for key, value in tree.entries.items()}


def written_parameter(parameter: Parameter) -> dict[str, Any]:
    """A parameter as `read_parameter` reads it."""
    written: dict[str, Any] = {"value": float(parameter.value), "unit": parameter.unit}
    if parameter.prior is not None:
        # Beside the value, which an estimation has moved away from its prior.
        written["prior"] = str(parameter.prior)
    # Infinite bounds are what a file without them means.
    if math.isfinite(parameter.lower):
        written["lower"] = float(parameter.lower)
    if math.isfinite(parameter.upper):
        written["upper"] = float(parameter.upper)
    if parameter.fixed:
        written["fixed"] = True
    if parameter.meaning:
        written["meaning"] = parameter.meaning
    return written
