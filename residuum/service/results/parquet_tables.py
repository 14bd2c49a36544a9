"""Findings and windows of a span of time as Parquet files (extra `parquet`), written some rows at a
time.

`findings.parquet` has a row a finding. `windows.parquet` has a row a window and channel, its
samples as a list; `values` is null where the retention rule has let the signal go. A missing sample
is NaN, as it was measured.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson

from residuum.identification.errors import BadInput
from residuum.library.optional_package import need
from residuum.service.storage.disk_store import DiskStore
from residuum.service.store import SignalLetGo, StoredFinding, StoredWindow

# A span of time as people write it, and what was stored in it.

# Rows that are read at once.
_MANY = 500
_MONTH = re.compile("[0-9]{4}-(0[1-9]|1[0-2])")


class Span(NamedTuple):
    """From `begin` until before `end`, both with their zone."""

    begin: datetime
    end: datetime


def span_of(begin: str, end: str) -> Span:
    """The span of two ISO 8601 times; a time without a zone is UTC. BadInput for what is none, or
    ends before it begins.

    >>> span_of("2026-11-01", "2026-11-02T12:00+01:00").end.isoformat()
    '2026-11-02T12:00:00+01:00'
    """
    span = Span(_moment("from", begin), _moment("to", end))
    if span.end <= span.begin:
        raise BadInput(f"from {begin!r}, to {end!r}: the end must lie after the begin")
    return span


def open_span(begin: str | None, end: str | None) -> tuple[datetime | None, datetime | None]:
    """The span of two ISO 8601 times either of which may be missing; BadInput as `span_of`."""
    if begin is not None and end is not None:
        return span_of(begin, end)
    return None if begin is None else _moment("from", begin), (
        None if end is None else _moment("to", end)
    )


def month_of(text: str) -> Span:
    """The month `YYYY-MM`, in UTC.

    >>> [moment.isoformat() for moment in month_of("2026-12")]
    ['2026-12-01T00:00:00+00:00', '2027-01-01T00:00:00+00:00']
    """
    try:
        if not _MONTH.fullmatch(text):
            raise ValueError
        begin = datetime(int(text[:4]), int(text[5:]), 1, tzinfo=UTC)
        # 32 days later it is the next month, whichever it is
        return Span(begin, (begin + timedelta(days=32)).replace(day=1))
    except (ValueError, OverflowError):
        # no such year, or its last month: the calendar ends with it
        raise BadInput(f"month {text[:40]!r}: must be YYYY-MM, for example 2026-11") from None


def findings_in(store: DiskStore, asset: str, span: Span) -> Iterator[StoredFinding]:
    """All findings of an asset in a span, oldest first."""
    after = 0
    while batch := store.findings_between(asset, *span, after=after, limit=_MANY):
        yield from batch
        after = batch[-1].id


def windows_in(store: DiskStore, asset: str, span: Span) -> Iterator[StoredWindow]:
    """All windows of an asset in a span, oldest first."""
    after = 0
    while batch := store.windows_between(asset, *span, after=after, limit=_MANY):
        yield from batch
        after = batch[-1].id


def _moment(name: str, text: str) -> datetime:
    try:
        read = datetime.fromisoformat(text)
        read = read if read.tzinfo else read.replace(tzinfo=UTC)
        read.astimezone(UTC)  # the database keeps UTC
    except (ValueError, OverflowError):
        # no time, or one that lies before or after the calendar in UTC
        raise BadInput(
            f"{name} {text[:40]!r}: must be a time like 2026-11-25 or 2026-11-25T08:00+01:00"
        ) from None
    return read


MEDIA_TYPE = "application/vnd.apache.parquet"
# Rows of a group, at most.
_ROWS = 500
# Bytes of samples in a group of rows, at most: what is held in memory.
_GROUP_BYTES = 64 * 2**20


def write_findings(store: DiskStore, asset: str, span: Span, path: Path) -> int:
    """Write the findings of an asset; gives their number. NotFound for an asset that is not
    there.
    """
    pa = need("pyarrow", "Parquet", "parquet")
    numbers, texts = pa.map_(pa.string(), pa.float64()), pa.map_(pa.string(), pa.string())
    schema = pa.schema(
        [
            ("id", pa.int64()),
            ("asset", pa.string()),
            ("window", pa.int64()),
            ("at", pa.timestamp("us", tz="UTC")),
            ("diagnoser", pa.string()),
            ("verdict", pa.string()),
            ("class", pa.string()),
            ("reason", pa.string()),
            ("indicators", numbers),
            ("thresholds", numbers),
            ("units", texts),
            ("evidence", pa.string()),
        ]
    )

    def rows() -> Iterator[tuple[dict[str, Any], int]]:
        for stored in findings_in(store, asset, span):
            plain = stored.to_json()
            evidence = orjson.dumps(plain["evidence"], option=orjson.OPT_SERIALIZE_NUMPY).decode()
            # evidence is whatever a diagnoser tells, of no fixed form: as JSON it is one column
            row = {
                name: plain[name]
                for name in (
                    "id",
                    "asset",
                    "window",
                    "at",
                    "diagnoser",
                    "verdict",
                    "class",
                    "reason",
                )
            }
            yield (
                row
                | {name: _pairs(plain[name]) for name in ("indicators", "thresholds", "units")}
                | {"evidence": evidence},
                0,
            )

    return _write(path, schema, rows())


def write_windows(
    store: DiskStore, asset: str, span: Span, path: Path, most_bytes: int | None = None
) -> int:
    """Write the windows of an asset with their signals; gives the number of rows.

    Raises
    ------
    NotFound
        There is no such asset.
    BadInput
        The samples take more than `most_bytes`.
    """
    pa = need("pyarrow", "Parquet", "parquet")
    schema = pa.schema(
        [
            ("window", pa.int64()),
            ("asset", pa.string()),
            ("received_at", pa.timestamp("us", tz="UTC")),
            ("channel", pa.string()),
            ("unit", pa.string()),
            ("t0", pa.float64()),
            ("sample_time", pa.float64()),
            ("values", pa.list_(pa.float64())),
        ]
    )

    def rows() -> Iterator[tuple[dict[str, Any], int]]:
        taken = 0
        for window in windows_in(store, asset, span):
            signals = _signals(store, asset, window.id)
            taken += sum(values.nbytes for values in signals.values())
            if most_bytes is not None and taken > most_bytes:
                raise BadInput(
                    f"from, to: the samples take more than {most_bytes / 2**20:.0f} MiB; ask for a"
                    " shorter span, or use `residuum results parquet`"
                )
            # a window whose signal was let go keeps its rows, with null for samples
            for channel, unit in window.units.items():
                values = signals.get(channel)
                row = {
                    "window": window.id,
                    "asset": asset,
                    "received_at": window.received_at,
                    "channel": channel,
                    "unit": unit,
                }
                row |= {"t0": window.t0, "sample_time": window.sample_time, "values": values}
                yield row, 0 if values is None else values.nbytes

    return _write(path, schema, rows())


def _signals(store: DiskStore, asset: str, window: int) -> dict[str, Any]:
    """The samples by channel; none where they were let go."""
    try:
        record = store.window_record(asset, window)
    except SignalLetGo:
        return {}
    return {name: np.asarray(values, dtype=float) for name, values in record.channels.items()}


def _write(path: Path, schema: Any, rows: Iterable[tuple[dict[str, Any], int]]) -> int:
    pa, parquet = (
        need("pyarrow", "Parquet", "parquet"),
        need("pyarrow.parquet", "Parquet", "parquet"),
    )
    written = held = 0
    waiting: list[dict[str, Any]] = []
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for row, size in rows:
            waiting.append(row)
            held += size
            written += 1
            # by rows or by bytes: findings are many and small, windows few and large
            if len(waiting) >= _ROWS or held >= _GROUP_BYTES:
                writer.write_table(pa.Table.from_pylist(waiting, schema))
                waiting, held = [], 0
        # a file without rows has the columns all the same
        if waiting or not written:
            writer.write_table(pa.Table.from_pylist(waiting, schema))
    return written


def _pairs(named: Mapping[str, Any]) -> list[tuple[str, Any]]:
    return list(named.items())
