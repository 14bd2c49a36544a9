"""Stored windows whose signals are still kept."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from residuum.identification.record import Record
from residuum.service.store import SignalLetGo, Store


def kept_windows(store: Store, asset: str, windows: Iterable[int]) -> Iterator[tuple[int, Record]]:
    """Of these windows, in their order, each with its record; one whose signals were let go is passed over."""
    for window in windows:
        try:
            record = store.window_record(asset, window)
        except SignalLetGo:
            continue
        yield window, record
