"""Findings and windows of a span of time as Parquet files (extra `parquet`), written some rows at a time.

`findings.parquet` has a row a finding. `windows.parquet` has a row a window and channel, its samples as a list; `values` is null
where the retention rule has let the signal go. A missing sample is NaN, as it was measured.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from residuum.identification.errors import BadInput
from residuum.library.optional_package import need
from residuum.service.results.time_span import Span, findings_in, windows_in
from residuum.service.store import SignalLetGo, Store

MEDIA_TYPE = "application/vnd.apache.parquet"
_ROWS = 500
_GROUP_BYTES = 64 * 2**20
"""Bytes of samples in a group of rows, at most: what is held in memory."""


def write_findings(store: Store, asset: str, span: Span, path: Path) -> int:
    """Write the findings of an asset; gives their number. NotFound for an asset that is not there."""
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
        for found in findings_in(store, asset, span):
            plain = found.to_json()
            evidence = orjson.dumps(plain["evidence"], option=orjson.OPT_SERIALIZE_NUMPY).decode()
            kept = {name: plain[name] for name in ("id", "asset", "window", "at", "diagnoser", "verdict", "class", "reason")}
            yield kept | {name: _pairs(plain[name]) for name in ("indicators", "thresholds", "units")} | {"evidence": evidence}, 0

    return _write(path, schema, rows())


def write_windows(store: Store, asset: str, span: Span, path: Path, most_bytes: int | None = None) -> int:
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
                    f"from, to: the samples take more than {most_bytes / 2**20:.0f} MiB; ask for a shorter span, "
                    "or use `residuum results parquet`"
                )
            for channel, unit in window.units.items():
                values = signals.get(channel)
                kept = {"window": window.id, "asset": asset, "received_at": window.received_at, "channel": channel, "unit": unit}
                kept |= {"t0": window.t0, "sample_time": window.sample_time, "values": values}
                yield kept, 0 if values is None else values.nbytes

    return _write(path, schema, rows())


def _signals(store: Store, asset: str, window: int) -> dict[str, Any]:
    """The samples by channel; none where they were let go."""
    try:
        record = store.window_record(asset, window)
    except SignalLetGo:
        return {}
    return {name: np.asarray(values, dtype=float) for name, values in record.channels.items()}


def _write(path: Path, schema: Any, rows: Iterable[tuple[dict[str, Any], int]]) -> int:
    pa, parquet = need("pyarrow", "Parquet", "parquet"), need("pyarrow.parquet", "Parquet", "parquet")
    written = held = 0
    waiting: list[dict[str, Any]] = []
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for row, size in rows:
            waiting.append(row)
            held += size
            written += 1
            if len(waiting) >= _ROWS or held >= _GROUP_BYTES:
                writer.write_table(pa.Table.from_pylist(waiting, schema))
                waiting, held = [], 0
        if waiting or not written:
            writer.write_table(pa.Table.from_pylist(waiting, schema))
    return written


def _pairs(named: Mapping[str, Any]) -> list[tuple[str, Any]]:
    return list(named.items())
