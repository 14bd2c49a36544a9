"""The JSON schema of model files, for editors that complete and check YAML."""

from __future__ import annotations

from typing import Any

from residuum.identification.physics.effects import EFFECTS, STRUCTURAL
from residuum.identification.physics.files.effect_file import DEFINITION_KEYS, OWN_ID, PLACES
from residuum.identification.physics.files.model_file import (
    EFFECT_KEYS,
    INPUT_KEYS,
    KEYS,
    OUTPUT_KEYS,
    PARAMETER_KEYS,
    STATE_KEYS,
)
from residuum.identification.physics.model import BALANCE_KINDS

# As `model_file` reads them.
_NAME = "^[A-Za-z_][A-Za-z_0-9]*$"
_TEXT: dict[str, Any] = {"type": "string"}
_NUMBER: dict[str, Any] = {
    "type": ["number", "string"],
    "pattern": r"^[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?$",
}
"""A text as well, since YAML 1.1 reads `1e-4` as one."""
_UNCERTAIN: dict[str, Any] = {
    "type": "string",
    "pattern": r"^[-+.0-9eE]+\s*(±|\+-|\+/-)\s*[-+.0-9eE]+$",
}
"""A number and its standard deviation."""
_EXPRESSION = {"type": ["string", "number"]}
_TYPES: dict[str, dict[str, Any]] = {
    "unit": _TEXT, "rate": _TEXT, "default": {"type": ["string", "number"]},
    "value": {"anyOf": [_NUMBER, _UNCERTAIN]}, "lower": _NUMBER, "upper": _NUMBER,
    "fixed": {"type": "boolean"}, "meaning": _TEXT, "prior": _UNCERTAIN, "std": _NUMBER,
    "per": {"const": "record"}, "start": _NUMBER,
}  # fmt: skip


def model_schema() -> dict[str, Any]:
    """The schema (JSON Schema 2020-12). It says what a file may hold; names, units and equations
    are checked when it is read.

    >>> sorted(model_schema()["required"]), model_schema()["then"]["required"]
    (['name', 'outputs'], ['balances'])
    """
    parameter = _object(PARAMETER_KEYS, ["value"])
    of_part = _object(PARAMETER_KEYS, [])
    sections = {
        "name": _TEXT,
        "notes": {},
        "use": _named(_TEXT),
        "connect": _named(
            {
                "anyOf": [
                    {"type": "array", "minItems": 2, "items": _TEXT},
                    {"type": "object", "additionalProperties": _EXPRESSION},
                ]
            }
        ),
        "inputs": _named({"anyOf": [_TEXT, _object(INPUT_KEYS, ["unit"])]}),
        "states": _named(_object(STATE_KEYS, ["unit"])),
        "parameters": _named({"anyOf": [of_part, _NUMBER, _UNCERTAIN]}),
        "constants": _named({"type": ["number", "string"]}),
        "let": _named(_EXPRESSION),
        "balances": {
            "type": "object",
            "minProperties": 1,
            "additionalProperties": {"oneOf": _balances()},
        },
        "outputs": {
            "type": "object",
            "minProperties": 1,
            "additionalProperties": _object(OUTPUT_KEYS, ["value"], value=_EXPRESSION),
        },
        "own_effects": {"type": "array", "items": _own_effect()},
        "effects": {"type": "array", "items": _effect(parameter)},
        "initial": _named(_NUMBER),
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Residuum model file",
        "type": "object",
        "required": ["name", "outputs"],
        # without parts, the balances stand in the file and its parameters have values there
        "if": {"not": {"required": ["use"]}},
        "then": {"required": ["balances"], "properties": {"parameters": _named(parameter)}},
        "additionalProperties": False,
        "properties": {key: sections[key] for key in KEYS},
    }


def _balances() -> list[dict[str, Any]]:
    terms = {"type": "object", "additionalProperties": _EXPRESSION}
    schemas = []
    for kind, (_, roles) in BALANCE_KINDS.items():
        properties = {
            "kind": {"const": kind},
            "storage": _EXPRESSION,
            "terms": terms,
            "start": _NUMBER,
        }
        properties |= dict.fromkeys(roles, _TEXT)
        required = ["kind", "storage", "terms"]
        schemas.append(
            {
                "type": "object",
                "required": required,
                "additionalProperties": False,
                "properties": properties,
            }
        )
    return schemas


def _effect(parameter: dict[str, Any]) -> dict[str, Any]:
    properties = {
        "id": {"anyOf": [{"enum": [*EFFECTS, *STRUCTURAL]}, {"type": "string", "pattern": OWN_ID}]},
        **dict.fromkeys(("balance", "input", "output"), _TEXT),
        "parameters": _named({"anyOf": [_NUMBER, _UNCERTAIN, parameter]}),
        "provenance": {"type": "object"},
    }
    given = {key: properties[key] for key in EFFECT_KEYS}
    return {
        "type": "object",
        "required": ["id"],
        "additionalProperties": False,
        "properties": given,
    }


def _own_effect() -> dict[str, Any]:
    types = {
        "value": _NUMBER,
        "lower": _NUMBER,
        "upper": _NUMBER,
        "fixed": {"type": "boolean"},
        "size": {"type": "boolean"},
    }
    parameter = {
        "type": "object",
        "additionalProperties": False,
        "properties": types | {"unit": _TEXT, "meaning": _TEXT},
    }
    state = {"unit": _TEXT, "rate": _EXPRESSION, "start": _EXPRESSION}
    properties: dict[str, dict[str, Any]] = {
        **dict.fromkeys(DEFINITION_KEYS, _TEXT),
        "id": {"type": "string", "pattern": OWN_ID},
        "acts_on": {"type": "array", "minItems": 1, "items": {"enum": list(PLACES)}},
        "term": _EXPRESSION,
        "signal": _EXPRESSION,
        "parameters": _named(parameter),
        "states": _named(
            {
                "type": "object",
                "required": ["rate"],
                "additionalProperties": False,
                "properties": state,
            }
        ),
    }
    return {
        "type": "object",
        "required": ["id", "acts_on"],
        "additionalProperties": False,
        "properties": properties,
    }


def _object(
    keys: tuple[str, ...], required: list[str], **own_types: dict[str, Any]
) -> dict[str, Any]:
    properties = {key: own_types.get(key, _TYPES[key]) for key in keys}
    return {
        "type": "object",
        "required": required,
        "additionalProperties": False,
        "properties": properties,
    }


def _named(item: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "propertyNames": {"pattern": _NAME}, "additionalProperties": item}
