"""GrowingFileSource: the rows that a logger adds to its text file, read as they come.

The map of such a source says which columns of the file are its channels:

```yaml
delimiter: ","                       # the rest of these has the defaults that stand here
decimal: "."
encoding: utf-8
missing: []                          # cells that mean no value, beside the usual ones (`NaN`, `-`)
header_row: null                     # file row of the columns' names; null: the first that is no #
rows_from: null                      # file row of the first sample; null: the one behind them
streams:
  signals:
    sample_time: 0.1                 # s from row to row
    time: {column: "time", form: iso}     # a list of two columns: date, time of day
    channels:
      speed: {column: "speed [rpm]", unit: rpm}
      force: {column: "force", unit: N, scale: 1000}
```

Columns are found by their heads, to the letter: what moved in a new file is found again, what got
another head is refused.
"""

from __future__ import annotations

import csv
import os
import stat
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator

from residuum.identification.record_formats.loggers.logger_text import (
    MISSING,
    cells_of,
    is_value,
    number,
)
from residuum.identification.record_formats.loggers.logger_time import FORMS, nanoseconds
from residuum.nearest_names import known_names
from residuum.service.fieldbus.can.frame_layout import BadBusDescription
from residuum.service.fieldbus.map_text import read_map
from residuum.service.fieldbus.source import Sink, Source, StreamFormat
from residuum.service.fieldbus.source_kind import Address, SourceKind, text_of_map
from residuum.service.fieldbus.stamped_samples import StampedSamples
from residuum.service.fieldbus.strict_model import StrictModel

SCHEME = "file:"
# Of a time of day without a date: how far it goes back at midnight at least [s].
_DAY = 86_400.0


def _several(columns: object) -> object:
    return columns if isinstance(columns, list | tuple) else (columns,)


class RowTime(StrictModel):
    """The column of times, or those of date and of time of day, and the form of what stands in
    it.
    """

    column: Annotated[tuple[str, ...], BeforeValidator(_several)] = Field(
        min_length=1, max_length=2
    )
    form: str

    @field_validator("form")
    @classmethod
    def _known(cls, form: str) -> str:
        if form not in FORMS:
            raise ValueError(f"{form!r} is no form of times; {known_names(form, FORMS)}")
        return form


class ChannelColumn(StrictModel):
    """The column of a channel, and how its numbers become values in this unit: value · scale +
    offset.
    """

    column: str = Field(min_length=1)
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0


class StreamColumns(StrictModel):
    """The one stream of a file: its clock and its channels."""

    sample_time: float = Field(gt=0, le=3600)
    time: RowTime
    channels: dict[str, ChannelColumn] = Field(min_length=1, max_length=500)

    def format(self, name: str) -> StreamFormat:
        """What the stream carries."""
        return StreamFormat(
            name, self.sample_time, {channel: spec.unit for channel, spec in self.channels.items()}
        )


class ColumnMap(StrictModel):
    """How the rows of a file are cut into cells, and which of them are channels."""

    delimiter: str = Field(",", min_length=1, max_length=1)
    decimal: Literal[".", ","] = "."
    # those of which every line ends in the byte of a line's end
    encoding: Literal["utf-8", "latin-1", "cp1252"] = "utf-8"
    missing: tuple[str, ...] = ()
    header_row: int | None = Field(None, ge=1, le=1000)
    rows_from: int | None = Field(None, ge=1, le=1000)
    streams: dict[str, StreamColumns] = Field(min_length=1, max_length=1)


def read_column_map(path: Path) -> ColumnMap:
    """The column map of a file; BadBusDescription names file and field."""
    return read_map(path, ColumnMap)


def path_of(channel: str) -> Path:
    """The file of an address `file:PATH` or `file:///PATH`; ValueError for any other.

    >>> path_of("file:/var/log/press.csv") == path_of("file:///var/log/press.csv")
    True
    """
    name = channel.removeprefix(SCHEME)
    name = name.removeprefix("//") if name.startswith("///") else name
    if not channel.startswith(SCHEME) or not name or name.startswith("//") or "\0" in name:
        raise ValueError(
            "a source of a growing file needs a channel, for example file:/var/log/machine.csv"
        )
    return Path(name)


