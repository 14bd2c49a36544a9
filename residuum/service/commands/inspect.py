"""`residuum inspect`: what is understood of a logger's file, a CAN log or a Modbus device, each
guess with its reason.
"""

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats import CAN_LOGS, OLDER, READERS, ReadOptions
from residuum.identification.record_formats.loggers.first_rows import first_rows
from residuum.identification.record_formats.loggers.logger_file import LoggerFile, understand
from residuum.identification.record_formats.loggers.logger_mapping import parse_logger
from residuum.identification.record_formats.lvm import LONGEST_HEAD, has_head
from residuum.identification.record_formats.read_apart import read_safely
from residuum.identification.record_formats.scope_csv import is_scope_csv
from residuum.identification.residual_analysis.odd_readings import POWER_ON, far_beside, is_mark
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.records import (
    DbcFile,
    Resample,
    SampleTime,
    Units,
    is_can_log,
    pairs,
)
from residuum.service.commands.report import AsJson, report

# What `inspect` shows of a file, of one shape for every format: guesses, channels, rate, what has
# no unit, the first rows.

# Samples below which nothing is said of error codes: too few tell what lies far beside.
_FEWEST = 30
# Its number, name and unit, and how many of its samples are missing.
_Column = tuple[int, str, str, int]


def of_record_file(file: Path, options: ReadOptions = ReadOptions()) -> tuple[dict[str, Any], str]:
    """(JSON object, text for people) of a file whose format says how it is read; the reader's
    refusal where it is not.
    """
    shown = _of_record(file, read_safely(file, options))
    return shown, _text(shown)


def _of_record(file: Path, record: Record) -> dict[str, Any]:
    columns = [
        (k, name, record.units[name], int(record.missing(name).sum()))
        for k, name in enumerate(record.names, start=1)
    ]
    samples: dict[str, Any] = {
        "rows": record.n,
        "sample_time": record.sample_time,
        "rate": record.sampling_rate,
        "even": True,
    }
    samples |= {"gaps": [], "gap_count": 0, "reordered": 0, "duplicates": 0}
    # Time and every channel, as a file has its columns.
    rows = first_rows(record.time, np.stack([record[name] for name in record.names]))
    signals = {name: np.asarray(record[name]) for name in record.names}
    shown = _shown(file, columns, samples, rows) | {
        "notes": [*record.notes, *_error_codes(signals, record.units)]
    }
    shown["ranges"] = {name: _range(signal) for name, signal in signals.items()}
    return shown


def of_logger_file(
    file: Path, logger_file: LoggerFile, resampled: Record | None = None
) -> tuple[dict[str, Any], str]:
    """(JSON object, text for people) of a logger's text file, as it is understood, or as it is
    `resampled` by that.
    """
    shown = _understood(file, logger_file) if resampled is None else _of_record(file, resampled)
    shown["guesses"] = [
        {"what": guess, "value": value, "reason": why}
        for guess, (value, why) in logger_file.guesses.items()
    ]
    shown["mapping"] = logger_file.mapping.to_yaml()
    return shown, _text(shown)


def _understood(file: Path, logger_file: LoggerFile) -> dict[str, Any]:
    mapping, samples = logger_file.mapping, dict(logger_file.samples)
    missing, rows, notes = samples.pop("missing"), samples.pop("first_rows"), samples.pop("notes")
    signals = samples.pop("signals")
    columns = [
        (k, name, mapping.units.get(k, ""), missing[name]) for k, name in mapping.names.items()
    ]
    shown = _shown(file, columns, samples, rows) | {
        "notes": [*notes, *_error_codes(signals, {name: unit for _, name, unit, _ in columns})]
    }
    shown["ranges"] = {name: _range(signal) for name, signal in signals.items()}
    return shown


def _shown(
    file: Path, columns: Sequence[_Column], samples: dict[str, Any], rows: list[list[float | None]]
) -> dict[str, Any]:
    return {
        "file": str(file),
        "guesses": [],
        "columns": [
            dict(zip(("column", "name", "unit", "missing"), column, strict=True))
            for column in columns
        ],
        "samples": samples,
        "without_unit": [name for _, name, unit, _ in columns if not unit],
        "first_rows": rows,
        "notes": [],
        "mapping": None,
    }


