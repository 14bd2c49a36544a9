"""Change values, bounds and fixedness of a model's parameters, its structure as it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import inf
from typing import Any

from residuum.identification.errors import BadModel
from residuum.identification.physics import PhysicalModel, read_model, write_model
from residuum.identification.physics.effects.base import Parameter
from residuum.nearest_names import known_names

_UNBOUNDED = {"lower": -inf, "upper": inf}


def with_parameters(model: PhysicalModel, changes: Mapping[str, Mapping[str, Any]]) -> str:
    """The text of the model with some parameters changed.

    `changes` maps a parameter's full name (`R`, `coulomb-friction@shaft.tau_c`) to its new `value`, `lower`, `upper` (None: no
    bound) or `fixed`. BadModel for an unknown name, or for what no model file may hold (a value outside its bounds).
    """
    if unknown := [name for name in changes if name not in model.all_parameters]:
        known = known_names(unknown[0], model.all_parameters, "there are")
        raise BadModel(f"model {model.name!r}: no parameter {unknown[0][:60]!r}; {known}")
    changed = {name: _changed(parameter, changes.get(name, {})) for name, parameter in model.all_parameters.items()}
    for name, parameter in changed.items():
        if name in changes and not parameter.lower <= parameter.value <= parameter.upper:
            bounds = f"{parameter.lower:g} … {parameter.upper:g} {parameter.unit}".rstrip()
            raise BadModel(f"parameter {name!r}: value {parameter.value:g} must be within {bounds}")
    effects = tuple(
        replace(use, parameters={name: changed[f"{use.label}.{name}"] for name in use.parameters}) for use in model.effects
    )
    text = write_model(replace(model, parameters={name: changed[name] for name in model.parameters}, effects=effects))
    read_model(text, model.name)
    return text


def _changed(parameter: Parameter, change: Mapping[str, Any]) -> Parameter:
    fields: dict[str, Any] = {field: _UNBOUNDED.get(field) if value is None else value for field, value in change.items()}
    return replace(parameter, **fields)
