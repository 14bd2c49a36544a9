"""The JSON file of a model with several inputs or outputs: its paths as identified models, and each output's joint covariance."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadModel
from residuum.identification.kernel_based.multivariable import MultivariableModel
from residuum.identification.linear_models.identified_model_file import identified_from, identified_object

FORMAT, VERSION = "residuum-multivariable-model", 1


def multivariable_text(model: MultivariableModel) -> str:
    """The file's text; `read_multivariable` reads it back to the same numbers."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "models": [[identified_object(path) for path in row] for row in model.models],
        "covariances": [covariance.tolist() for covariance in model.covariances],
    }
    return json.dumps(content)


def is_multivariable(path: str | Path) -> bool:
    """Whether a file calls itself a multivariable model; False for what cannot be read at all."""
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, RecursionError):
        return False
    return isinstance(content, dict) and content.get("format") == FORMAT


def load_multivariable(path: str | Path) -> MultivariableModel:
    """Read the file of a MultivariableModel.

    Raises BadModel, naming the file and the rule, when it is not one, or a path or a covariance does not fit.
    """
    path = Path(path)
    if not path.is_file():
        raise BadModel(f"{path}: no such file")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise BadModel(f"{path}: is not JSON ({error})") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT or content.get("version") != VERSION:
        raise BadModel(f"{path}: is not the file of a multivariable model ('format' must be {FORMAT!r}, 'version' {VERSION})")
    try:
        return multivariable_from(content, path)
    except (KeyError, TypeError, ValueError) as error:
        raise BadModel(f"{path}: {error}") from None


def multivariable_from(content: dict[str, Any], path: Path) -> MultivariableModel:
    """The model of a file's content; `path` names the file in what is refused."""
    models = tuple(tuple(identified_from(each, path) for each in row) for row in content["models"])
    covariances = tuple(np.asarray(each, dtype=float) for each in content["covariances"])
    if not models or len({len(row) for row in models}) != 1 or len(covariances) != len(models):
        raise BadModel(f"{path}: models must be a full grid, with one covariance an output")
    for row, covariance in zip(models, covariances, strict=True):
        size = sum(one.order for one in row)
        if covariance.shape != (size, size):
            raise BadModel(f"{path}: covariance of {row[0].output_name!r} has shape {covariance.shape}; must be ({size}, {size})")
    return MultivariableModel(models, covariances)
