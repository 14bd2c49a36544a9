"""What can be understood of a logger's file: its mapping, each guess with its reason, and what is
odd in its samples.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadRecord, said
from residuum.identification.record_formats.even_time import an_hour_ahead, on_grid, usual_step
from residuum.identification.record_formats.loggers.first_rows import first_rows
from residuum.identification.record_formats.loggers.logger_head import (
    is_unit,
    unit_of_head,
    unit_word,
)
from residuum.identification.record_formats.loggers.logger_mapping import (
    LoggerMapping,
    check_told,
    clock_steps,
    table,
    went_back,
)
from residuum.identification.record_formats.loggers.logger_text import (
    MISSING,
    cells_of,
    decoded,
    find_decimal,
    find_delimiter,
    is_stamp,
    is_value,
    number,
    with_unit,
    without_footer,
)
from residuum.identification.record_formats.loggers.logger_time import (
    CLOCKS,
    FORMS,
    SINCE_START,
    number_form,
    seconds_of,
    stamp_form,
)
from residuum.identification.record_formats.loggers.no_value import without_overload
from residuum.nearest_names import nearest_names

# what a column of times is called, in English, German and French, with or without words beside it
_TIME_NAME = re.compile(
    r"(?i)(.*\b|_)?"
    r"(time|timestamps?|zeit|zeitstempel|date|datum|datetime|t|elapsed|uhrzeit|epoch|heure|millis"
    r"|micros|datenum)(\b.*|_.*|)"
)
# names of a first column that is the time where it has a unit of time
_AXIS = re.compile(r"(?i)x|x[-_ ]?(axis|value|achse)|abscissa|source")
# rows, evenly spread, that tell which columns may have a unit behind every number
_LOOKED_AT = 50
# part of a column's cells that are of a kind where single ones are bad: those are refused with
# their row
_MOSTLY = 0.9
# what a column is called that names the signal of each row
_SIGNAL_NAME = re.compile(
    r"(?i)_?(var|variable|tag|signal|channel|sensor|item|point|field|measurement|metric|series"
    r"|entity|parameter|kanal|messstelle)[ _]?(name|id)?|name"
)
# what a form may be that is one of two; dates are the others
_EITHER = {"hh:mm or mm:ss": ("hh:mm", "mm:ss")}
# numbers that loggers are known to write where they have no value
_SENTINELS = (-999.0, -9999.0, -99999.0, 9999.0, 99999.0, -32768.0, 1e30)
_GAPS = 20  # that are listed, of a file that may have thousands
_DAY = 86_400 * 10**9  # [ns]


@dataclass(frozen=True)
class LoggerFile:
    """A logger's file as understood: `mapping`, `guesses` (what → value and reason), `samples`
    (rate, gaps, holes …).
    """

    mapping: LoggerMapping
    guesses: dict[str, tuple[str, str]]
    samples: dict[str, Any]


def understand(
    content: bytes,
    source: str,
    *,
    decimal: str | None = None,
    time_form: str | None = None,
    time_column: str | None = None,
    told_units: Mapping[str, str] | None = None,
    missing: Sequence[str] = (),
    sample_time: float | None = None,
    heads: Sequence[str] = (),
) -> LoggerFile:
    """Understand the bytes of a logger's file; `decimal`, `time_form` and `time_column` settle what
    the file leaves open.

    `told_units` are said by column name, of the column of times too. `missing` are cells that mean
    no value, over those that loggers write. `sample_time` [s] is from row to row of a file in which
    no column is a time. `heads` are the columns' names, with units in brackets, of a file that has
    none.

    Raises BadRecord with the row and the remedy wherever two readings are possible: a file is never
    read by a mere guess.
    """
    check_told({"decimal": decimal, "time_form": time_form})
    text, encoding, why = decoded(content, source)
    guesses = {"encoding": (encoding, why)}
    # cells that somebody says mean no value must not decide about the delimiter
    own_missing = tuple(cell.strip().lower() for cell in missing)
    delimiter, why = find_delimiter(text, source, set(own_missing))
    guesses["delimiter"] = (delimiter, why)
    # units behind numbers go first: with them no cell would be a number
    rows, suffixes = _without_units(without_footer(cells_of(text, delimiter))[0])
    first, width = _first_row(rows, source)
    guesses["first row"] = (str(first), f"from here on rows have {width} cells, values among them")
    body = rows[first - 1 :]
    sign, why = (
        (decimal, f"said with {said('decimal')}") if decimal else find_decimal(body, source, first)
    )
    guesses["decimal"] = (sign, why)
    if heads:
        names, units = _said_heads(heads, width, guesses, source)
    else:
        names, units = _heads(rows, first, width, guesses, source)
    own_units = told_units or {}
    units = [own_units.get(name, unit) for name, unit in zip(names, units, strict=True)]
    samples = _Samples(source, body, first, names, units, sign)
    # Before columns become channels: a history of a row a value was read as one channel.
    _refuse_long_form(samples)
    if sample_time is not None and time_column is None and not _has_time(samples):
        time: tuple[int, ...] = ()
        form = "seconds"
        guesses["time"] = (
            f"rows of {sample_time:g} s",
            f"said with {said('sample_time')}; no column is a time",
        )
    else:
        time, form = _time(samples, time_form, time_column, guesses)
    channels = _channels(samples, time, guesses)
    suffixes = {column: unit for column, unit in suffixes.items() if column in channels}
    for column, unit in suffixes.items():
        units[column - 1] = units[column - 1] or unit_word(unit)
        guesses[f"unit of {names[column - 1]!r}"] = (
            unit,
            "it stands behind every number of the column",
        )
    mapping = LoggerMapping(
        encoding,
        delimiter,
        sign,
        width,
        first,
        time,
        form,
        names=channels,
        units={column: units[column - 1] for column in channels},
        suffixes=suffixes,
        sample_time=None if time else sample_time,
    )
    if missing:
        mapping = replace(mapping, missing=(*mapping.missing, *own_missing))
        guesses["missing"] = (", ".join(missing), f"said with {said('missing')}")
    return _with_samples(text, mapping, guesses, source)


@dataclass(frozen=True)
class _Samples:
    """The rows of samples, and what is understood of their columns so far.

    `first_row` is the first one's number in the file; columns count from 0.
    """

    source: str
    body: list[list[str]]
    first_row: int
    names: list[str]
    units: list[str]
    decimal: str

    def cells(self, column: int) -> list[str]:
        """The cells of a column that hold something; one empty cell where none does."""
        cells = [row[column] for row in self.body if len(row) > column]
        return [cell for cell in cells if cell.lower() not in MISSING] or [""]

    def stamps(self, column: int) -> tuple[str, str] | None:
        """(form, reason) of a column of stamps, but for single cells: reading refuses those with
        their row.
        """
        cells = self.cells(column)
        stamps = [cell for cell in cells if is_stamp(cell)]
        return stamp_form(stamps) if stamps and len(stamps) >= _MOSTLY * len(cells) else None

    def is_named_time(self, column: int) -> bool:
        """Whether the column is called as times are; beside the first one with a unit of time."""
        name, has_unit = self.names[column], seconds_of(self.units[column]) is not None
        if column == 0:
            return bool(_TIME_NAME.fullmatch(name) or (_AXIS.fullmatch(name) and has_unit))
        return has_unit and bool(_TIME_NAME.fullmatch(name))

    def times(self, column: int) -> npt.NDArray[np.float64]:
        """The numbers of a column of times; [0.0] where all cells are empty."""
        times = []
        for row, cells in enumerate(self.body, start=self.first_row):
            if len(cells) <= column or cells[column].lower() in MISSING:
                continue
            try:
                times.append(number(cells[column], self.decimal))
            except ValueError:
                raise BadRecord(
                    f"{self.source}, row {row}, time column {column + 1}: {cells[column][:40]!r} is"
                    " no time; cut the row"
                ) from None
        return np.array(times or [0.0])


def _without_units(rows: list[list[str]]) -> tuple[list[list[str]], dict[int, str]]:
    """The rows without the unit that stands behind every number of a column, and that unit by
    column.
    """
    suffixes: dict[int, str] = {}
    some = rows[:: max(1, len(rows) // _LOOKED_AT)]
    may_have = {k for row in some for k, cell in enumerate(row) if with_unit(cell) is not None}
    for column in sorted(may_have):
        cells = [row[column] for row in rows if len(row) > column]
        unit = _unit_behind([cell for cell in cells if cell.lower() not in MISSING])
        if unit:
            suffixes[column + 1] = unit
    if not suffixes:
        return rows, suffixes
    return [
        [_bare(cell, suffixes.get(k, "")) for k, cell in enumerate(row, start=1)] for row in rows
    ], suffixes


def _unit_behind(cells: list[str]) -> str:
    """The unit that stands behind most numbers of a column, and behind two at least; else ""."""
    pairs = [with_unit(cell) for cell in cells]
    counts = Counter(pair[1] for pair in pairs if pair is not None)
    if counts.total() < 2 or counts.total() < _MOSTLY * len(cells):
        return ""
    return counts.most_common(1)[0][0]


def _bare(cell: str, unit: str) -> str:
    return cell.removesuffix(unit).rstrip() if unit and with_unit(cell) is not None else cell


def _first_row(rows: list[list[str]], source: str) -> tuple[int, int]:
    """(file row of the first sample, cells of a row): the first row whose columns of values hold
    nothing else.
    """
    filled_rows = [row for row in rows if any(row)]
    # The usual width is that of the samples, which are most rows.
    width = Counter(map(len, filled_rows)).most_common(1)[0][0]
    whole = [row for row in filled_rows if len(row) == width]
    # the later half: heads and settings stand above the samples
    columns = list(zip(*whole[len(whole) // 2 :], strict=True))
    numeric = [column for column, cells in enumerate(columns) if _are_values(cells)]
    for position, row in enumerate(rows, start=1):
        if len(row) != width:
            continue
        filled = [row[column] for column in numeric if row[column].lower() not in MISSING]
        if filled and all(map(is_value, filled)):
            return position, width
    raise BadRecord(f"{source}: no row of numbers found among rows of {width} cells")


def _are_values(cells: Sequence[str]) -> bool:
    filled = [cell for cell in cells if cell.lower() not in MISSING]
    return bool(filled) and sum(map(is_value, filled)) >= _MOSTLY * len(filled)


def _said_heads(
    heads: Sequence[str], width: int, guesses: dict[str, tuple[str, str]], source: str
) -> tuple[list[str], list[str]]:
    """Names and units of columns as they were said."""
    if len(heads) != width:
        raise BadRecord(f"of {len(heads)} columns", "names", f"{source} has {width}")
    named = [unit_of_head(head.strip()) for head in heads]
    guesses["header"] = (", ".join(heads), f"said with {said('names')}")
    return _distinct(
        [name or f"column {k}" for k, (name, _) in enumerate(named, start=1)], "names"
    ), [u for _, u in named]


def _heads(
    rows: list[list[str]], first: int, width: int, guesses: dict[str, tuple[str, str]], source: str
) -> tuple[list[str], list[str]]:
    above = [(k, row) for k, row in enumerate(rows[: first - 1], start=1) if _may_head(row, width)]
    if not above:
        raise _no_heads(f"{source}, row {first}", width)
    at, line = above[-1]
    # the last line may hold the units of the names above it
    unit_line = _unit_line(line, above[-2][1]) if len(above) > 1 else None
    if unit_line:
        guesses["unit line"] = (f"row {at}", "its cells are units, those above it names")
        at, line = above[-2]
    guesses["header"] = (
        f"row {at}",
        f"the last line of {width} names above the samples; {at - 1} lines before it passed over",
    )
    heads = [unit_of_head(cell) for cell in line]
    plain = [name or f"column {column}" for column, (name, _) in enumerate(heads, start=1)]
    names = _distinct(
        _told_apart(plain, [row for k, row in above if k < at]), f"{source}, row {at}"
    )
    units = zip(unit_line or [""] * width, heads, strict=True)
    return names, [_without_dash(of_line or in_head) for of_line, (_, in_head) in units]


def _without_dash(unit: str) -> str:
    """A unit; "" for the dash that some write for none."""
    return "" if unit == "-" else unit


def _no_heads(where: str, width: int) -> BadRecord:
    example = ["time [s]", *(f"name{k}" for k in range(2, width + 1))]
    return BadRecord(
        f"{where}: no line of {width} column names stands above it; write one, or",
        way_on=[("names", example)],
    )


def _may_head(row: list[str], width: int) -> bool:
    """Whether a row may hold the names of columns, or their units."""
    if len(row) != width:
        return False
    return sum(map(bool, row)) > width / 2 or _holds_units_only(row)


def _told_apart(names: list[str], above: list[list[str]]) -> list[str]:
    """Names of which some stand twice, with those of the nearest line above that tells these apart
    (`CH 1`, `CH 2`).
    """
    twice = [k for k, name in enumerate(names) if names.count(name) > 1]
    for row in reversed(above):
        own = [row[k] for k in twice]
        if twice and all(own) and len(set(own)) == len(own) and not any(map(is_value, own)):
            return [f"{row[k]} {name}" if k in twice else name for k, name in enumerate(names)]
    return names


def _distinct(names: list[str], where: str) -> list[str]:
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise BadRecord(f"{where}: column name {twice[0]!r} stands twice; rename one")
    return names


def _unit_line(line: list[str], above: list[str]) -> list[str] | None:
    """The units of a line that holds nothing else, or half units below a line without any; None for
    any other line.
    """
    bare = [_bare_unit(cell) for cell in line]
    filled = [cell for cell in bare if cell and not is_stampish(cell)]
    certain = sum(map(is_unit, filled))
    if certain == len(filled) or (2 * certain >= len(filled) and not any(map(is_unit, above))):
        return ["" if is_stampish(cell) else cell for cell in bare]
    return None


def _bare_unit(cell: str) -> str:
    return unit_word(cell.strip().strip("[]()").strip())


def _holds_units_only(line: list[str]) -> bool:
    """Whether all cells that are filled are units: few of them are enough where most columns have
    none.
    """
    filled = [_bare_unit(cell) for cell in line if cell]
    return bool(filled) and all(map(is_unit, filled))


def is_stampish(cell: str) -> bool:
    """Whether a cell of a unit line tells the form of stamps (`yyyy-mm-dd`, `hh:mm:ss`)."""
    return bool(re.fullmatch(r"(?i)[ymdhst.:/ -]{6,}", cell))


def _time(
    samples: _Samples,
    said_form: str | None,
    said_column: str | None,
    guesses: dict[str, tuple[str, str]],
) -> tuple[tuple[int, ...], str]:
    """(time columns, form); the form and the column may be said by the caller."""
    names, source = samples.names, samples.source
    forms = {column: samples.stamps(column) for column in range(len(names))}
    stamped = {column: form for column, form in forms.items() if form is not None}
    if said_column is not None:
        chosen: tuple[int, ...] = (_index(said_column, names, source),)
    elif _axis_of_time(samples, stamped, said_form):
        chosen = (0,)
        guesses["time column"] = (
            repr(names[0]),
            f"an axis that rises evenly; its form is said with {said('time')}",
        )
    else:
        chosen = _time_columns(samples, stamped)
    form, why = _form_of_time(samples, chosen, stamped, said_form)
    where = "+".join(repr(names[k]) for k in chosen)
    guesses["time"] = (f"{where}: {form}", why)
    return tuple(k + 1 for k in chosen), form


def _form_of_time(
    samples: _Samples,
    columns: tuple[int, ...],
    stamped: Mapping[int, tuple[str, str]],
    said_form: str | None,
) -> tuple[str, str]:
    """(form, reason) of the time in these columns; BadRecord where two forms are possible."""
    where = "+".join(repr(samples.names[k]) for k in columns)
    column = columns[0]
    guess: tuple[str, str] | None
    if column in stamped:
        guess = stamped[column]
    else:
        # asked for where the form is said, too: a cell that is no number is refused here
        times = samples.times(column)
        guess = number_form(samples.names[column], samples.units[column], times)
    if said_form:
        guess = (said_form, f"said with {said('time')}")
    if guess is None:
        raise BadRecord(
            f"{samples.source}: time column {where} has no unit; write it into the head, or",
            way_on=[
                ("units", {samples.names[column]: "s"}, "(ms, min …)"),
                ("time", "excel", "for dates of a spreadsheet"),
            ],
        )
    form, why = guess
    if form not in FORMS:
        possible = _EITHER.get(form, ("day first", "month first"))
        raise BadRecord(
            f"{samples.source}, time column {where}: {why}",
            way_on=[("time", either) for either in possible],
        )
    return guess


def _axis_of_time(
    samples: _Samples, stamped: Mapping[int, tuple[str, str]], form: str | None
) -> bool:
    """Whether the first column is the time because it is called as an axis (`X`), rises evenly, and
    its form is said.

    Without a unit it may count samples: nothing else makes it a time.
    """
    if stamped or samples.units[0] or form not in SINCE_START:
        return False
    if any(samples.is_named_time(column) for column in range(len(samples.names))):
        return False
    return bool(_AXIS.fullmatch(samples.names[0])) and _rises_evenly(samples, 0)


def _rises_evenly(samples: _Samples, column: int) -> bool:
    try:
        values = np.array([number(cell, samples.decimal) for cell in samples.cells(column)])
    except ValueError:
        return False
    return len(values) > 2 and bool((np.diff(values) > 0).all()) and on_grid(values) is not None


def _has_time(samples: _Samples) -> bool:
    """Whether any column holds stamps, or is called a time."""
    columns = range(len(samples.names))
    return any(samples.stamps(column) or samples.is_named_time(column) for column in columns)


def _time_columns(samples: _Samples, stamped: Mapping[int, tuple[str, str]]) -> tuple[int, ...]:
    """The one column of times, by its stamps or by its name, or the two of date and time of day."""
    names, source = samples.names, samples.source
    if [form in CLOCKS for form, _ in stamped.values()] == [False, True]:
        return tuple(stamped)
    named = [k for k in range(len(names)) if k not in stamped and samples.is_named_time(k)]
    if len(stamped) + len(named) > 1:
        both = ", ".join(repr(names[k]) for k in (*stamped, *named))
        raise BadRecord(
            f"{source}: several time columns, {both}", way_on=[("map", {"time": "COLUMN"})]
        )
    if not stamped and not named:
        raise BadRecord(
            f"{source}: no time column found among {', '.join(names)[:200]}; write 'time [s]', or",
            way_on=[
                ("map", {"time": "COLUMN"}),
                ("time", "seconds", "where the first is an axis in seconds"),
                ("sample_time", "SECONDS", "where none is a time"),
            ],
        )
    return tuple(stamped) or tuple(named)


def _index(name: str, names: list[str], source: str) -> int:
    if name not in names:
        near = nearest_names(name, names, 3, like=0.0)
        raise BadRecord(
            f"{source}: has no column {name!r} for the time; the nearest are {', '.join(near)}"
        )
    return names.index(name)


def _refuse_long_form(samples: _Samples) -> None:
    """Refuse a table that has its signals one under the other, for it would be read as one signal
    that jumps between them.
    """
    for column, name in enumerate(samples.names):
        if not _SIGNAL_NAME.fullmatch(name):
            continue
        kinds = list(dict.fromkeys(cell for cell in samples.cells(column) if not is_value(cell)))
        if len(kinds) > 1:
            shown = ", ".join(kinds[:4])
            raise BadRecord(
                f"{samples.source}: column {name!r} names the signal of each row ({len(kinds)}:"
                f" {shown}): the long form, a row a value; write one column a signal, in pandas"
                f" `pivot(columns={name!r}, …).ffill()` with the times as index"
            )


def _channels(
    samples: _Samples, time: tuple[int, ...], guesses: dict[str, tuple[str, str]]
) -> dict[int, str]:
    """Column → name of all columns that hold numbers, beside those of the time."""
    channels = {}
    for column, name in enumerate(samples.names):
        if column + 1 in time:
            continue
        cells = samples.cells(column)
        if not any(map(is_value, cells)) or samples.stamps(column):
            guesses[f"column {name!r}"] = (
                "not read",
                "empty" if cells == [""] else f"text, such as {cells[0][:30]!r}",
            )
            continue
        channels[column + 1] = name
        sentinels = {
            cell
            for cell in cells
            if is_value(cell) and _or_zero(cell, samples.decimal) in _SENTINELS
        }
        if sentinels:
            example = min(sentinels)
            guesses[f"column {name!r}"] = (
                "kept as numbers",
                f"{example} may mean no value; if so, say {said('missing', [example])}",
            )
    if not channels:
        raise BadRecord(f"{samples.source}: no column of numbers beside the time")
    return channels


def _or_zero(cell: str, decimal: str) -> float:
    try:
        return number(cell, decimal)
    except ValueError:
        return 0.0


def _with_samples(
    text: str, mapping: LoggerMapping, guesses: dict[str, tuple[str, str]], source: str
) -> LoggerFile:
    """What the samples themselves say: rate, gaps, rows out of order or of one stamp."""
    notes: list[str] = []
    stamps, values, rows = table(text, mapping, source, notes)
    days = int(stamps.max()) // _DAY
    if days and mapping.time_form == "clock" and len(mapping.time) == 1:
        guesses["midnight"] = (
            f"{days} passed",
            "the clock goes on after midnight at its usual step",
        )
    was_set = clock_steps(stamps)
    steps = np.diff(stamps)
    if was_set:
        guesses["reordered"] = (
            "refuse",
            f"the clock was set back at row {rows[was_set[0]]}{went_back(stamps, was_set)}; cut the"
            " file there, or set `reordered: bridge`: the rows came as they stand",
        )
    elif (steps < 0).any():
        mapping, why = _settle_order(mapping, stamps, rows)
        guesses["reordered"] = (mapping.reordered, why)
    order = np.argsort(stamps, kind="stable")
    same_stamp = [(i, k) for i, k in pairwise(order) if stamps[i] == stamps[k]]
    if same_stamp and not was_set:
        mapping, why = _settle_duplicates(mapping, values, rows, same_stamp)
        guesses["duplicates"] = (mapping.duplicates, why)
    if stamps.min() == stamps.max():
        cells = cells_of(text, mapping.delimiter)[rows[0] - 1]
        stamp = " ".join(cells[column - 1] for column in mapping.time)
        raise BadRecord(
            f"{source}: all rows have one time stamp, {stamp[:40]!r}; export the times with more"
            " digits, or write the seconds since the start into a column 'time [s]'"
        )
    samples = _samples_of(mapping, stamps, values, rows, notes)
    return LoggerFile(mapping, guesses, samples | {"duplicates": len(same_stamp)})


def _samples_of(
    mapping: LoggerMapping,
    stamps: npt.NDArray[np.int64],
    values: npt.NDArray[np.float64],
    rows: list[int],
    notes: list[str],
) -> dict[str, Any]:
    """Rate, gaps and signals of samples at stamps [ns], and how many of them are missing."""
    steps = np.diff(stamps)
    step, even = usual_step(np.unique(stamps - stamps.min()) / 1e9)
    names = [*mapping.names.values()]
    cleaned = [without_overload(name, column) for name, column in zip(names, values, strict=True)]
    values = np.stack([column for column, _ in cleaned])
    for _, remarks in cleaned:
        notes = [*notes, *remarks]
    gaps = np.flatnonzero(steps / 1e9 > 1.5 * step)
    return {
        "rows": len(rows),
        "sample_time": step,
        "rate": 1 / step,
        "even": even,
        "gaps": [_gap(rows[k], float(steps[k]) / 1e9, step) for k in gaps[:_GAPS]],
        "gap_count": len(gaps),
        "reordered": int((steps < 0).sum()),
        "signals": dict(zip(names, values, strict=True)),
        "notes": notes,
        "first_rows": first_rows(stamps / 1e9, values),
        "missing": {
            name: int(np.isnan(column).sum()) for name, column in zip(names, values, strict=True)
        },
    }


def _settle_order(
    mapping: LoggerMapping, stamps: npt.NDArray[np.int64], rows: list[int]
) -> tuple[LoggerMapping, str]:
    """The mapping for rows out of order, and why: sorted only where nothing else explains them."""
    steps = np.diff(stamps)
    # times since a start begin anew with each; a far step back may be a clock that was set
    is_far = int(-steps.min()) > 60 * int(np.median(np.abs(steps)))
    is_safe = mapping.time_form not in SINCE_START and not is_far
    why = (
        "each row has its own date"
        if is_safe
        else "a restart, midnight or a change of the clock looks the same"
    )
    row = rows[int(np.argmax(steps < 0)) + 1]
    reordered = "sort" if is_safe else "refuse"
    return replace(mapping, reordered=reordered), f"row {row} goes back; {why}"


def _settle_duplicates(
    mapping: LoggerMapping,
    values: npt.NDArray[np.float64],
    rows: list[int],
    same_stamp: list[tuple[int, int]],
) -> tuple[LoggerMapping, str]:
    """The mapping for pairs of rows of one stamp, and why: one is left out where both say the
    same.
    """
    equal = all(np.array_equal(values[:, i], values[:, k], equal_nan=True) for i, k in same_stamp)
    ways = "set `duplicates` to `spread` (even steps until the next stamp), `first` or `mean`"
    why = "the rows are equal" if equal else f"the rows differ: {ways}"
    first = rows[same_stamp[0][1]]
    return (
        replace(mapping, duplicates="first" if equal else "refuse"),
        f"{len(same_stamp)} rows repeat a stamp, first row {first}; {why}",
    )


def _gap(after_row: int, seconds: float, step: float) -> dict[str, Any]:
    return {"after_row": after_row, "seconds": seconds} | _looks_like(seconds, step)


def _looks_like(gap: float, step: float) -> dict[str, str]:
    """What a gap may be beside a hole."""
    if an_hour_ahead(gap, step):
        return {"looks_like": "a hole, or the beginning of summer time"}
    return {"looks_like": "a hole, or a clock that was set forward"}
