"""The mapping of a logger's file: how its text becomes a record, as a YAML file that a person can
read and mend.
"""

import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import yaml

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.even_time import (
    an_hour_ahead,
    even_columns,
    some_rounded_alike,
)
from residuum.identification.record_formats.loggers.logger_text import (
    MISSING,
    cells_of,
    decoded,
    number,
    without_footer,
)
from residuum.identification.record_formats.loggers.logger_time import (
    FORMS,
    SINCE_START,
    nanoseconds,
    over_midnight,
)
from residuum.identification.record_formats.loggers.no_value import without_overloads
from residuum.identification.record_formats.options import ReadOptions
from residuum.identification.yaml_text import read_yaml
from residuum.nearest_names import known_names

ENDING = ".mapping.yaml"
_DUPLICATES = ("refuse", "first", "mean", "spread")
_BRIDGE = ("reordered", "bridge", "where the rows came as they stand and only the clock was set")
_SORT = ("reordered", "sort", "where its rows are only shuffled")
DUPLICATES = (
    "duplicates",
    "spread",
    "(even steps until the next stamp; `first` and `mean` are others)",
)
"""The way on where rows of one stamp differ."""
_REORDERED = ("refuse", "sort", "bridge")
_AROUND = 60  # rows on both sides of a step back in which a shuffled one would have left its hole
# a time with the name of a zone behind it (`10:00 CET`)
_ZONE = re.compile(r".*\d\s*[A-Z]{3,5}", re.DOTALL)
FloatArray = npt.NDArray[np.float64]


# what may be said beside a mapping: how it is called, and its values
_TOLD = {
    "decimal": ("decimal", (".", ",")),
    "time_form": ("time", FORMS),
    "duplicates": ("duplicates", _DUPLICATES),
    "reordered": ("reordered", _REORDERED),
}


def check_told(choices: Mapping[str, str | None]) -> None:
    """Refuse a value that there is not, with those there are."""
    for name, value in choices.items():
        option, known = _TOLD[name]
        if value is not None and value not in known:
            raise BadRecord(repr(value), option, known_names(value, known, "must be one of"))


@dataclass(frozen=True)
class LoggerMapping:
    """How to read one habit of writing files; columns and rows count from 1.

    Parameters
    ----------
    encoding, delimiter, decimal : str
        Of the text.
    width : int
        Cells of a row; rows of another width are refused.
    first_row : int
        File row of the first sample.
    time : tuple of int
        The time column, or the columns of date and of time of day; none where `sample_time` says
        how far apart the rows are.
    time_form : str
        One of `logger_time.FORMS`.
    names, units : mapping of column to name and to unit
        Of the channels.
    missing : tuple of str
        Cells (in lower case) that stand for no value.
    duplicates, reordered : str
        What becomes of rows of one stamp (`refuse`, `first`, `mean`, or `spread` evenly until the
        next stamp) and of rows out of order (`refuse`, `sort`, or `bridge`: they came as they
        stand, and the clock was set between two of them).
    suffixes : mapping of column to text
        The unit that stands behind every number of a column (`20,00 °C`); a cell with another one
        is refused.
    sample_time : float or None
        Seconds from row to row of a file without times.

    Raises
    ------
    BadRecord
        A field that is not of these kinds.
    """

    encoding: str
    delimiter: str
    decimal: str
    width: int
    first_row: int
    time: tuple[int, ...]
    time_form: str
    names: Mapping[int, str]
    units: Mapping[int, str]
    missing: tuple[str, ...] = MISSING
    duplicates: str = "refuse"
    reordered: str = "refuse"
    suffixes: Mapping[int, str] = field(default_factory=dict)
    sample_time: float | None = None

    def __post_init__(self) -> None:
        rules = {
            "delimiter": isinstance(self.delimiter, str) and len(self.delimiter) == 1,
            "decimal": self.decimal in (".", ","),
            "width": _is_count(self.width),
            "first_row": _is_count(self.first_row),
            "time_form": self.time_form in FORMS,
            "duplicates": self.duplicates in _DUPLICATES,
            "reordered": self.reordered in _REORDERED,
            "sample_time": self.sample_time is None or _is_positive(self.sample_time),
            "time": self._has_possible_time(),
            "names": bool(self.names) and _are_counts(self.names) and _are_texts(self.names),
            "suffixes": _are_texts(self.suffixes) and all(self.suffixes.values()),
            "units": _are_texts(self.units) and set(self.units) <= set(self.names),
        }
        for name, holds in rules.items():
            if not holds:
                raise BadRecord(
                    f"mapping, {name}: {getattr(self, name)!r} is not possible; see the one that"
                    " inspect writes"
                )
        self._check_columns()

    def _has_possible_time(self) -> bool:
        """Whether there are one or two columns of times, or none where rows are a step apart."""
        least = 1 if self.sample_time is None else 0
        return least <= len(self.time) <= 2 and _are_counts(self.time)

    def _check_columns(self) -> None:
        """Refuse a column that rows of this width do not have."""
        if beyond := [column for column in (*self.time, *self.names) if column > self.width]:
            near = ", ".join(
                f"{column} {name!r}" for column, name in self.names.items() if column <= self.width
            )
            raise BadRecord(
                f"mapping: there is no column {beyond[0]}; rows have {self.width} cells ({near})"
            )

    def with_told(self, options: ReadOptions) -> "LoggerMapping":
        """The mapping with what is said beside it; BadRecord where that is another column of
        times.
        """
        if options.time_column is not None and options.time_column in self.names.values():
            raise BadRecord(
                f"time={options.time_column}",
                "map",
                "the mapping says another column; change its `time`",
            )
        choices = {name: getattr(options, name) for name in _TOLD}
        check_told(choices)
        missing = (*self.missing, *(cell.strip().lower() for cell in options.missing))
        return replace(
            self,
            missing=missing,
            **{name: value for name, value in choices.items() if value is not None},
        )

    def to_yaml(self) -> str:
        """The mapping as YAML."""
        plain = {**asdict(self), "time": list(self.time), "missing": list(self.missing)}
        return yaml.safe_dump(plain, allow_unicode=True, sort_keys=False)


