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

_TIME_NAME = re.compile(
    r"(?i)(.*\b|_)?(time|timestamps?|zeit|zeitstempel|date|datum|datetime|t|elapsed|uhrzeit|epoch|heure|millis|micros|datenum)(\b.*|_.*|)"
)
# names of a first column that is the time where it has a unit of time
_AXIS = re.compile(r"(?i)x|x[-_ ]?(axis|value|achse)|abscissa|source")
# rows, evenly spread, that tell which columns may have a unit behind every number
_LOOKED_AT = 50
# part of a column's cells that are of a kind where single ones are bad: those are refused with
# their row
_MOSTLY = 0.9
_SIGNAL_NAME = re.compile(
    r"(?i)_?(var|variable|tag|signal|channel|sensor|item|point|field|measurement|metric|series|entity|parameter|kanal|messstelle)"
    r"[ _]?(name|id)?|name"
)
# what a form may be that is one of two; dates are the others
_EITHER = {"hh:mm or mm:ss": ("hh:mm", "mm:ss")}
_SENTINELS = (-999.0, -9999.0, -99999.0, 9999.0, 99999.0, -32768.0, 1e30)


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
    delimiter, why = find_delimiter(text, source, {cell.strip().lower() for cell in missing})
    guesses["delimiter"] = (delimiter, why)
    rows, suffixes = _without_units(without_footer(cells_of(text, delimiter))[0])
    first, width = _first_row(rows, source)
    guesses["first row"] = (str(first), f"from here on rows have {width} cells, values among them")
    body = rows[first - 1 :]
    sign, why = (
        (decimal, f"said with {said('decimal')}")
        if decimal
        else find_decimal(rows[first - 1 :], source, first)
    )
    guesses["decimal"] = (sign, why)
    if heads:
        names, own = _said_heads(heads, width, guesses, source)
    else:
        names, own = _heads(rows, first, width, guesses, source)
    units = [(told_units or {}).get(name, unit) for name, unit in zip(names, own, strict=True)]
    _refuse_long_form(body, names, source)
    time: tuple[int, ...] = ()
    form = "seconds"
    if sample_time is not None and time_column is None and not _has_time(body, names, units):
        guesses["time"] = (
            f"rows of {sample_time:g} s",
            f"said with {said('sample_time')}; no column is a time",
        )
    else:
        time, form = _time(body, names, units, sign, (time_form, time_column), guesses, source)
    channels = _channels(body, names, time, sign, guesses, source)
    suffixes = {column: unit for column, unit in suffixes.items() if column in channels}
    for column, unit in suffixes.items():
        units[column - 1] = units[column - 1] or unit_word(unit)
        guesses[f"unit of {names[column - 1]!r}"] = (
            unit,
            "it stands behind every number of the column",
        )
    of_channels = {column: units[column - 1] for column in channels}
    apart = None if time else sample_time
    mapping = LoggerMapping(
        encoding,
        delimiter,
        sign,
        width,
        first,
        time,
        form,
        channels,
        of_channels,
        sample_time=apart,
    )
    mapping = replace(mapping, suffixes=suffixes)
    if missing:
        mapping = replace(
            mapping, missing=(*mapping.missing, *(cell.strip().lower() for cell in missing))
        )
        guesses["missing"] = (", ".join(missing), f"said with {said('missing')}")
    return _with_samples(text, mapping, guesses, source)