def _text(shown: dict[str, Any]) -> str:
    samples, columns = shown["samples"], shown["columns"]
    # Where stamps stand several times, there is no rate before it is said what becomes of them.
    rate = "" if samples["duplicates"] else f", {samples['rate']:.6g} Hz"
    lines = [f"{shown['file']}: {_rows(samples)}, {len(columns)} channels{rate}"]
    lines += [
        f"  {guess['what']}: {guess['value']!r} ({guess['reason']})" for guess in shown["guesses"]
    ]
    lines += [f"  {note}" for note in shown["notes"]]
    lines += [
        f"  column {c['column']}: {c['name']} [{c['unit']}], {c['missing']}"
        f" missing{_span(shown, c)}"
        for c in columns
    ]
    lines += _without_unit(shown)
    lines += [f"  {_row_text(row)}" for row in shown["first_rows"]]
    return "\n".join([*lines, *_steps(samples)])


def _without_unit(shown: dict[str, Any]) -> list[str]:
    if not shown["without_unit"]:
        return []
    way_on = ", or the mapping, says it" if shown["mapping"] else " says it to the commands"
    names = ", ".join(shown["without_unit"])
    return [f"  without a unit: {names}; --unit COLUMN=UNIT{way_on}"]


def _row_text(row: Sequence[float | None]) -> str:
    return ", ".join("missing" if value is None else f"{value:.12g}" for value in row)


def _steps(samples: dict[str, Any]) -> list[str]:
    """What is wrong with the steps of time, if anything."""
    lines = [
        f"  gap of {gap['seconds']:.6g} s after row {gap['after_row']}: {gap['looks_like']}"
        for gap in samples["gaps"]
    ]
    if samples["gap_count"] > len(samples["gaps"]):
        lines.append(f"  {samples['gap_count']} gaps in all")
    if not samples["even"]:
        lines.append("  steps are uneven: the commands take it with --resample")
    return lines


def _range(signal: npt.NDArray[np.floating]) -> list[float] | None:
    """Lowest and highest value; None of a channel without any."""
    known = signal[np.isfinite(signal)]
    return [float(known.min()), float(known.max())] if known.size else None


def _span(shown: dict[str, Any], column: dict[str, Any]) -> str:
    span = shown["ranges"].get(column["name"])
    return "" if span is None else f", {span[0]:.6g} … {span[1]:.6g}"


def _error_codes(
    signals: Mapping[str, npt.NDArray[np.floating]], units: Mapping[str, str]
) -> list[str]:
    """What sensors write where they have no value, among rows far beside their neighbours."""
    says = []
    for name, signal in signals.items():
        # Among few samples everything is far beside its neighbours.
        if np.isfinite(signal).sum() < _FEWEST:
            continue
        values = np.asarray(signal, dtype=float)
        rows, _, _ = far_beside(values, units[name])
        # Twelve rows of 600 that read −127 or 85 once made a noise of 18 °C, beside which no error
        # of the model could be seen.
        coded = rows[is_mark(values[rows]) | (values[rows] == POWER_ON)].tolist()
        if coded:
            codes = sorted({float(values[row]) for row in coded})
            marks = " ".join(f"--missing {code:.10g}" for code in codes)
            where = ", ".join(map(str, coded[:12])) + ", …" * (len(coded) > 12)
            says.append(
                f"{name}: {len(coded)} samples (numbers {where}, from 0) read"
                f" {' or '.join(f'{c:.10g}' for c in codes)} beside their neighbours, as sensors"
                f" write where they have no value; then say {marks}"
            )
    return says


def _rows(samples: dict[str, Any]) -> str:
    """How many rows, and how far apart they are; where stamps stand several times nobody knows
    yet.
    """
    if repeated := samples["duplicates"]:
        return (
            f"{samples['rows']} rows, {samples['rows'] - repeated} stamps"
            f" {samples['sample_time']:.6g} s apart"
        )
    return f"{samples['rows']} rows of {samples['sample_time']:.6g} s"


app = typer.Typer(add_completion=False)
_TIME = "time="


