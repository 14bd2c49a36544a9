"""The text of a physical model: a built-in one, a stored one, or a file that the settings name."""

from __future__ import annotations

from pathlib import Path

from residuum.identification.errors import BadInput
from residuum.identification.physics import BUILT_IN
from residuum.service.store import Conflict, NotFound, Store

ModelText = tuple[str, bytes | None]
"""A model's name and text; None for the text of a built-in one."""


def stored_model(store: Store, name: str, version: int | None = None) -> ModelText:
    """Name and text of a built-in or stored model; NotFound, or Conflict when it is not a physical one."""
    if version is None and name in BUILT_IN:
        return name, None
    found = store.model_versions(name)[0].kind
    if found != "physical":
        raise Conflict(f"model {name!r}: is a {found} model; this needs a physical one")
    return name, store.model_content(name, version)


def model_of_settings(store: Store, name: str) -> ModelText:
    """The model that a machine's settings name: built in, stored, or a file of this computer."""
    try:
        return stored_model(store, name)
    except NotFound:
        pass
    try:
        return Path(name).stem, Path(name).read_bytes()
    except OSError as error:
        raise BadInput(
            f"model {name!r}: is neither stored nor built in, and no file that can be read: {error.strerror}"
        ) from None