def _without_units(rows: list[list[str]]) -> tuple[list[list[str]], dict[int, str]]:
    """The rows without the unit that stands behind every number of a column, and that unit by
    column.
    """
    suffixes: dict[int, str] = {}
    some = rows[:: max(1, len(rows) // _LOOKED_AT)]
    for column in sorted(
        {k for row in some for k, cell in enumerate(row) if with_unit(cell) is not None}
    ):
        cells = [
            row[column] for row in rows if len(row) > column and row[column].lower() not in MISSING
        ]
        counts = Counter(pair[1] for cell in cells if (pair := with_unit(cell)) is not None)
        if counts and counts.total() >= _MOSTLY * len(cells) and counts.total() > 1:
            suffixes[column + 1] = counts.most_common(1)[0][0]
    if not suffixes:
        return rows, suffixes
    return [
        [_bare(cell, suffixes.get(k, "")) for k, cell in enumerate(row, start=1)] for row in rows
    ], suffixes


def _bare(cell: str, unit: str) -> str:
    return cell.removesuffix(unit).rstrip() if unit and with_unit(cell) is not None else cell


def _first_row(rows: list[list[str]], source: str) -> tuple[int, int]:
    """(file row of the first sample, cells of a row): the first row whose columns of values hold
    nothing else.
    """
    width = Counter(len(row) for row in rows if any(row)).most_common(1)[0][0]
    whole = [row for row in rows if len(row) == width and any(row)]
    late = whole[len(whole) // 2 :]
    numeric = [column for column in range(width) if _are_values([row[column] for row in late])]
    for position, row in enumerate(rows, start=1):
        if len(row) != width:
            continue
        filled = [row[column] for column in numeric if row[column].lower() not in MISSING]
        if filled and all(map(is_value, filled)):
            return position, width
    raise BadRecord(f"{source}: no row of numbers found among rows of {width} cells")


def _are_values(cells: list[str]) -> bool:
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
    above = [
        (k, row)
        for k, row in enumerate(rows[: first - 1], start=1)
        if len(row) == width and (sum(map(bool, row)) > width / 2 or _holds_units_only(row))
    ]
    if not above:
        like = ["time [s]", *(f"name{k}" for k in range(2, width + 1))]
        raise BadRecord(
            f"{source}, row {first}: no line of {width} column names stands above it; write"
            " one, or",
            way_on=[("names", like)],
        )
    at, line = above[-1]
    units = [""] * width
    if len(above) > 1 and (own_line := _unit_line(line, above[-2][1])):
        units = own_line
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
    units = [own or unit for own, (_, unit) in zip(units, heads, strict=True)]
    return names, ["" if unit == "-" else unit for unit in units]


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
    body: list[list[str]],
    names: list[str],
    units: list[str],
    decimal: str,
    given: tuple[str | None, str | None],
    guesses: dict[str, tuple[str, str]],
    source: str,
) -> tuple[tuple[int, ...], str]:
    """(time columns, form); `given` is the form and the column that the caller says."""
    given_form, column = given
    stamped = {
        column: form for column in range(len(names)) if (form := _stamps(_column(body, column)))
    }
    if column is not None:
        chosen: tuple[int, ...] = (_index(column, names, source),)
    elif _axis_of_time(body, names, units, stamped, decimal, given_form):
        chosen = (0,)
        guesses["time column"] = (
            repr(names[0]),
            f"an axis that rises evenly; its form is said with {said('time')}",
        )
    else:
        chosen = _time_columns(names, units, stamped, source)
    where = "+".join(repr(names[k]) for k in chosen)
    guess = (
        stamped[chosen[0]]
        if chosen[0] in stamped
        else number_form(
            names[chosen[0]],
            units[chosen[0]],
            _numbers(body, chosen[0], decimal, f"{source}, row", int(guesses["first row"][0])),
        )
    )
    if given_form:
        guess = (given_form, f"said with {said('time')}")
    if guess is None:
        raise BadRecord(
            f"{source}: time column {where} has no unit; write it into the head, or",
            way_on=[
                ("units", {names[chosen[0]]: "s"}, "(ms, min …)"),
                ("time", "excel", "for dates of a spreadsheet"),
            ],
        )
    if guess[0] not in FORMS:
        forms = _EITHER.get(guess[0], ("day first", "month first"))
        raise BadRecord(
            f"{source}, time column {where}: {guess[1]}", way_on=[("time", form) for form in forms]
        )
    guesses["time"] = (f"{where}: {guess[0]}", guess[1])
    return tuple(k + 1 for k in chosen), guess[0]


def _axis_of_time(
    body: list[list[str]],
    names: list[str],
    units: list[str],
    stamped: dict[int, tuple[str, str]],
    decimal: str,
    form: str | None,
) -> bool:
    """Whether the first column is the time because it is called as an axis (`X`), rises evenly, and
    its form is said.

    Without a unit it may count samples: nothing else makes it a time.
    """
    if (
        stamped
        or units[0]
        or form not in SINCE_START
        or any(_is_named_time(k, name, units) for k, name in enumerate(names))
    ):
        return False
    return bool(_AXIS.fullmatch(names[0])) and _rises_evenly(body, 0, decimal)


def _rises_evenly(body: list[list[str]], column: int, decimal: str) -> bool:
    try:
        values = np.array([number(cell, decimal) for cell in _column(body, column)])
    except ValueError:
        return False
    return len(values) > 2 and bool((np.diff(values) > 0).all()) and on_grid(values) is not None


def _is_named_time(k: int, name: str, units: list[str]) -> bool:
    if not (
        _TIME_NAME.fullmatch(name)
        or (k == 0 and _AXIS.fullmatch(name) and seconds_of(units[k]) is not None)
    ):
        return False
    return k == 0 or seconds_of(units[k]) is not None


def _has_time(body: list[list[str]], names: list[str], units: list[str]) -> bool:
    """Whether any column holds stamps, or is called a time."""
    return any(
        _stamps(_column(body, k)) or _is_named_time(k, name, units) for k, name in enumerate(names)
    )


def _time_columns(
    names: list[str], units: list[str], stamped: dict[int, tuple[str, str]], source: str
) -> tuple[int, ...]:
    """The one column of times, by its stamps or by its name, or the two of date and time of day."""
    if [form in CLOCKS for form, _ in stamped.values()] == [False, True]:
        return tuple(stamped)
    named = [
        k for k, name in enumerate(names) if k not in stamped and _is_named_time(k, name, units)
    ]
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


def _refuse_long_form(body: list[list[str]], names: list[str], source: str) -> None:
    """Refuse a table that has its signals one under the other, for it would be read as one signal
    that jumps between them.
    """
    for column, name in enumerate(names):
        if not _SIGNAL_NAME.fullmatch(name):
            continue
        kinds = list(dict.fromkeys(cell for cell in _column(body, column) if not is_value(cell)))
        if len(kinds) > 1:
            shown = ", ".join(kinds[:4])
            raise BadRecord(
                f"{source}: column {name!r} names the signal of each row ({len(kinds)}: {shown}):"
                " the long form, a row a value; write one column a signal, in pandas"
                f" `pivot(columns={name!r}, …).ffill()` with the times as index"
            )


def _stamps(cells: list[str]) -> tuple[str, str] | None:
    """The form of a column that holds stamps, but for single cells: reading refuses those with
    their row.
    """
    stamps = [cell for cell in cells if is_stamp(cell)]
    return stamp_form(stamps) if stamps and len(stamps) >= _MOSTLY * len(cells) else None


def _column(body: list[list[str]], column: int) -> list[str]:
    cells = [row[column] for row in body if len(row) > column]
    return [cell for cell in cells if cell.lower() not in MISSING] or [""]


def _numbers(
    body: list[list[str]], column: int, decimal: str, where: str, first: int
) -> np.ndarray[Any, np.dtype[np.float64]]:
    numbers = []
    for row, cells in enumerate(body, start=first):
        if len(cells) <= column or cells[column].lower() in MISSING:
            continue
        try:
            numbers.append(number(cells[column], decimal))
        except ValueError:
            raise BadRecord(
                f"{where} {row}, time column {column + 1}: {cells[column][:40]!r} is no time; cut"
                " the row"
            ) from None
    return np.array(numbers or [0.0])


def _channels(
    body: list[list[str]],
    names: list[str],
    time: tuple[int, ...],
    decimal: str,
    guesses: dict[str, tuple[str, str]],
    source: str,
) -> dict[int, str]:
    channels = {}
    for column, name in enumerate(names):
        if column + 1 in time:
            continue
        cells = _column(body, column)
        numbers = sum(map(is_value, cells))
        if numbers == 0 or _stamps(cells):
            guesses[f"column {name!r}"] = (
                "not read",
                "empty" if cells == [""] else f"text, such as {cells[0][:30]!r}",
            )
            continue
        channels[column + 1] = name
        if sentinels := sorted(
            {cell for cell in cells if is_value(cell) and _or_zero(cell, decimal) in _SENTINELS}
        ):
            guesses[f"column {name!r}"] = (
                "kept as numbers",
                f"{sentinels[0]} may mean no value; if so, say {said('missing', sentinels[:1])}",
            )
    if not channels:
        raise BadRecord(f"{source}: no column of numbers beside the time")
    return channels


def _or_zero(cell: str, decimal: str) -> float:
    try:
        return number(cell, decimal)
    except ValueError:
        return 0.0


def _with_samples(
    text: str, mapping: LoggerMapping, guesses: dict[str, tuple[str, str]], source: str
) -> LoggerFile:
    notes: list[str] = []
    stamps, values, rows = table(text, mapping, source, notes)
    steps = np.diff(stamps)
    back = steps < 0
    if (
        (days := int(stamps.max()) // (86_400 * 10**9))
        and mapping.time_form == "clock"
        and len(mapping.time) == 1
    ):
        guesses["midnight"] = (
            f"{days} passed",
            "the clock goes on after midnight at its usual step",
        )
    order = np.argsort(stamps, kind="stable")
    was_set = clock_steps(stamps)
    if was_set:
        row = rows[was_set[0]]
        guesses["reordered"] = (
            "refuse",
            (
                f"the clock was set back at row {row}{went_back(stamps, was_set)}; cut the file"
                " there, or set `reordered: bridge`: the rows came as they stand"
            ),
        )
    elif back.any():
        far = int(-steps.min()) > 60 * int(np.median(np.abs(steps)))
        safe = mapping.time_form not in SINCE_START and not far
        mapping = replace(mapping, reordered="sort" if safe else "refuse")
        why = (
            "each row has its own date"
            if safe
            else "a restart, midnight or a change of the clock looks the same"
        )
        guesses["reordered"] = (
            mapping.reordered,
            f"row {rows[int(np.argmax(back)) + 1]} goes back; {why}",
        )
    pairs = [(i, k) for i, k in pairwise(order) if stamps[i] == stamps[k]]
    if pairs and not was_set:
        equal = all(np.array_equal(values[:, i], values[:, k], equal_nan=True) for i, k in pairs)
        mapping = replace(mapping, duplicates="first" if equal else "refuse")
        ways = "set `duplicates` to `spread` (even steps until the next stamp), `first` or `mean`"
        why = "the rows are equal" if equal else f"the rows differ: {ways}"
        guesses["duplicates"] = (
            mapping.duplicates,
            f"{len(pairs)} rows repeat a stamp, first row {rows[pairs[0][1]]}; {why}",
        )
    forward: npt.NDArray[np.float64] = np.diff(np.unique(stamps)).astype(np.float64) / 1e9
    if not len(forward):
        stamp = " ".join(
            cells_of(text, mapping.delimiter)[rows[0] - 1][column - 1] for column in mapping.time
        )
        raise BadRecord(
            f"{source}: all rows have one time stamp, {stamp[:40]!r}; export the times with more"
            " digits, or write the seconds since the start into a column 'time [s]'"
        )
    step, even = usual_step(np.unique(stamps - stamps.min()) / 1e9)
    cleaned = [
        without_overload(name, column)
        for name, column in zip(mapping.names.values(), values, strict=True)
    ]
    values = np.stack([column for column, _ in cleaned])
    gaps = np.flatnonzero(steps / 1e9 > 1.5 * step)
    samples = {
        "rows": len(rows),
        "sample_time": step,
        "rate": 1 / step,
        "even": even,
        "gaps": [
            {"after_row": rows[k], "seconds": float(steps[k]) / 1e9}
            | _looks_like(float(steps[k]) / 1e9, step)
            for k in gaps[:20]
        ],
        "gap_count": len(gaps),
        "reordered": int(back.sum()),
        "duplicates": len(pairs),
        "signals": dict(zip(mapping.names.values(), values, strict=True)),
        "notes": notes + [note for _, of_column in cleaned for note in of_column],
        "first_rows": first_rows(stamps / 1e9, values),
        "missing": {
            name: int(np.isnan(column).sum())
            for name, column in zip(mapping.names.values(), values, strict=True)
        },
    }
    return LoggerFile(mapping, guesses, samples)


def _looks_like(gap: float, step: float) -> dict[str, str]:
    """What a gap may be beside a hole."""
    if an_hour_ahead(gap, step):
        return {"looks_like": "a hole, or the beginning of summer time"}
    return {"looks_like": "a hole, or a clock that was set forward"}
