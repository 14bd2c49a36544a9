"""Records from files, arrays, pandas and xarray."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record as MeasuredRecord
from residuum.identification.record_formats import ReadOptions
from residuum.identification.record_formats.even_time import even_columns
from residuum.identification.record_formats.loggers.logger_head import (
    is_unit,
    unit_of_head,
    unit_word,
)
from residuum.identification.record_formats.loggers.logger_time import seconds_of
from residuum.identification.record_formats.read_apart import read_mapped
from residuum.library.record import Record, shown
from residuum.nearest_names import known_names

# The columns of a DataFrame as channels: names, units and numbers, each refused with what a
# DataFrame has for it.

if TYPE_CHECKING:
    import pandas


def as_frame(table: Any, where: str) -> pandas.DataFrame:
    """The DataFrame of a DataFrame, or of a Series with a name; BadRecord for anything else and for
    columns of one name.
    """
    # By what it can do, not by its type: pandas is not imported to tell.
    if hasattr(table, "to_frame") and not hasattr(table, "columns"):
        if table.name is None:
            raise BadRecord(
                f"{where}: is a Series without a name; give it one: series.rename('speed')"
            )
        table = table.to_frame()
    if not hasattr(table, "columns"):
        raise BadRecord(
            f"{where}: is {type(table).__name__}; must be a DataFrame, or make a record with"
            " rs.from_arrays({…})"
        )
    twice = table.columns[table.columns.duplicated()]
    if len(twice):
        raise BadRecord(
            f"{where}: column {twice[0]!r} stands twice; rename one, or keep the first:"
            " frame.loc[:, ~frame.columns.duplicated()]"
        )
    return table


def heads(
    frame: pandas.DataFrame, where: str, *, without: Any = None
) -> dict[Any, tuple[str, str]]:
    """Column → (name, unit) of every column but the one of time; several rows of heads are joined,
    a row of units is one.
    """
    columns = [column for column in frame.columns if without is None or column != without]
    if getattr(frame.columns, "nlevels", 1) > 1:
        by_column = _of_levels(columns)
    else:
        by_column = {column: unit_of_head(str(column)) for column in columns}
    names = [name for name, _ in by_column.values()]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise BadRecord(f"{where}: columns share the name {twice[0]!r}; rename one")
    return by_column


def _of_levels(columns: list[Any]) -> dict[Any, tuple[str, str]]:
    rows = {column: [str(part).strip() for part in column] for column in columns}
    last_row = [parts[-1].strip("[]()") for parts in rows.values()]
    units = _named(last_row)
    # The last row is one of units where all of it are: one word that is none makes it names.
    if units and all(is_unit(unit_word(unit)) for unit in units):
        return {
            column: (".".join(_named(parts[:-1])), unit_word(unit) if unit in units else "")
            for (column, parts), unit in zip(rows.items(), last_row, strict=True)
        }
    return {column: unit_of_head(".".join(_named(parts))) for column, parts in rows.items()}


def _named(parts: list[str]) -> list[str]:
    """The heads that there are: pandas calls an empty one `Unnamed: …`."""
    return [part for part in parts if part and not part.startswith("Unnamed")]


def units_of(
    by_column: Mapping[Any, tuple[str, str]],
    attributes: Mapping[Any, str],
    given: Mapping[Any, str],
) -> dict[str, str]:
    """Name → unit: what the caller tells goes over what the frame's attributes say, and that over
    the heads.
    """
    units = dict(by_column.values())
    for source in (attributes, given):
        for key, unit in source.items():
            name = by_column[key][0] if key in by_column else key
            if name in units:
                units[name] = unit
            # A frame's attributes may outlive a column that was dropped; what the caller says has
            # to fit.
            elif source is given:
                raise BadRecord(
                    f"units: there is no channel {key!r}; {known_names(key, units, 'there are')}"
                )
    return units


def numbers(values: Any, where: str) -> npt.NDArray[np.float64]:
    """The numbers of a column, NaN where it has none; BadRecord for instants, complex numbers and
    text.
    """
    kind = getattr(getattr(values, "dtype", None), "kind", "")
    # `and kind`: the empty kind of a list is within every text.
    if kind in "mM" and kind:
        raise BadRecord(
            f"{where}: holds instants, not numbers; take the time from it with time=…, or leave it"
            " out with frame.drop(…)"
        )
    # NumPy would keep the real part alone, with no more than a warning.
    if kind == "c":
        raise BadRecord(
            f"{where}: holds complex numbers; keep one part of them, or leave it out with"
            " frame.drop(…)"
        )
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise BadRecord(
            f"{where}: does not hold numbers; make numbers of it, or leave it out with"
            " frame.drop(columns=…)"
        ) from None


# The time of a table (a DataFrame, a Dataset): instants, durations, seconds; never a count of its
# rows.

# Above this a number is no second of our days, since 1970 or since a start.
# Milliseconds since 1970 lie above it from March 1973 on, seconds not before the year 5138.
_EPOCH = 1e11


def seconds(
    values: Any, where: str, *, unit: str = "", is_time: bool = False, near: str = "COLUMN"
) -> npt.NDArray[np.float64]:
    """Instants or durations as seconds, shape (n,); instants count from the first one.

    `unit` is the unit of plain numbers (seconds where nothing is said). Whole numbers without one
    count the rows as likely as they count seconds; they are taken where the caller has said that
    they are the time (`is_time`). `near` is a column that may be it.

    Raises BadRecord with what to do for anything that is no time.
    """
    array = _array_of_times(values, where)
    if array.dtype.kind in "mM":
        # From the first one on, as whole nanoseconds: seconds since 1970 as a double would be
        # rounded to some 0.2 µs.
        return np.asarray((array - array[0]) / np.timedelta64(1, "ns") * 1e-9, dtype=float)
    return _seconds_of_numbers(array, where, unit, is_time=is_time, near=near)


def _array_of_times(values: Any, where: str) -> npt.NDArray[Any]:
    if getattr(values, "nlevels", 1) > 1:
        raise BadRecord(
            f"{where}: the index has {values.nlevels} levels; take one series, frame.xs(…) or"
            " frame.droplevel(…)"
        )
    if str(getattr(values, "dtype", "")).startswith("period"):
        values = getattr(values, "dt", values).to_timestamp()
    return _without_zone(values)


def _seconds_of_numbers(
    array: npt.NDArray[Any], where: str, unit: str, *, is_time: bool, near: str
) -> npt.NDArray[np.float64]:
    if array.dtype.kind not in "iuf":
        raise BadRecord(
            f"{where}: the time does not hold numbers or instants ({str(array[0])[:30]!r}); make"
            " instants of it with pandas.to_datetime(…), or say sample_time=…"
        )
    factor = seconds_of(unit) if unit else 1.0
    if factor is None:
        raise BadRecord(f"{where}: the time is in {unit!r}, which is no unit of time")
    # Taken for seconds, the rows of a DataFrame as it is read from a file were one sample a second,
    # whatever its column of times said.
    if array.dtype.kind in "iu" and not unit and not is_time:
        raise BadRecord(
            f"{where}: the index counts ({array[0]}, {array[min(1, len(array) - 1)]}, …), which may"
            f" be rows and is not taken for seconds; say time={near!r}, sample_time=…, or make"
            " instants of it: pandas.to_datetime(frame.index, unit=…)"
        )
    # Milliseconds since 1970 read as seconds would lie in the year 50 000, and pass for a time.
    if not unit and np.nanmax(np.abs(array), initial=0.0) > _EPOCH:
        how = "make instants of it with pandas.to_datetime(…, unit='ms')"
        raise BadRecord(f"{where}: the time {array[0]:.0f} is too large for seconds; {how}")
    return np.asarray(array, dtype=float) * factor


def unit_of_time(head: Any) -> str:
    """The unit of time in the head of a column or in the name of an index (`t [ms]`), or
    nothing.
    """
    unit = unit_of_head(str(head or ""))[1]
    return "" if seconds_of(unit) is None else unit


def refuse_disorder(instants: npt.NDArray[np.float64], where: str) -> None:
    """BadRecord for instants that stand twice or go back, with what a table has for it."""
    steps = np.diff(instants)
    wrong = steps <= 0
    if not wrong.any():
        return
    row = int(np.argmax(wrong)) + 1
    if steps[row - 1] == 0:
        how = (
            "an instant stands twice: frame.groupby(level=0).mean() or"
            " frame[~frame.index.duplicated()] keeps one"
        )
    else:
        how = "rows must be in order of time: frame.sort_index() orders them"
    raise BadRecord(f"{where}, row {row}: time does not increase; {how}")


def _without_zone(values: Any) -> npt.NDArray[Any]:
    """The array of values; instants with a zone become those of UTC, in which no hour stands
    twice.
    """
    # A Series has its zone under `.dt`, an index has it itself.
    accessor = getattr(values, "dt", values)
    if getattr(accessor, "tz", None) is not None:
        return np.asarray(accessor.tz_convert(None))
    array = np.asarray(values)
    if (
        array.dtype.kind == "O"
        and len(array)
        and all(hasattr(t, "isoformat") and hasattr(t, "hour") for t in array)
    ):
        return _of_datetimes(array)
    # Objects may be numbers (Decimal, None), which a column of mixed types holds.
    return _plain(array) if array.dtype.kind == "O" else array


def _plain(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Numbers that came as objects, or the objects as they are."""
    if any(isinstance(entry, str) for entry in array):
        return array
    try:
        return np.asarray(array, dtype=float)
    except (TypeError, ValueError):
        return array


