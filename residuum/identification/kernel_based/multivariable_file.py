"""The JSON file of a model with several inputs or outputs: its paths as identified models, and each output's joint covariance."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadModel
from residuum.identification.kernel_based.multivariable import MultivariableModel
from residuum.identification.kernel_based.outlasting import Longer
from residuum.identification.linear_models.identified_model_file import identified_from, identified_object, read_json

FORMAT, VERSION = "residuum-multivariable-model", 1


def multivariable_text(model: MultivariableModel) -> str:
    """The file's text; `read_multivariable` reads it back to the same numbers."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "models": [[identified_object(path) for path in row] for row in model.models],
        "covariances": [covariance.tolist() for covariance in model.covariances],
        "longer": [_longer_object(one) for one in model.longer],
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
    content = read_json(path)
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
    longer = tuple(_longer_from(each, path) for each in content.get("longer", []))  # files of older versions have none
    if longer and len(longer) != len(models):
        raise BadModel(f"{path}: longer must have an entry an output")
    for row, one in zip(models, longer, strict=False):
        if one is not None and (len(one.mean) % len(row) or one.covariance.shape != (len(one.mean), len(one.mean))):
            raise BadModel(
                f"{path}: longer responses of {row[0].output_name!r} do not fit {len(row)} inputs and their covariance"
            )
    return MultivariableModel(models, covariances, longer)


def _longer_object(longer: Longer | None) -> dict[str, Any] | None:
    if longer is None:
        return None
    return {"mean": longer.mean.tolist(), "covariance": longer.covariance.tolist(), "negligible": longer.negligible}


def _longer_from(content: dict[str, Any] | None, path: Path) -> Longer | None:
    if content is None:
        return None
    mean, covariance = (np.asarray(content[name], dtype=float) for name in ("mean", "covariance"))
    if mean.ndim != 1 or not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        raise BadModel(f"{path}: longer responses must be finite numbers")
    return Longer(mean, covariance, bool(content["negligible"]))
