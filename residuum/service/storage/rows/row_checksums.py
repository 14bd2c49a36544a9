"""A checksum in the row of each window and finding: SQLite takes a bit that flipped in a value for another value."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import orjson

_SHORT = ("asset_id", "window_id", "at", "diagnoser", "verdict", "fault_class", "indicators", "thresholds", "units")
_LONG = ("evidence", "reason")
_WINDOW = (
    "asset_id",
    "received_at",
    "t0",
    "sample_time",
    "n",
    "units",
    "source",
    "block_path",
    "block_checksum",
    "size_bytes",
    "idempotency_key",
    "digest",
)
SHORT_OF_FINDING = _SHORT
"""Columns of a finding that its checksum's first half is of: a history reads no others."""


def of_finding(values: Mapping[Any, Any]) -> str:
    """The checksum of a finding's columns: 8 hexadecimal digits of those that a history needs, and 8 of the long ones."""
    return _crc([values[name] for name in _SHORT]) + _crc([values[name] for name in _LONG])


def of_window(values: Mapping[Any, Any]) -> str:
    """The checksum of a window's columns, but for the moment at which its signal is let go."""
    return _crc([values[name] for name in _WINDOW])


def finding_differs(values: Mapping[Any, Any]) -> bool:
    """Whether a finding's row, whole or without its long columns, differs from its checksum; those of old have none."""
    checksum = values["checksum"]
    return checksum is not None and not of_finding({name: values.get(name) for name in (*_SHORT, *_LONG)}).startswith(
        checksum if _LONG[0] in values else checksum[:8]
    )


def window_differs(values: Mapping[Any, Any]) -> bool:
    """Whether a window's row differs from its checksum; those of old have none."""
    return values["checksum"] is not None and values["checksum"] != of_window(values)


def _crc(values: Sequence[Any]) -> str:
    return f"{zlib.crc32(orjson.dumps(_plain(values), option=orjson.OPT_SORT_KEYS)):08x}"


def _plain(value: Any) -> Any:
    """The value as either database gives it back: a document of PostgreSQL tells 1.0 and 1 alike, and 0.0 and −0.0."""
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat()
    if isinstance(value, int | float) and not isinstance(value, bool):
        return repr(float(value) + 0.0) if abs(value) < 1e300 else str(value)
    if isinstance(value, Mapping):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value
