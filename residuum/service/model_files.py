"""Checking a model file before it is stored: every kind of model has its reader."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from residuum.identification.errors import BadInput, BadModel
from residuum.identification.linear_models.identified_model_file import load_identified
from residuum.identification.physics.files.model_file import load_model
from residuum.service.machines.judges import diagnoser_class

MODEL_KINDS: dict[str, tuple[str, str]] = {
    "physical": ("application/yaml", ".yaml"),
    "identified": ("application/json", ".json"),
    "baseline": ("application/zip", ".zip"),
}
"""Media type and file ending of each kind."""


def check_model_file(kind: str, content: bytes, diagnoser: str | None = None) -> None:
    """Refuse a file that its reader refuses; the reader's message is kept, with 'body' for the file's name."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"model{MODEL_KINDS[kind][1]}"
        file.write_bytes(content)
        try:
            _reader(kind, diagnoser)(file)
        except BadInput as error:
            raise BadModel(str(error).replace(str(file), "body").replace(file.name, "body")) from None


def _reader(kind: str, diagnoser: str | None) -> Callable[[Path], object]:
    if kind == "baseline":
        if diagnoser is None:
            raise BadInput("query: diagnoser is missing; a baseline needs it")
        return diagnoser_class(diagnoser).load
    return load_model if kind == "physical" else load_identified