def _is_count(value: object) -> bool:
    # `true` in YAML is a number to Python.
    return isinstance(value, int) and not isinstance(value, bool) and value >= 1


def _are_counts(values: Iterable[object]) -> bool:
    return all(map(_is_count, values))


def _are_texts(by_column: Mapping[int, object]) -> bool:
    return all(isinstance(text, str) for text in by_column.values())


def _is_positive(value: object) -> bool:
    return (
        isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < float("inf")
    )


def read_mapping(path: Path) -> LoggerMapping:
    """The mapping of a YAML file; BadRecord names the file and the field."""
    content = read_yaml(path, BadRecord)
    known = [part.name for part in fields(LoggerMapping)]
    if not isinstance(content, dict):
        raise BadRecord(f"{path}: is no table, as a mapping is; known are {', '.join(known)}")
    if unknown := [key for key in content if key not in known]:
        raise BadRecord(
            f"{path}: {unknown[0]!r} is not part of a mapping; {known_names(unknown[0], known)}"
        )
    # The first nine have no default.
    if lacking := [name for name in known[:9] if name not in content]:
        raise BadRecord(f"{path}: lacks {lacking[0]!r}; `residuum inspect` writes it")
    try:
        for name in ("time", "missing"):
            if name in content:
                content[name] = tuple(content[name])
        content["names"], content["units"] = dict(content["names"]), dict(content["units"])
        return LoggerMapping(**content)
    except (TypeError, ValueError, AttributeError) as error:
        raise BadRecord(f"{path}: {error}") from None


def table(
    text: str, mapping: LoggerMapping, source: str, notes: list[str]
) -> tuple[npt.NDArray[np.int64], FloatArray, list[int]]:
    """(times [ns] shape (n,), channels shape (c, n), file rows) as the file has them, holes as
    NaN. `notes` tell what stands below the samples.
    """
    stamps: list[int] = []
    values, rows = [], []
    body, footer = without_footer(cells_of(text, mapping.delimiter)[mapping.first_row - 1 :])
    if footer:
        notes.append(f"below the last row of values stands {footer[:60]!r}; it is no sample")
    for row, cells in enumerate(body, start=mapping.first_row):
        if not any(cells):
            continue
        if len(cells) != mapping.width:
            raise BadRecord(
                f"{source}, row {row}: {len(cells)} cells; {mapping.width} are needed, mend or cut"
                " the row"
            )
        where = f"{source}, row {row}"
        stamps.append(_stamp(cells, mapping, len(stamps), where))
        values.append(_values(cells, mapping, where))
        rows.append(row)
    if len(rows) < 2:
        raise BadRecord(f"{source}: has {len(rows)} data rows; at least 2 are needed")
    # beyond 64 bits of nanoseconds
    if max(stamps) - min(stamps) >= 2**63 or max(map(abs, stamps)) >= 2**63:
        raise BadRecord(
            f"{source}: time stamps beyond the years 1678 to 2262; check the time's form"
            f" {mapping.time_form!r}"
        )
    times = np.array(stamps, dtype=np.int64)
    # With a date in a column of its own the time of day begins anew by itself.
    if mapping.time_form == "clock" and len(mapping.time) == 1:
        times = over_midnight(times)
    return times, np.array(values).T, rows


