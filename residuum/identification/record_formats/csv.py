"""Records as CSV: `name [unit]` heads, `time [s]` first, one row a sample."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.even_time import even_columns
from residuum.identification.record_formats.loggers.logger_file import understand
from residuum.identification.record_formats.loggers.logger_head import unit_of_head
from residuum.identification.record_formats.loggers.logger_mapping import (
    DUPLICATES,
    LoggerMapping,
    no_number,
    parse_logger,
)
from residuum.identification.record_formats.options import ReadOptions
from residuum.identification.record_formats.scope_csv import is_scope_csv, parse_scope_csv

MOST_COLUMNS = 1000
_LONGEST_HEADER = 100_000  # bytes
_HEAD = re.compile(r"^(?P<name>.*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?$")
AS_LOGGER = "read as a logger's file"
"""How the note begins that tells what was guessed."""
_OURS = re.compile(rb"\s*time\s*\[s\]\s*,")
# places between two separators, at the end of a line and at its begin
_EMPTY_CELL = re.compile(rb"(?<=,)(?=[ \t]*(?:,|\r?\n|$))|(?<=\n)(?=,)")


def read_csv(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """Read a record from a CSV file, or what a logger wrote where its text leaves no doubt how to
    read it.

    In a file of ours the first column is `time [s]`, and commas cut its cells. Where more is said
    of it, it is a logger's.

    The first line that does not begin with `#` names the columns; `# …` lines before it become
    notes. An empty cell or `nan` is a missing sample. Time must be even: a step that differs from
    the median by more than 1 % is refused with its row, unless `options.resample` asks for
    interpolation onto even instants.

    Raises BadRecord with the file and, where there is one, the row and column.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadRecord(f"{path}: cannot be read: {error.strerror}") from None
    if is_scope_csv(content):
        return parse_scope_csv(content, str(path), options)
    # What is said of a logger's text needs the reader that heeds it: a cell that was said to mean
    # no value once stayed a value here.
    ours = is_ours(content) and not options.of_a_logger
    return (
        parse_csv(content, str(path), options)
        if ours
        else _from_logger(content, str(path), options)
    )


def is_ours(content: bytes) -> bool:
    """Whether nothing is guessed: all is UTF-8, the first line that is no note begins with `time
    [s],`, and no quotes follow.

    A first line that is too long for any header is left to the reader that says so.
    """
    start = content[: 3 * _LONGEST_HEADER].removeprefix(b"\xef\xbb\xbf")
    lines = (line for line in start.splitlines() if line.strip() and not line.startswith(b"#"))
    head, first = next(lines, b""), next(lines, b"")
    return (
        # Nothing to read, or far too much, is left to the strict reader, which names the row.
        not head
        or len(head) > _LONGEST_HEADER
        or (bool(_OURS.match(head)) and b'"' not in head + first and _is_utf8(start))
    )


def _is_utf8(start: bytes) -> bool:
    try:
        start.decode("utf-8")
    except UnicodeDecodeError as error:
        return error.end >= len(start) - 3  # the cut may have gone through a letter
    return True


def _from_logger(content: bytes, source: str, options: ReadOptions) -> Record:
    """A logger's file by what is understood of it; BadRecord, with the way to settle it, where that
    is not sure.
    """
    mapping = understand(
        content,
        source,
        decimal=options.decimal,
        time_form=options.time_form,
        time_column=options.time_column,
        told_units=options.units,
        missing=options.missing,
        sample_time=options.sample_time,
        heads=options.names,
    ).mapping
    record = parse_logger(content, source, mapping, options)
    habits = (
        f"cells cut by {mapping.delimiter!r}, decimal sign {mapping.decimal!r}, {_times(mapping)}"
    )
    note = f"{AS_LOGGER}: {habits}"
    return replace(record, notes=(note, *record.notes))


def _times(mapping: LoggerMapping) -> str:
    return (
        f"times {mapping.time_form}"
        if mapping.time
        else f"rows of {mapping.sample_time:g} s, as was said"
    )


def parse_csv(content: bytes, source: str, options: ReadOptions = ReadOptions()) -> Record:
    """Read a record from the bytes of a CSV file (see `read_csv`); `source` names it in
    messages.
    """
    notes, header, body, first_row = _split(content, source)
    names, units = column_heads(header.split(","), source)
    table = _numbers(body, len(names), first_row, source)
    _refuse_rounded_times(table[:, 0], first_row, source)
    return table_record(
        names,
        units,
        np.ascontiguousarray(table.T),
        source,
        options,
        notes=notes,
        first_row=first_row,
    )


def _refuse_rounded_times(time: npt.NDArray[np.float64], first_row: int, source: str) -> None:
    """Refuse times that were written with too few digits, so that neighbours are the same."""
    if (same := np.diff(time) == 0).any():
        row = first_row + 1 + int(np.argmax(same))
        says = (
            f"{source}, row {row}: time does not increase, {time[row - first_row]:g} s stands twice"
        )
        raise BadRecord(f"{says}; write times with more digits, or", way_on=[DUPLICATES])