def channel_below(channel: str, folder: Path | None) -> str:
    """The address of a file below the folder of growing files, where it is one; a path that does
    not begin with `/` counts from there.

    BadBusDescription for any other file, and where there is no such folder: whoever adds a machine
    reads no file of the computer by it.
    """
    try:
        path = path_of(channel)
    except ValueError as error:
        raise BadBusDescription(f"{channel[:80]!r}: {error}") from None
    if folder is None:
        raise BadBusDescription(
            f"{channel[:80]!r}: the setting growing_files names no folder; files are read below it"
            " alone, or for machines of the settings' file"
        )
    root = folder.resolve()
    # resolved only to be looked at: a link that is turned to the newest file has to stay one
    if ".." in path.parts or not (root / path).resolve().is_relative_to(root):
        raise BadBusDescription(
            f"{channel[:80]!r}: is not below the folder that the setting growing_files names"
        )
    return f"{SCHEME}{root / path}"


# Rows: what the lines of a file are.


class _Unreadable(Exception):
    """A line that is no sample; the message says why."""


@dataclass(frozen=True)
class _Row:
    stamp: float
    values: Mapping[str, float]
    none: Sequence[str]
    """Channels that have no value."""
    wrong: Mapping[str, str]
    """Channels whose cell is neither a number nor no value, with the cell."""


class RowReader:
    """The rows of one file, one after the other; a header tells where their columns are.

    `refusal` says why rows are not read: their header lacks a column of the map, or has it twice.
    """

    def __init__(self, columns: ColumnMap, stream: StreamColumns) -> None:
        self._map, self._stream = columns, stream
        self._missing = {*MISSING, *(cell.strip().lower() for cell in columns.missing)}
        self.restart()

    def restart(self) -> None:
        """What comes next is the first line of a file."""
        self._line = 0
        self._heads: list[str] = []
        self._places: dict[str, int] = {}
        self._days, self._clock = 0.0, -1.0
        self.refusal = ""

    @property
    def heads(self) -> Sequence[str]:
        """The heads of the columns; none before the header."""
        return self._heads

    def row(self, line: str) -> _Row | None:
        """The sample of a line; None for a line that holds none: a note, the header.

        Raises _Unreadable for one that should be a sample, and once for a header that is refused.
        """
        self._line += 1
        if not self._heads:
            if self._is_header(line):
                self._take_header(self._cells(line.removeprefix("\ufeff")))
            return None
        if self._line < (self._map.rows_from or 0) or not line.strip() or line.startswith("#"):
            return None
        cells = self._cells(line)
        if self._looks_like_header(cells):
            self._take_header(cells)
            return None
        if self.refusal:
            raise _Unreadable("")
        if len(cells) != len(self._heads):
            raise _Unreadable(f"{len(cells)} cells, the header has {len(self._heads)}")
        return self._sample(cells)

    def passed_over(self) -> None:
        """A line is left unread: only its number counts."""
        self._line += 1

    def _cells(self, line: str) -> list[str]:
        return next(iter(cells_of(line, self._map.delimiter)), [])

    def _is_header(self, line: str) -> bool:
        if self._map.header_row is not None:
            return self._line == self._map.header_row
        return bool(line.strip()) and not line.removeprefix("\ufeff").startswith("#")

    def _looks_like_header(self, cells: list[str]) -> bool:
        """Whether a line among the samples names columns anew, as of a logger that was started
        again: as wide as the rows, and nothing but words.
        """
        words = [cell for cell in cells if cell.lower() not in self._missing]
        return (
            len(cells) == len(self._heads)
            and 2 * len(words) > len(cells)
            and not any(map(is_value, words))
        )

    def _take_header(self, cells: list[str]) -> None:
        if cells == self._heads and not self.refusal:
            return
        self._heads = cells
        wanted = [*self._stream.time.column, *(c.column for c in self._stream.channels.values())]
        bad = next((column for column in wanted if cells.count(column) != 1), None)
        if bad is None:
            self.refusal = ""
            self._places = {column: cells.index(column) for column in wanted}
            return
        names = [cell[:60] for cell in cells if cell]
        has = f"no column {bad[:60]!r}; {known_names(bad, names, 'it has')}"
        if bad in cells:
            has = f"two columns {bad[:60]!r}"
        self.refusal = (
            f"row {self._line}: the header has {has}. Rows are not read until it fits the map"
        )
        raise _Unreadable(self.refusal)

    def _sample(self, cells: list[str]) -> _Row:
        values: dict[str, float] = {}
        none, wrong = [], {}
        stamp = self._stamp(cells)
        for name, spec in self._stream.channels.items():
            cell = cells[self._places[spec.column]]
            values[name] = float("nan")
            if cell.lower() in self._missing:
                none.append(name)
                continue
            try:
                values[name] = number(cell, self._map.decimal) * spec.scale + spec.offset
            except ValueError:
                wrong[name] = cell[:40]
        return _Row(stamp, values, none, wrong)

    def _stamp(self, cells: list[str]) -> float:
        """The time of a row [s]."""
        told, form = self._stream.time, self._stream.time.form
        cell = " ".join(cells[self._places[column]] for column in told.column)
        try:
            seconds = nanoseconds(cell, form, self._map.decimal) / 1e9
        except (ValueError, OverflowError):
            raise _Unreadable(f"{cell[:40]!r} is no time of the form {form!r}") from None
        # a time of day begins anew at midnight, and that is no clock that was set
        if form in ("clock", "hh:mm") and len(told.column) == 1:
            self._days += _DAY * (seconds < self._clock - 0.5 * _DAY)
            self._clock = seconds
        return self._days + seconds