def _stamp(cells: list[str], mapping: LoggerMapping, number_of_row: int, where: str) -> int:
    """The time [ns] of a row."""
    if not mapping.time:
        return round(1e9 * (mapping.sample_time or 0.0) * number_of_row)
    stamp = " ".join(cells[column - 1] for column in mapping.time)
    try:
        return nanoseconds(stamp, mapping.time_form, mapping.decimal)
    except (ValueError, OverflowError):
        fault = f"{stamp[:40]!r} is no time of the form {mapping.time_form!r}"
        if _ZONE.fullmatch(stamp):
            raise BadRecord(
                f"{where}: {fault}: names of time zones are not read; write the offset, as +02:00"
            ) from None
        raise BadRecord(f"{where}: {fault}; cut or mend the row") from None


def no_number(cell: str, where: str) -> BadRecord:
    """The refusal of a cell among numbers, which may mean that there is no value."""
    return BadRecord(
        f"{where}: {cell[:40]!r} is not a number",
        way_on=[("missing", [cell[:40]], "if it means no value")],
    )


def _values(cells: list[str], mapping: LoggerMapping, where: str) -> list[float]:
    return [
        _value(cells[column - 1], mapping, column, f"{where}, column {name!r}")
        for column, name in mapping.names.items()
    ]


def _value(cell: str, mapping: LoggerMapping, column: int, where: str) -> float:
    if cell.lower() in mapping.missing:
        return float("nan")
    try:
        value = number(
            cell.removesuffix(mapping.suffixes.get(column, "")).rstrip(), mapping.decimal
        )
    except ValueError:
        raise no_number(cell, where) from None
    return float("nan") if value in _marks(mapping.missing, mapping.decimal) else value


@lru_cache(maxsize=16)
def _marks(missing: tuple[str, ...], decimal: str) -> frozenset[float]:
    """The numbers among the cells that mean no value: a file may write -999.90 for -999.9."""
    marks = set()
    for cell in missing:
        # A mark may be said with a point though the file writes commas.
        for sign in (decimal, "."):
            with suppress(ValueError):
                marks.add(number(cell, sign))
    return frozenset(marks)


def read_logger_file(
    path: Path, mapping: LoggerMapping, options: ReadOptions = ReadOptions()
) -> Record:
    """Read a logger's file by its mapping.

    Rows of one stamp, rows out of order and uneven stamps are refused unless the mapping or
    `options.resample` says what to do. What was done stands in the record's notes, with the error
    that resampling makes; no hole is filled without it.

    Raises BadRecord with file and row.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadRecord(f"{path}: cannot be read: {error.strerror}") from None
    return without_overloads(parse_logger(content, str(path), mapping, options))


def parse_logger(
    content: bytes, source: str, mapping: LoggerMapping, options: ReadOptions = ReadOptions()
) -> Record:
    """Read the bytes of a logger's file (see `read_logger_file`); `source` names it in messages."""
    mapping = mapping.with_told(options)
    notes: list[str] = []
    text = decoded(content, source, mapping.encoding)[0]
    stamps, values, rows = table(text, mapping, source, notes)
    stamps, values = _ordered(stamps, values, rows, mapping, notes, source)
    # from the first stamp: seconds since 1970 as a double would be rounded to 2e-7 s
    time = (stamps - stamps[0]) / 1e9
    names = [*mapping.names.values()]
    columns = np.stack([time, *values])
    try:
        step, columns = even_columns(
            columns,
            source,
            resample=options.resample,
            first_row=mapping.first_row,
            told=notes,
            names=names,
        )
    except BadRecord as error:
        error.way_on += (_BRIDGE,) if _hours_ahead(stamps) else ()
        raise
    options.settle_sample_time(step, source)
    units = {
        name: options.unit_of(name, mapping.units.get(column, ""))
        for column, name in mapping.names.items()
    }
    channels = dict(zip(names, columns[1:], strict=True))
    return Record(
        channels, units, step, t0=float(stamps[0]) / 1e9, notes=tuple(notes), source=source
    )