def _of_datetimes(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.array(
        [t.astimezone(UTC).replace(tzinfo=None) if t.tzinfo else t for t in array],
        dtype="datetime64[ns]",
    )


if TYPE_CHECKING:
    import pandas
    import xarray

# English and German names of a column of times. They serve a refusal's advice alone: no column is
# taken for the time by its name.
_TIMES = ("time", "t", "timestamp", "zeit", "date", "datetime")


def read(
    path: str | PathLike[str],
    *,
    units: Mapping[str, str] | None = None,
    sample_time: float | None = None,
    resample: bool = False,
    rename: Mapping[str, str] | None = None,
    map: Mapping[str, str] | None = None,
    mapping: str | PathLike[str] | None = None,
    decimal: str | None = None,
    time: str | None = None,
    missing: Sequence[str | float] = (),
    names: Sequence[str] = (),
    duplicates: str | None = None,
    reordered: str | None = None,
) -> Record:
    """Read a record file; its ending says the format (CSV, NPZ, MAT, WAV; Parquet, TDMS, MDF 4, UFF
    58 with the extra `formats`), or rows of a plant's history.

    A history is a table of PostgreSQL or TimescaleDB (extra `postgres`), named by its address:
    `timescale://user@host/database/table?tags=speed,torque&start=2026-03-01&end=2026-03-08`. Where
    columns have no usual names, `time`, `tag` and `value` say them; any other key chooses rows by
    what a column holds. `influx://host/database/measurement?tags=…` is one of InfluxDB, and
    `opc.tcp://host:4840?nodes=ns=2;s=Speed&start=…&end=…` the nodes of an OPC UA server that keeps
    their history (extra `opcua`).

    A logger's text file is read by its mapping, which `residuum inspect --out` writes, or by what
    is understood of it.

    Parameters
    ----------
    path : str or path
        A file, or the address of a table.
    units : mapping of channel to unit
        For files that do not say them.
    sample_time : float
        Seconds between samples, for files that do not say it.
    resample : bool
        Accept uneven time stamps: samples are interpolated onto even instants.
    rename : mapping of column to name
    map : mapping of name to column
        The same the other way round, as `--map` says it; `time` names the column of times.
    mapping : path
        Of a logger's file: how it is read. Default: FILE.mapping.yaml beside it.
    decimal, time : str
        Of a logger's file, where its text leaves them open: the decimal sign, the form of its times
        (`day first`, `excel` …).
    missing : sequence of str or float
        Cells that mean no value, such as `OL` or -999.9.
    names : sequence of str
        Of a logger's file without heads: those of all its columns, units in brackets.
    duplicates, reordered : str
        Of a logger's file: what becomes of rows of one stamp (`first`, `mean`, `spread` evenly) and
        of rows out of order (`sort`, or `bridge` where only the clock was set).

    Returns
    -------
    Record

    Raises
    ------
    BadRecord
        No such file, not a record format, uneven time; the message names row and column.
    BadUnit
        A unit that is not known.

    Examples
    --------
    >>> import residuum as rs, tempfile, pathlib
    >>> file = pathlib.Path(tempfile.mkdtemp()) / "drive.csv"
    >>> _ = file.write_text("time [s],voltage [V]\\n0,0\\n0.1,1\\n0.2,1\\n")
    >>> rs.read(file)["voltage"].tolist()
    [0.0, 1.0, 1.0]
    """
    if not isinstance(path, str | PathLike):
        raise _no_record(path)
    columns = dict(map or {})
    options = ReadOptions(
        resample=resample,
        sample_time=sample_time,
        # Told by the names that the caller will see; the reader knows the file's columns.
        units={columns.get(name, name): unit for name, unit in (units or {}).items()},
        decimal=decimal,
        time_form=time,
        # Taken out of what is renamed after reading: the time is no channel.
        time_column=columns.pop("time", None),
        # A text alone is one cell, not its letters.
        missing=[
            str(cell) for cell in ([missing] if isinstance(missing, str | float) else missing)
        ],
        names=list(names),
        duplicates=duplicates,
        reordered=reordered,
    )
    record = read_mapped(Path(path), options, None if mapping is None else Path(mapping))
    return shown(
        record.rename({column: name for name, column in columns.items()} | dict(rename or {}))
    )


def from_arrays(
    channels: Mapping[str, npt.ArrayLike],
    *,
    units: Mapping[str, str] | None = None,
    sample_time: float | None = None,
    time: npt.ArrayLike | None = None,
    resample: bool = False,
    t0: float | None = None,
    source: str = "",
) -> Record:
    """A record of arrays that were sampled together, at even steps or at the times that are given.

    Parameters
    ----------
    channels : mapping of name to array, shape (n,)
        NaN = missing.
    units : mapping of name to unit
        A channel that is not named here has none: a model that asks for one refuses it.
    sample_time, t0 : float or None
        Seconds between samples; time of the first one [s], 0 if nothing is said. With `time` they
        are told by it.
    time : array, shape (n,), or None
        When the samples were taken: seconds, instants or durations (`datetime64`, `timedelta64`).
    resample : bool
        Accept uneven times: samples are interpolated onto even instants; what was not measured
        stays missing.
    source : str
        A name for reports.

    Returns
    -------
    Record

    Raises
    ------
    BadRecord, BadUnit
        As `Record` says; a unit for a channel that is not there; neither times nor a sample time;
        uneven times, with the index and the step.

    Examples
    --------
    >>> import numpy as np, residuum as rs
    >>> units = {"speed": "rad/s"}
    >>> rs.from_arrays({"speed": np.zeros(100)}, units=units, sample_time=0.01).duration
    1.0
    >>> t = np.linspace(2.0, 3.0, 101)
    >>> rs.from_arrays({"speed": np.sin(t)}, units={"speed": "rad/s"}, time=t).t0
    2.0
    """
    given = dict(units or {})
    unknown = [name for name in given if name not in channels]
    if unknown:
        raise BadRecord(
            f"units: there is no channel {unknown[0]!r};"
            f" {known_names(unknown[0], channels, 'there are')}"
        )
    signals: Any = dict(channels)
    all_units = {name: given.get(name, "") for name in signals}
    where = source or "arrays"
    if time is not None:
        instants = seconds(np.asarray(time), where, is_time=True)
        # Two beginnings could contradict each other.
        if t0 is not None:
            raise BadRecord(f"{where}, t0: the times begin at {instants[0]:g} s; leave it out")
        return _at_times(instants, signals, all_units, resample, where, sample_time)
    if sample_time is None:
        raise BadRecord(
            f"{where}: has no time; say sample_time=0.01 (seconds between samples), or"
            " time=t (an array)"
        )
    return Record(signals, all_units, sample_time, t0=t0 or 0.0, source=source)


def _at_times(
    instants: npt.NDArray[np.float64],
    signals: dict[str, Any],
    units: dict[str, str],
    resample: bool,
    where: str,
    sample_time: float | None,
) -> Record:
    """A record of arrays that were sampled at these times."""
    arrays = {name: np.asarray(values, dtype=float) for name, values in signals.items()}
    unlike = [name for name, values in arrays.items() if values.shape != instants.shape]
    if unlike:
        shapes = f"has shape {arrays[unlike[0]].shape}, time has {instants.shape}"
        raise BadRecord(f"{where}, channel {unlike[0]!r}: {shapes}; they must be alike")
    return _timed(instants, arrays, units, resample, where, sample_time)


def from_pandas(
    frame: pandas.DataFrame,
    *,
    units: Mapping[str, str] | None = None,
    time: str | None = None,
    sample_time: float | None = None,
    resample: bool = False,
    source: str = "",
) -> Record:
    """A record of a pandas DataFrame, a channel a column of numbers.

    Parameters
    ----------
    frame : DataFrame or named Series
        Its index is the time: instants (`DatetimeIndex`, with a zone or without), durations, or
        seconds. Whole numbers count rows as likely as seconds: they are refused unless the index
        says its unit (`t [ms]`).
    units : mapping of column to unit
        Over `frame.attrs["units"]`. Heads `name [unit]` and `name (unit)` are understood, a second
        row of heads that holds units, too. A column without a unit has none: a model that asks for
        one refuses it.
    time : str
        A column to take the time from instead of the index.
    sample_time : float
        Seconds between rows, where neither index nor column is a time; one that contradicts the
        index is refused.
    resample : bool
        Accept uneven time: samples are interpolated onto even instants; what was not measured stays
        missing.
    source : str
        A name for reports.

    Returns
    -------
    Record

    Raises
    ------
    BadRecord
        Uneven time, an index that is none, columns of one name, a column that holds no numbers; the
        message says what to do.
    BadUnit
        A unit that is not known.

    Examples
    --------
    >>> import pandas, residuum as rs
    >>> columns = {"u [V]": [0.0, 1.0, 1.0], "speed": [0.0, 2.0, 3.0]}
    >>> frame = pandas.DataFrame(columns, index=[0.0, 0.1, 0.2])
    >>> print(rs.from_pandas(frame, units={"speed": "rad/s"}))
    DataFrame: 3 samples of 0.1 s, 0.3 s; u [V], speed [rad/s]
    """
    where = source or "DataFrame"
    frame = as_frame(frame, where)
    if time is not None and time not in frame.columns:
        raise BadRecord(
            f"{where}: has no column {time!r} for the time;"
            f" {known_names(time, frame.columns, 'there are')}"
        )
    by_column = heads(frame, where, without=time)
    all_units = units_of(by_column, frame.attrs.get("units", {}), units or {})
    signals = {
        name: numbers(frame[column], f"{where}, column {column!r}")
        for column, (name, _) in by_column.items()
    }
    # An index of plain numbers counts rows here; one of instants tells the time itself, and the
    # sample time is held against it below.
    if sample_time is not None and time is None and not _has_instants(frame.index):
        return from_arrays(signals, units=all_units, sample_time=sample_time, source=where)
    taken, head = (frame.index, frame.index.name) if time is None else (frame[time], time)
    instants = seconds(
        taken, where, unit=unit_of_time(head), is_time=time is not None, near=_near_time(by_column)
    )
    refuse_disorder(instants, where)
    return _timed(instants, signals, all_units, resample, where, sample_time)


def from_xarray(
    data: xarray.Dataset, *, dim: str = "time", resample: bool = False, source: str = ""
) -> Record:
    """A record of an xarray Dataset (or DataArray), a channel a variable along `dim`.

    Parameters
    ----------
    data : Dataset or DataArray
        Units are taken from each variable's `attrs["units"]`; a DataArray needs a name.
    dim : str
        The dimension whose coordinate is the time: instants, durations, or seconds.
    resample : bool
        Accept uneven time: samples are interpolated onto even instants.
    source : str
        A name for reports.

    Returns
    -------
    Record

    Raises
    ------
    BadRecord
        No such dimension, a variable along another one, uneven time.

    Examples
    --------
    >>> import xarray, residuum as rs
    >>> speed = xarray.DataArray([0.0, 2.0, 3.0], coords={"time": [0.0, 0.1, 0.2]}, name="speed")
    >>> speed.attrs["units"] = "rad/s"
    >>> rs.from_xarray(speed).units["speed"]
    'rad/s'
    """
    where = source or "Dataset"
    # A DataArray has no variables by name: it becomes the one of a Dataset, under its own name.
    dataset = data.to_dataset() if not hasattr(data, "data_vars") else data
    if dim not in dataset.coords:
        raise BadRecord(
            f"{where}: has no coordinate {dim!r}; {known_names(dim, dataset.coords, 'there are')}"
        )
    off_dim = [name for name, values in dataset.data_vars.items() if values.dims != (dim,)]
    if off_dim:
        raise BadRecord(
            f"{where}: variable {off_dim[0]!r} lies along {dataset[off_dim[0]].dims}; must be along"
            f" ({dim!r},) alone"
        )
    signals = {
        str(name): numbers(values, f"{where}, variable {name!r}")
        for name, values in dataset.data_vars.items()
    }
    units = {
        str(name): str(values.attrs.get("units", "")) for name, values in dataset.data_vars.items()
    }
    instants = seconds(dataset[dim].values, where, unit=str(dataset[dim].attrs.get("units", "")))
    refuse_disorder(instants, where)
    return _timed(instants, signals, units, resample, where)


def as_records(records: Any) -> list[MeasuredRecord]:
    """One record, several, or files, as a list; each is a separate experiment.

    Raises
    ------
    BadRecord
        Something else, with the way to make a record of it.
    """
    if isinstance(records, MeasuredRecord):
        return [records]
    if isinstance(records, str | PathLike):
        return [read(records)]
    if isinstance(records, Sequence) and records:
        return [record for item in records for record in as_records(item)]
    raise _no_record(records)


def _no_record(given: Any) -> BadRecord:
    """The refusal of what is neither a record nor a file, with the way to make a record of it."""
    # By attributes, for pandas and xarray are not imported to refuse what is theirs; arrays come
    # last, as objects of both can be made arrays.
    if hasattr(given, "iloc"):
        return BadRecord(
            "record: is a pandas object; make a record of it with rs.from_pandas(frame, units={…})"
        )
    if hasattr(given, "dims"):
        return BadRecord(
            "record: is an xarray object; make a record of it with rs.from_xarray(data)"
        )
    if hasattr(given, "__array__"):
        return BadRecord(
            "record: is an array; make a record of it with rs.from_arrays({name: array}, units={…},"
            " time=…)"
        )
    return BadRecord(
        f"record: is {type(given).__name__}; must be a Record, a file, or a list of these;"
        " rs.read(file), rs.from_pandas and rs.from_arrays make one"
    )


def _has_instants(index: Any) -> bool:
    return getattr(getattr(index, "dtype", None), "kind", "") in "mM"


def _near_time(by_column: Mapping[Any, tuple[str, str]]) -> str:
    """The column that looks like the time, for a refusal of the index."""
    named = (column for column, (name, _) in by_column.items() if name.lower() in _TIMES)
    return str(next(named, "COLUMN"))


def _timed(
    instants: npt.NDArray[np.float64],
    signals: dict[str, Any],
    units: dict[str, str],
    resample: bool,
    where: str,
    sample_time: float | None = None,
) -> Record:
    if not signals:
        raise BadRecord(f"{where}: has no channel; at least one is needed")
    notes: list[str] = []
    # Time and signals go through it together: a row that is moved or left out is so in all of them.
    step, columns = even_columns(
        np.stack([instants, *signals.values()]),
        where,
        resample=resample,
        told=notes,
        names=[*signals],
    )
    # Refuses a sample time that contradicts the times.
    ReadOptions(sample_time=sample_time).settle_sample_time(step, where)
    channels = dict(zip(signals, columns[1:], strict=True))
    return Record(channels, units, step, t0=float(columns[0][0]), notes=tuple(notes), source=where)