def column_heads(cells: list[str], source: str) -> tuple[list[str], list[str]]:
    """Names and units from column heads `name [unit]`; names must be given and different."""
    if len(cells) > MOST_COLUMNS:
        raise BadRecord(f"{source}: {len(cells)} columns; at most {MOST_COLUMNS} are read")
    names, units = [], []
    for position, cell in enumerate(cells, start=1):
        match = _HEAD.match(cell.strip().strip('"').strip())
        name = match.group("name").strip() if match else ""
        if not name:
            raise BadRecord(
                f"{source}, header, column {position}: has no name; write 'name [unit]'"
            )
        if name in names:
            raise BadRecord(f"{source}, header, column {position}: name {name!r} stands twice")
        unit = (match.group("unit") or "").strip() if match else ""
        name, unit = (name, unit) if unit else unit_of_head(name)
        names.append(name)
        units.append(unit)
    if len(names) < 2:
        raise BadRecord(
            f"{source}: has the one column {names[0]!r}; time and at least one channel are needed"
        )
    return names, units


def table_record(
    names: list[str],
    units: list[str],
    columns: npt.NDArray[np.float64],
    source: str,
    options: ReadOptions,
    *,
    notes: tuple[str, ...] = (),
    first_row: int = 0,
) -> Record:
    """The record of a table whose first column is `time [s]`; `columns` has shape (1 + channels,
    n).
    """
    if names[0] != "time":
        raise BadRecord(f"{source}: first column is {names[0]!r}; it must be 'time [s]'")
    if units[0] != "s":
        raise BadRecord(f"{source}: the time column is in {units[0]!r}; it must be in [s]")
    for name, column in zip(names, columns, strict=True):
        if (infinite := np.isinf(column)).any():
            row = first_row + int(np.argmax(infinite))
            raise BadRecord(
                f"{source}, row {row}, column {name!r}: infinite value; must be finite or empty"
                " (missing)"
            )
    remarks: list[str] = []
    step, columns = even_columns(
        columns,
        source,
        resample=options.resample,
        first_row=first_row,
        told=remarks,
        names=names[1:],
    )
    options.settle_sample_time(step, source)
    return Record(
        dict(zip(names[1:], columns[1:], strict=True)),
        {
            name: options.unit_of(name, unit)
            for name, unit in zip(names[1:], units[1:], strict=True)
        },
        step,
        t0=float(columns[0][0]),
        notes=(*notes, *remarks),
        source=source,
    )


def write_csv(record: Record, path: str | Path) -> None:
    """Write a record so that `read_csv` gives it back (values to 10 significant digits)."""
    heads = ["time [s]"] + [
        f"{name} [{unit}]" if unit else name for name, unit in record.units.items()
    ]
    lines = [f"# {note}" for note in record.notes] + [",".join(heads)]
    # four digits beyond the first of the sample time, so that rounded times stay even
    decimals = max(6, int(np.ceil(-np.log10(record.sample_time))) + 4)
    formats = [f"%.{decimals}f"] + ["%.10g"] * len(record.names)
    table = np.column_stack([record.time, *record.channels.values()])
    with open(path, "w", encoding="utf-8", newline="\n") as file:
        np.savetxt(file, table, fmt=formats, delimiter=",", header="\n".join(lines), comments="")


def _split(content: bytes, source: str) -> tuple[tuple[str, ...], str, bytes, int]:
    """(notes, header line, bytes of the rows, file row of the first of them)."""
    content = content.removeprefix(b"\xef\xbb\xbf")
    notes: list[str] = []
    position, row = 0, 0
    while position < len(content):
        end = content.find(b"\n", position)
        end = len(content) if end < 0 else end
        row += 1
        if end - position > _LONGEST_HEADER:
            raise BadRecord(
                f"{source}, row {row}: header of {end - position} bytes; at most {_LONGEST_HEADER}"
                " are read"
            )
        try:
            line = content[position:end].decode("utf-8").strip()
        except UnicodeDecodeError:
            raise BadRecord(f"{source}, row {row}: is not UTF-8 text; save it as UTF-8") from None
        position = end + 1
        if line.startswith("#"):
            notes.append(line[1:].strip())
        elif line:
            return tuple(notes), line, content[position:], row + 1
    raise BadRecord(f"{source}: is empty; a header line and at least two rows are needed")


def _numbers(body: bytes, width: int, first_row: int, source: str) -> npt.NDArray[np.float64]:
    """The table of numbers, shape (rows, width); the slow path only runs to name a bad cell."""
    body = _EMPTY_CELL.sub(b"nan", body) if _may_lack_a_cell(body) else body
    lines = body.decode("utf-8", errors="replace").splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    if len(lines) < 2:
        raise BadRecord(f"{source}: has {len(lines)} data rows; at least 2 are needed")
    # one pass in C over all lines; where it refuses, `_bad_cell` looks which cell it was
    try:
        # Without comments: a # within a row is a fault, and must not cut its cells off.
        table = np.loadtxt(lines, delimiter=",", comments=None, ndmin=2, dtype=np.float64)
    except ValueError:
        table = None
    if table is None or table.shape != (len(lines), width):
        raise _bad_cell(lines, width, first_row, source)
    return table


def _may_lack_a_cell(body: bytes) -> bool:
    """Whether two separators stand side by side: to look for empty cells one by one takes twice as
    long as to read numbers.
    """
    compact = body.translate(None, b" \t\r")
    return compact.endswith(b",") or any(pair in compact for pair in (b",,", b",\n", b"\n,"))


def _bad_cell(lines: list[str], width: int, first_row: int, source: str) -> BadRecord:
    for row, line in enumerate(lines, start=first_row):
        cells = line.split(",")
        if len(cells) != width:
            return BadRecord(f"{source}, row {row}: {len(cells)} cells; the header has {width}")
        for column, cell in enumerate(cells, start=1):
            try:
                float(cell)
            except ValueError:
                return no_number(cell.strip(), f"{source}, row {row}, column {column}")
    return BadRecord(f"{source}: is not a table of numbers")