def _ordered(
    stamps: npt.NDArray[np.int64],
    values: FloatArray,
    rows: list[int],
    mapping: LoggerMapping,
    notes: list[str],
    source: str,
) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Rows in order of time, one a stamp, as the mapping has them; BadRecord where it does not say
    how.
    """
    was_set = clock_steps(stamps)
    if mapping.reordered == "bridge":
        stamps = _over_settings(stamps, was_set, rows, notes)
    backward = np.diff(stamps) < 0
    if backward.any():
        # Rows that came in order while a clock was set back would be sorted into each other: such
        # files were merged, and the clock's fault became a missing term.
        if mapping.reordered != "sort" or was_set:
            row = rows[int(was_set[0] if was_set else np.argmax(backward) + 1)]
            raise _goes_back(f"{source}, row {row}", stamps, was_set, mapping)
        # Stable, so that rows of one stamp stay in the order in which they came.
        order = np.argsort(stamps, kind="stable")
        stamps, values, rows = stamps[order], values[:, order], [rows[k] for k in order]
        notes.append(f"rows sorted by time: {int(backward.sum())} steps went back")
    same = np.diff(stamps) == 0
    if not same.any():
        return stamps, values
    if mapping.duplicates == "refuse":
        row = rows[int(np.argmax(same)) + 1]
        raise BadRecord(f"{source}, row {row}: time stamp stands twice", way_on=[DUPLICATES])
    notes.append(f"{int(same.sum())} rows of a time stamp that stands twice: {mapping.duplicates}")
    starts = np.flatnonzero(np.concatenate([[True], ~same]))
    if mapping.duplicates == "spread":
        return _spread(stamps, starts, rows, source), values
    if mapping.duplicates == "first":
        return stamps[starts], values[:, starts]
    return stamps[starts], _means(values, starts)


def _over_settings(
    stamps: npt.NDArray[np.int64], was_set: list[int], rows: list[int], notes: list[str]
) -> npt.NDArray[np.int64]:
    """The stamps as if nobody had set the clock, back or an hour ahead; `notes` tell how often."""
    changed = sorted([*was_set, *_hours_ahead(stamps)])
    if not changed:
        return stamps
    notes.append(
        f"the clock was set {len(changed)} time{'s' * (len(changed) > 1)}, first at row"
        f" {rows[changed[0]]}; bridged by the usual step: what was lost in that moment cannot"
        " be seen"
    )
    return _bridged(stamps, changed)


def _goes_back(
    where: str, stamps: npt.NDArray[np.int64], was_set: list[int], mapping: LoggerMapping
) -> BadRecord:
    """The refusal of times that go back."""
    says = f"{where}: time goes back{went_back(stamps, was_set)}; cut the file there"
    # times since a start tell nothing of the time between two starts: there is no way on
    if mapping.time_form in SINCE_START:
        return BadRecord(says)
    return BadRecord(f"{says}, or", way_on=[_BRIDGE if was_set else _SORT])


def _means(values: FloatArray, starts: npt.NDArray[np.intp]) -> FloatArray:
    """Means over the rows from each start to the next of what is not missing, shape (c, starts);
    NaN where all of it is.
    """
    present = np.add.reduceat((~np.isnan(values)).astype(float), starts, axis=1)
    total = np.add.reduceat(np.nan_to_num(values), starts, axis=1)
    return np.where(present > 0, total / np.maximum(present, 1), np.nan)


def _spread(
    stamps: npt.NDArray[np.int64], starts: npt.NDArray[np.intp], rows: list[int], source: str
) -> npt.NDArray[np.int64]:
    """Rows of one stamp at even steps until the next one; the first stamp may lack its first rows,
    the last its last ones.

    Even stamps that were rounded to too few digits stand once or twice: their step is that of the
    whole.
    """
    if some_rounded_alike((stamps - stamps[0]) / 1e9):
        even: npt.NDArray[np.int64] = np.rint(
            np.linspace(stamps[0], stamps[-1], len(stamps))
        ).astype(np.int64)
        return even
    counts = np.diff(np.append(starts, len(stamps)))
    usual_count, between = int(np.median(counts)), np.diff(stamps[starts])
    inner = counts[1:-1]
    if (
        len(starts) < 3
        or (inner != usual_count).any()
        or counts[0] > usual_count
        or counts[-1] > usual_count
    ):
        wrong = 1 + int(np.argmax(inner != usual_count)) if len(inner) else 0
        raise BadRecord(
            f"{source}, row {rows[starts[wrong]]}: a stamp stands {counts[wrong]} times, others"
            f" {usual_count} times; they cannot be spread evenly, cut the file there"
        )
    step = int(np.median(between)) // usual_count
    place = np.concatenate([np.arange(count) for count in counts])
    place[: counts[0]] += usual_count - counts[0]
    evened: npt.NDArray[np.int64] = np.repeat(stamps[starts], counts) + step * place
    return evened


def clock_steps(stamps: npt.NDArray[np.int64]) -> list[int]:
    """Numbers of the rows before which the clock was set back, while rows went on coming in their
    order.

    A row out of order leaves a hole where it belongs, so that time passes as usual from well before
    to well after it, and sorting makes the steps even. A clock that was set back leaves none, and
    sorting puts rows of two times between each other.

    >>> clock_steps(np.r_[0:100, 70:170]), clock_steps(np.r_[0:50, 51, 50, 52:100])
    ([100], [])
    """
    steps = np.diff(stamps)
    back = np.flatnonzero(steps < 0) + 1
    if not len(back) or len(stamps) < 4:
        return []
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    # Only shuffled: no clock was set.
    if _sorting_mends(stamps, steps, usual):
        return []
    set_back = []
    for place in map(int, back):
        first, last = max(0, place - _AROUND), min(len(stamps) - 1, place + _AROUND)
        short = usual * (last - first) - float(stamps[last] - stamps[first])
        lacks = usual - float(steps[place - 1])
        # A clock that was set leaves the stretch around it as much too short as its own step is;
        # the hole of a row that stands elsewhere makes up for the step.
        if abs(short - lacks) < 0.5 * lacks:
            set_back.append(place)
    return set_back


def _hours_ahead(stamps: npt.NDArray[np.int64]) -> list[int]:
    """Numbers of the rows before which an hour is left out, as summer time leaves one out at its
    beginning.

    A hole of an hour looks alike: only who knows that the rows went on coming can say which it was.
    """
    steps = np.diff(stamps) / 1e9
    return (
        []
        if not len(steps)
        else [int(k) + 1 for k in np.flatnonzero(an_hour_ahead(steps, float(np.median(steps))))]
    )


def _sorting_mends(
    stamps: npt.NDArray[np.int64], steps: npt.NDArray[np.int64], usual: float
) -> bool:
    """Whether the rows in the order of their stamps are the usual step apart, each once, without a
    hole that was not there.
    """
    merged: FloatArray = np.diff(np.sort(stamps)).astype(np.float64)
    even = np.abs(merged - usual * np.maximum(np.rint(merged / max(usual, 1.0)), 1)) < 0.01 * usual
    return bool((merged > 0).all() and even.all() and merged.max() <= steps.max())


def _bridged(stamps: npt.NDArray[np.int64], was_set: list[int]) -> npt.NDArray[np.int64]:
    """The stamps as if the clock had never been set: the usual step between the rows on both
    sides.
    """
    steps = np.diff(stamps)
    steps[np.array(was_set) - 1] = int(np.median(steps[steps > 0]))
    bridged: npt.NDArray[np.int64] = stamps[0] + np.concatenate([[0], np.cumsum(steps)])
    return bridged


def went_back(stamps: npt.NDArray[np.int64], was_set: list[int]) -> str:
    """By how much a clock went back, and where that looks like the end of summer time."""
    steps = np.diff(stamps)
    back, usual = (
        int(steps[was_set[0] - 1] if was_set else steps[np.argmax(steps < 0)]),
        int(np.median(steps)),
    )
    if abs(back + 3600 * 10**9 - usual) <= max(usual, 10**9):
        return " by an hour, as at the end of summer time"
    return f" by {(usual - back) / 1e9:g} s: the clock was set" if was_set else ""
