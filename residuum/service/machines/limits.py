"""Limits that a user sets on a machine's parameters and effects: what must not be passed."""

from __future__ import annotations

from collections.abc import Mapping

import orjson

from residuum.service.machines.adding.kept_machines import KIND, document_name, kept_document
from residuum.service.store import Store


def _name(asset: str) -> str:
    return f"{asset}.limits"


def limits_of(store: Store, asset: str) -> dict[str, float]:
    """Name of a parameter → its limit, in the parameter's unit; none for a machine whose name is too long for a document."""
    return {str(name): float(value) for name, value in (kept_document(store, _name(asset)) or {}).items()}


def keep_limits(store: Store, asset: str, limits: Mapping[str, float], by: str) -> None:
    """Keep the limits in the place of those before; Conflict for a machine whose name is too long for a document."""
    document_name(asset)  # refuses a name that is too long
    store.add_model_version(_name(asset), KIND, orjson.dumps(dict(limits)), "limits", by)
