"""Under which name a machine's baseline is stored, and its newest version."""

from __future__ import annotations

from residuum.service.store import ModelVersion, NotFound, Store

KIND = "baseline"


def baseline_name(store: Store, asset: str, wanted: str | None = None) -> str:
    """The wanted name or the asset's own; with the ending `.baseline` where a model of another kind has that one."""
    name = wanted or asset
    try:
        return name if store.model_versions(name)[0].kind == KIND else f"{asset[:54]}.{KIND}"
    except NotFound:
        return name


def newest_baseline(store: Store, asset: str, wanted: str | None = None) -> ModelVersion:
    """The newest version of a machine's baseline; NotFound before there is one."""
    return store.model_versions(baseline_name(store, asset, wanted))[0]


def has_baseline(store: Store, asset: str, wanted: str | None = None) -> bool:
    """Whether a machine has a baseline."""
    try:
        return newest_baseline(store, asset, wanted).kind == KIND
    except NotFound:
        return False
