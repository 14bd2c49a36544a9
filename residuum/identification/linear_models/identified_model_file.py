"""The JSON file of an IdentifiedModel."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadModel
from residuum.identification.linear_models.identified_model import IdentifiedModel

FORMAT, VERSION = "residuum-identified-model", 1
_NAMES = tuple(item.name for item in fields(IdentifiedModel) if item.name != "bands")
_REQUIRED = ("method", "sample_time", "impulse_response", "covariance", "noise_variance")
_TEXTS = ("method", "input_name", "input_unit", "output_name", "output_unit")
_MAPPINGS = ("hyper_parameters", "provenance")
# of fields whose kind no conversion settles: the kind, and how a refusal calls it
_KINDS: dict[str, tuple[type, str]] = {
    **dict.fromkeys(_TEXTS, (str, "a text")),
    **dict.fromkeys(_MAPPINGS, (dict, "an object")),
    "delay": (int, "a whole number"),
    "integrates": (bool, "true or false"),
}


def save_identified(model: IdentifiedModel, path: str | Path) -> None:
    """Write `model` as a JSON file that `load_identified` reads back to the same numbers."""
    Path(path).write_text(identified_text(model), encoding="utf-8")


def identified_text(model: IdentifiedModel) -> str:
    """The content of a model's file."""
    return json.dumps({"format": FORMAT, "version": VERSION, **identified_object(model)})


def identified_object(model: IdentifiedModel) -> dict[str, Any]:
    """The model's fields as JSON values."""
    stored = {name: _plain(getattr(model, name)) for name in _NAMES}
    if model.bands is not None:
        stored["pointwise_std"] = _plain(model.std)
    return stored


def load_identified(path: str | Path) -> IdentifiedModel:
    """Read the file of an IdentifiedModel.

    Raises BadModel, naming the file and the rule, when it is not one, lacks a field, has an unknown
    one, or holds numbers that make no model (a covariance with a negative eigenvalue is refused
    too).
    """
    path = Path(path)
    return identified_from(_parse(path), path)


def identified_from(content: dict[str, Any], path: Path) -> IdentifiedModel:
    """The model of such fields; BadModel, naming the file, as `load_identified` says."""
    if unknown := sorted(set(content) - set(_NAMES)):
        raise BadModel(f"{path}: unknown field {unknown[0]!r}")
    if missing := [name for name in _REQUIRED if name not in content]:
        raise BadModel(f"{path}: field {missing[0]!r} is missing")
    try:
        model = IdentifiedModel(**{name: _typed(name, value) for name, value in content.items()})
    except (BadModel, TypeError, ValueError) as error:
        raise BadModel(f"{path}: {error}") from None
    _refuse_indefinite(model, path)
    return model


def read_json(path: Path) -> Any:
    """What a JSON file of a model holds; BadModel, naming the file, where there is none or it is
    not JSON.
    """
    if not path.is_file():
        raise BadModel(f"{path}: no such file")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise BadModel(
            f"{path}: is not an identified model, as `residuum identify` writes one: {error}"
        ) from None


def _parse(path: Path) -> dict[str, Any]:
    content = read_json(path)
    if not isinstance(content, dict) or content.pop("format", None) != FORMAT:
        raise BadModel(
            f"{path}: is not an identified model, as `residuum identify` writes one ('format' must"
            f" be {FORMAT!r})"
        )
    if (version := content.pop("version", None)) != VERSION:
        raise BadModel(
            f"{path}: has version {version!r}; this program reads version {VERSION}; identify it"
            " again"
        )
    return content


def _typed(name: str, value: Any) -> Any:
    """The value as its field wants it; TypeError when it is of another kind."""
    if name in _KINDS:
        kind, called = _KINDS[name]
        if not isinstance(value, kind):
            raise TypeError(f"field {name!r} must be {called}")
    if name == "negative_log_likelihood" and value is None:
        return float("nan")  # JSON has no NaN
    if name in ("sample_time", "noise_variance", "offset", "negative_log_likelihood"):
        return float(value)
    return value


def _refuse_indefinite(model: IdentifiedModel, path: Path) -> None:
    for name in ("covariance", "parameter_covariance", "longer_covariance"):
        matrix = getattr(model, name)
        if matrix is None:
            continue
        if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=1e-9 * np.abs(matrix).max()):
            raise BadModel(f"{path}: {name} is not symmetric")
        eigenvalues = np.linalg.eigvalsh(matrix)
        if eigenvalues[0] < -1e-9 * max(eigenvalues[-1], 0.0) or eigenvalues[-1] < 0:
            raise BadModel(f"{path}: {name} has a negative eigenvalue; a covariance has none")


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "items"):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