@app.command(name="inspect")
def inspect_command(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE|modbus:HOST:PORT",
            help="A record file, a logger's text file, a CAN log, or a device.",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="MAPPING.yaml", help="Write the mapping here.")
    ] = None,
    decimal: Annotated[
        str | None, typer.Option(help="The decimal sign, where the file leaves it open.")
    ] = None,
    time: Annotated[
        str | None,
        typer.Option(help="Form of the time column: seconds, epoch ms, excel, 'day first' …"),
    ] = None,
    missing: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CELL", help="A cell that means no value, such as OL; may be given again."
        ),
    ] = None,
    names: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,…",
            help="Names of all columns, of a file without heads; units in brackets.",
        ),
    ] = None,
    dbc: DbcFile = None,
    mapped: Annotated[
        str | None,
        typer.Option(
            "--map",
            metavar="FILE|time=COLUMN",
            help="Register map of a Modbus device; or the column of times of a text.",
        ),
    ] = None,
    resample: Resample = False,
    sample_time: SampleTime = None,
    units: Units = None,
    as_json: AsJson = False,
) -> None:
    """Show how a logger's file is understood: columns, units, times, rate, gaps. Write a mapping
    file for it.

    Of a file whose format says this itself (MAT, TDMS, MDF, LVM, Parquet …) show what is read, what
    is left out, the first rows. Of a CAN log with its DBC file, or a Modbus device with its
    register map, show what is on the wire and what they make of it.
    """
    # One option for two things that no file has both of: a device has a register map, a text a
    # column of times.
    time_column = _time_column(mapped)
    if file.startswith("modbus:") or (mapped is not None and time_column is None):
        report(*_device(file, None if mapped is None else Path(mapped)), as_json=as_json)
    elif dbc is not None or is_can_log(Path(file)):
        report(*_log(Path(file), dbc), as_json=as_json)
    elif _says_itself(Path(file)):
        options = ReadOptions(
            resample=resample, sample_time=sample_time, units=pairs("--unit", units)
        )
        report(*of_record_file(Path(file), options), as_json=as_json)
    else:
        given = {
            "decimal": decimal,
            "time_form": time,
            "time_column": time_column,
            "told_units": pairs("--unit", units),
            "missing": missing or [],
            "sample_time": sample_time,
            "heads": [] if names is None else names.split(","),
        }
        _logger_file(Path(file), out, given, resample=resample, as_json=as_json)


def _time_column(mapped: str | None) -> str | None:
    """The column of times that `--map` names, where it names no register map."""
    if mapped is None or not mapped.startswith(_TIME):
        return None
    return mapped.removeprefix(_TIME)


def _device(address: str, register_map: Path | None) -> tuple[dict[str, Any], str]:
    """The libraries of buses are imported for a device only: they take a second."""
    if register_map is None:
        raise BadRecord(f"{address}: name the register map of the device with --map FILE")
    inspected: tuple[dict[str, Any], str] = import_module(
        "residuum.service.commands.device_inspection"
    ).inspect_device(address, register_map)
    return inspected


def _says_itself(file: Path) -> bool:
    """Whether a file's format says how it is read, so that there is nothing to guess and no mapping
    to write.
    """
    ending = file.suffix.lower()
    # LabVIEW's and a scope's heads are told from their begin, so that a long file is not read
    # twice.
    if ending == ".lvm":
        return file.is_file() and has_head(_start(file))
    if ending == ".csv":
        return file.is_file() and is_scope_csv(_start(file))
    return ending in READERS | OLDER


def _start(file: Path) -> bytes:
    with file.open("rb") as content:
        return content.read(LONGEST_HEAD)


def _log(file: Path, dbc: Path | None) -> tuple[dict[str, Any], str]:
    if dbc is None or not is_can_log(file):
        raise BadRecord(
            f"{file}: a CAN log ({', '.join(CAN_LOGS)}) and the DBC file of its bus (--dbc FILE) go"
            " together"
        )
    inspected: tuple[dict[str, Any], str] = import_module(
        "residuum.service.commands.log_inspection"
    ).inspect_log(file, dbc)
    return inspected


def _logger_file(
    file: Path, out: Path | None, given: dict[str, Any], *, resample: bool, as_json: bool
) -> None:
    if out is not None:
        check_output_file(out)
    try:
        content = file.read_bytes()
    except OSError as error:
        raise BadRecord(f"{file}: cannot be read: {error.strerror}") from None
    understood = understand(content, str(file), **given)
    if out is not None:
        out.write_text(understood.mapping.to_yaml(), encoding="utf-8")
    resampled = (
        parse_logger(content, str(file), understood.mapping, ReadOptions(resample=True))
        if resample
        else None
    )
    report(*of_logger_file(file, understood, resampled), as_json=as_json)