# GrowingFile: the whole lines that are added to a file, whatever becomes of it.

_NONE = -1
"""In place of an open file."""
# Bytes read at a time, of the longest line, and of what tells whether a file is still the same.
_CHUNK, _LONGEST, _MARK = 1 << 18, 1 << 20, 256


class GrowingFile:
    """The lines that a file grows by, in turn: a file of the same name in its place is read from
    its begin, once the old one has been read to its end.

    Parameters
    ----------
    path : Path

    `cut_short` counts lines that a file ended in the midst of; `anew` how often another file, or
    another content, was begun.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = _NONE
        self._opened_before = False
        self._rest, self._at, self._mark, self._too_long = b"", 0, b"", False
        self.cut_short = self.anew = 0

    def head(self) -> Iterator[bytes]:
        """The whole lines within the first part of the file, and where reading goes on: behind the
        last line that is whole now. OSError where there is no file that can be read.
        """
        self._open()
        size = os.fstat(self._file).st_size
        content = os.pread(self._file, _LONGEST, 0)
        self._at = self._end_of_lines(size)
        self._mark = self._before(self._at)
        yield from content[: self._at].split(b"\n")[:-1]

    def _end_of_lines(self, size: int) -> int:
        """Behind the last line's end within the file; its begin where there is none near."""
        begin = max(0, size - _LONGEST)
        found = os.pread(self._file, size - begin, begin).rfind(b"\n")
        return begin + found + 1 if found >= 0 else begin

    def _open(self) -> None:
        # a pipe or a device would keep whoever opens it waiting
        file = os.open(self._path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        if not stat.S_ISREG(os.fstat(file).st_mode):
            os.close(file)
            raise OSError(f"{self._path.name}: is no file")
        self.close()
        self._file = file
        self.anew += self._opened_before
        self._opened_before = True
        self._begin()

    def close(self) -> None:
        """Let go of the file."""
        if self._file != _NONE:
            os.close(self._file)
        self._file = _NONE

    def lines(self) -> tuple[list[bytes], bool]:
        """The lines that came since, a part of them where there are many; and whether they are the
        first of a file that was begun anew.

        Raises OSError where the file has gone, or cannot be read.
        """
        begun = False
        if self._file == _NONE:
            self._open()
            begun = True
        new = self._added()
        if new is None:  # written over, or cut off: other content in the same file
            self.anew += 1
            self._begin()
            return [], True
        if not new:
            return [], begun | self._follow()
        self._at += len(new)
        self._mark = (self._mark + new)[-_MARK:]
        *whole, self._rest = (self._rest + new).split(b"\n")
        if whole and self._too_long:
            whole, self._too_long = whole[1:], False
        if len(self._rest) > _LONGEST:  # up to its end it is no line
            self.cut_short += not self._too_long
            self._rest, self._too_long = b"", True
        return whole, begun

    def _added(self) -> bytes | None:
        """What stands behind what was read; None where that does not stand there any more."""
        # read at once with what was read last: a file that was cut off and has grown past that
        # place since would else go on in the midst of other rows
        content = os.pread(self._file, len(self._mark) + _CHUNK, self._at - len(self._mark))
        if not content.startswith(self._mark):
            return None
        return content[len(self._mark) :]

    def _before(self, place: int) -> bytes:
        begin = max(0, place - _MARK)
        return os.pread(self._file, place - begin, begin)

    def _begin(self) -> None:
        # a row without its end may lack digits: never a sample
        self.cut_short += bool(self._rest)
        self._rest, self._at, self._mark, self._too_long = b"", 0, b"", False

    def _follow(self) -> bool:
        """Whether another file is in the place of this one, which was read to its end."""
        try:
            there = os.stat(self._path)
        except FileNotFoundError:
            # moved away, and the next one is not there yet: the old one may still get rows
            raise FileNotFoundError(2, "has gone, and no other is in its place") from None
        here = os.fstat(self._file)
        if (there.st_dev, there.st_ino) == (here.st_dev, here.st_ino):
            return False
        if self._added():  # the last rows came after the look before, and before the other file
            return False
        self._open()
        return True


# [s] Between two looks at a file that has not grown.
_TICK = 0.05


class GrowingFileSource(Source):
    """The stream that a column map describes, of the rows that are added to a file from now on.

    Parameters
    ----------
    path : Path
    columns : ColumnMap
    sink : callable
    """

    def __init__(self, path: Path, columns: ColumnMap, sink: Sink) -> None:
        super().__init__(f"{SCHEME}{path}", sink)
        ((name, stream),) = columns.streams.items()
        self._file, self._rows = GrowingFile(path), RowReader(columns, stream)
        self._encoding, self._step = columns.encoding, stream.sample_time
        # one row has all channels of its time: what makes a stretch anew is that row alone
        self._samples = StampedSamples(
            stream.format(name), self.health, quarantine=0.5 * stream.sample_time
        )
        self.ready = threading.Event()
        """Set once every row that is added from then on is taken."""
        self._gone = ""
        self._cut_short = self._anew = 0
        self._newest, self._now = 0.0, 0.0

    @property
    def streams(self) -> Sequence[StreamFormat]:
        """The one stream of the map."""
        return [self._samples.format]

    def _run(self) -> None:
        try:
            self._pass_over()
            self.ready.set()
            while not self._stopped.is_set():
                if not self._read():
                    self._stopped.wait(_TICK)
        finally:
            self._file.close()

    def _pass_over(self) -> None:
        """What stands there already was written while nobody listened; its header counts. A file
        that comes later is read from its begin.
        """
        try:
            for line in self._file.head():
                if self._rows.heads:
                    self._rows.passed_over()
                else:
                    self._take(line)
        except OSError as error:
            self._note(error)

    def _read(self) -> bool:
        """Take what the file grew by; whether it grew."""
        try:
            lines, begun = self._file.lines()
        except OSError as error:
            self._note(error)
            return False
        self._gone = ""
        self._count_changes()
        if begun:
            self._rows.restart()
        for line in lines:
            self._take(line)
        self._hand_on()
        return bool(lines) or begun

    def _hand_on(self) -> None:
        block = self._samples.take(self._now)
        if block is not None:
            self._deliver(block, block.n)

    def _note(self, error: OSError) -> None:
        """Count once that the file is not there; it is looked for again and again."""
        says = f"{self.name}: {error.strerror or error}"
        if says != self._gone:
            self.health.count("bus_errors", 1, says)
        self._gone = says

    def _count_changes(self) -> None:
        cut_short, anew = self._file.cut_short - self._cut_short, self._file.anew - self._anew
        if anew:
            self.health.count("reconnects", anew)
        if cut_short:
            self.health.count("undecodable", cut_short, "the file ended in the midst of a row")
        self._cut_short, self._anew = self._file.cut_short, self._file.anew

    def _take(self, line: bytes) -> None:
        try:
            row = self._rows.row(line.decode(self._encoding).rstrip("\r"))
        except UnicodeDecodeError:
            self.health.count("undecodable", 1, f"a row that is not {self._encoding}")
            return
        except (_Unreadable, csv.Error) as error:
            self.health.count("undecodable", 1, str(error))
            return
        if row is None:
            return
        if row.stamp <= self._newest:
            self._hand_on()  # what waits is given up where the clock was set back
        self.count_no_value(dict.fromkeys(row.none, 1))
        for name, cell in row.wrong.items():
            self.health.count("bad_status", 1, f"channel {name!r}: {cell!r} is no number")
        # our clock says nothing of rows that are written now and then, many at once: the clock of
        # the rows themselves goes on with them, and stands where they go back
        if self._now:
            self._now += max(self._step, row.stamp - self._newest)
        else:
            self._now = self._step
        self._newest = row.stamp
        for name, value in row.values.items():
            self._samples.add(name, row.stamp, value, self._now)


def _open(source: Address, sink: Sink) -> GrowingFileSource:
    columns = read_column_map(source.map_file)
    try:
        return GrowingFileSource(path_of(source.channel), columns, sink)
    except ValueError as error:
        raise BadBusDescription(f"{source.channel[:80]!r}: {error}") from None


def _check(source: Address) -> None:
    path_of(source.channel)


def _look(source: Address, _seconds: float) -> tuple[str, str]:
    """Whether the file is there, with the columns of the map; whether it grows, the service tells."""
    columns, path = read_column_map(source.map_file), path_of(source.channel)
    heads = header_of(path, columns)
    says = f"{path} can be read; {source.map} streams {', '.join(columns.streams)}"
    return says, "" if heads else "it has no header yet"


def header_of(path: Path, columns: ColumnMap) -> Sequence[str]:
    """The heads of the columns that a file has now; none where it has no header yet.

    Raises OSError for a file that cannot be read, BadBusDescription for a header that lacks a
    column.
    """
    file, rows = GrowingFile(path), RowReader(columns, next(iter(columns.streams.values())))
    try:
        for line in file.head():
            if rows.heads:
                break
            rows.row(line.decode(columns.encoding).rstrip("\r"))
    except (_Unreadable, UnicodeDecodeError) as error:
        raise BadBusDescription(f"{path}: {error}") from None
    finally:
        file.close()
    return rows.heads


FILE = SourceKind(
    called="growing file",
    open=_open,
    map_called="column map (file)",
    asked="File that a logger adds rows to, for example /var/log/machine.csv.",
    example="file:/var/log/machine.csv",
    texts={"columns": text_of_map("a map of a growing file's columns", read_column_map)},
    check=_check,
    look=_look,
    reached=lambda where: {"channel": where if where.startswith(SCHEME) else f"{SCHEME}{where}"},
    sent=channel_below,
    template=(
        '- {kind: file, channel: "file:/var/log/my-machine.csv", map: columns.yaml}  ',
        "rows that a logger adds",
    ),
)
