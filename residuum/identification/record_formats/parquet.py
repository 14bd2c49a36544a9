"""Records as Parquet tables (extra `formats`): columns `name [unit]`, `time [s]` first, as in
CSV.
"""

from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.csv import MOST_COLUMNS, column_heads, table_record
from residuum.identification.record_formats.optional_package import need
from residuum.identification.record_formats.options import ReadOptions


def read_parquet(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """Read a table of numbers; null is a missing sample.

    Raises BadRecord when the file is no Parquet table, or a column is not of numbers.
    """
    pyarrow, parquet = need("pyarrow", path), need("pyarrow.parquet", path)
    try:
        # Reads the table's description alone: too many columns are refused before they are
        # unpacked.
        described = parquet.ParquetFile(path)
        if described.metadata.num_columns > MOST_COLUMNS:
            raise BadRecord(
                f"{path}: {described.metadata.num_columns} columns; at most {MOST_COLUMNS} are read"
            )
        table = described.read()
    except (OSError, pyarrow.lib.ArrowException) as error:
        raise BadRecord(
            f"{path}: is not a Parquet table: {' '.join(str(error).split())[:120]}"
        ) from None
    names, units = column_heads(table.column_names, str(path))
    columns = np.stack(
        [_numbers(column, name, path) for column, name in zip(table.columns, names, strict=True)]
    )
    notes = (table.schema.metadata or {}).get(b"residuum.notes", b"").decode("utf-8").splitlines()
    return table_record(names, units, columns, str(path), options, notes=tuple(notes))


def write_parquet(record: Record, path: str | Path) -> None:
    """Write a record so that `read_parquet` gives it back."""
    pyarrow, parquet = need("pyarrow", path), need("pyarrow.parquet", path)
    heads = [f"{name} [{unit}]" if unit else name for name, unit in record.units.items()]
    table = pyarrow.table(
        {"time [s]": record.time, **dict(zip(heads, record.channels.values(), strict=True))}
    )
    parquet.write_table(
        table.replace_schema_metadata({"residuum.notes": "\n".join(record.notes)}), path
    )


def _numbers(column: Any, name: str, path: str | Path) -> np.ndarray:
    try:
        return np.asarray(column.to_numpy(), dtype=float)
    except (TypeError, ValueError):
        raise BadRecord(f"{path}, column {name!r}: is not a column of numbers") from None
