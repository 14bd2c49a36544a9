"""Model files that name an FMU, with values of its parameters and effects added to it.

    fmu: drive.fmu
    parameters:
      R: {value: 0.52, unit: ohm}
      J: {value: 0.07 ± 0.01, unit: kg*m**2, fixed: true}
    effects:
    - {id: coulomb-friction, balance: w, parameters: {tau_c: 283.0}}

The FMU is found beside the file. What stands under `parameters` is estimated unless it is fixed;
bounds are the FMU's own, unless the file has narrower ones.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from residuum.identification.errors import BadInput, BadModel, as_keyword
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.physics.files.model_file import (
    dumped,
    read_parameter,
    with_effects,
    written_effects,
    written_parameter,
)
from residuum.identification.physics.files.yaml_tree import Table, read_text, read_tree
from residuum.identification.physics.fmu.description import (
    Description,
    Settable,
    Variable,
    describe,
    is_fmu,
    unit_of,
)
from residuum.identification.physics.model import PhysicalModel
from residuum.nearest_names import known_names, nearest_names

KEYS = ("name", "notes", "fmu", "parameters", "own_effects", "effects")
_SHOWN = 20
"""Names that a refusal lists; of an FMU with more, the nearest of them."""


@dataclass(frozen=True)
class Named:
    """An FMU with what a file says of its parameters, and the tree of the file for its effects."""

    described: Description
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    tree: Table | None = None

    def with_effects(self, model: PhysicalModel) -> PhysicalModel:
        """The model with the file's effects."""
        return model if self.tree is None else with_effects(model, self.tree)


def named(path: str | Path) -> Named:
    """The FMU of this path, or the one that a model file names.

    Raises
    ------
    BadModel
        No such file; anything wrong in it; an FMU that cannot run here.
    """
    path = Path(path)
    if is_fmu(path):
        return Named(describe(path))
    tree = _tree(read_text(path), path.name)
    return _named(tree, describe(path.parent / tree.scalar("fmu", "model file of an FMU").text))


def named_in(text: str, source: str, described: Description) -> Named:
    """What a text says of an FMU that is at hand, wherever the one lies that it names."""
    return _named(_tree(text, source), described)


def _tree(text: str, source: str) -> Table:
    tree = read_tree(text, source)
    tree.only(KEYS, "model file of an FMU")
    return tree


def _named(tree: Table, described: Description) -> Named:
    table = tree.table("parameters", "model file of an FMU")
    parameters = {}
    for name in table:
        try:
            parameters[name] = _within(
                settable(described, name, "parameters"), read_parameter(name, table)
            )
        except BadInput as error:
            says = error.told(as_keyword)  # a section of the file, and no option
            has_place = says.startswith(table.place.source)
            raise (error if has_place else table.keys[name].refuse(says)) from None
    return Named(described, parameters, tree)


def _within(offered: Settable, written: Parameter) -> Parameter:
    """What a file says of a parameter, within the FMU's bounds and in its unit."""
    own = parameter_of(offered)
    if written.unit and written.unit != own.unit:
        raise BadModel(
            f"parameter {written.name!r}: unit is {written.unit!r} in the file and {own.unit!r} in"
            " the FMU; write the value in the FMU's unit"
        )
    # The narrower of both: the FMU refuses values beyond its own.
    lower = max(own.lower, written.lower)
    upper = min(own.upper, written.upper)
    if not lower <= written.value <= upper:
        raise BadModel(
            f"parameter {written.name!r}: value is {written.value:g}; must be within {lower:g} to"
            f" {upper:g}"
        )
    return replace(written, unit=own.unit, meaning=own.meaning, lower=lower, upper=upper)


def parameter_of(offered: Settable, *, fixed: bool = False) -> Parameter:
    """An FMU's parameter as a model's: its start, unit and bounds."""
    unit = unit_of(Variable(offered.name, offered.reference, offered.unit))
    return Parameter(
        offered.name, offered.start, unit, offered.lower, offered.upper, fixed, offered.meaning
    )


def settable(described: Description, name: str, where: str = "free") -> Settable:
    """The parameter of this name, which stands at a place that a refusal names.

    Raises
    ------
    BadInput
        A variable that is no fixed or tunable parameter, or no variable at all; with the nearest
        names.
    """
    if name in described.parameters:
        return described.parameters[name]
    known = _listed(name, described.parameters)
    if name in described.unsettable:
        kind = described.unsettable[name]
        raise BadInput(
            repr(name),
            where,
            f"is of the kind {kind!r} in the FMU; fixed and tunable parameters can be estimated,"
            f" {known}",
        )
    raise BadInput(repr(name), where, f"the FMU has no parameter of this name; {known}")


def _listed(name: str, offered: Iterable[str]) -> str:
    names = list(offered)
    if len(names) <= _SHOWN:
        return known_names(name, names, "there are")
    # An FMU may have thousands: the nearest five, or the first where none is near.
    near = nearest_names(name, names, most=5, like=0.3)
    return f"the nearest of its {len(names)} are {', '.join(near) or ', '.join(names[:5])}"


def free_missing(described: Description) -> BadInput:
    """The refusal to estimate an FMU none of whose parameters was named."""
    return BadInput(
        "",
        "free",
        f"is missing: say which of the FMU's parameters are estimated;"
        f" {_listed('', described.parameters)}",
    )


def text(
    described: Description,
    parameters: Mapping[str, Parameter],
    model: PhysicalModel,
    folder: Path,
) -> str:
    """The text of a file in this folder that names the FMU, with values of parameters and the
    model's effects.
    """
    # Relative: the folder can be moved as one.
    path = os.path.relpath(described.path, folder)
    document: dict[str, object] = {"name": described.name, "fmu": Path(path).as_posix()}
    if parameters:
        document["parameters"] = {n: written_parameter(p) for n, p in parameters.items()}
    return dumped(document | written_effects(model))
