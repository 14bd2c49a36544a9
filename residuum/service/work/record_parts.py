"""A record as it travels to a worker process."""

from __future__ import annotations

from typing import Any

from residuum.identification.record import Record

RecordParts = tuple[dict[str, Any], dict[str, str], float, float, tuple[str, ...], str]
"""The arguments of `Record`."""


def parts_of(record: Record, source: str | None = None) -> RecordParts:
    """The record's content, for a worker process; `source` is what results and messages call it (default: as the record does)."""
    named = record.source if source is None else source
    return dict(record.channels), dict(record.units), record.sample_time, record.t0, record.notes, named
