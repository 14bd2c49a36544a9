"""`residuum inspect`: what is understood of a logger's file, a CAN log or a Modbus device, each
guess with its reason.
"""

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from residuum.identification.errors import BadRecord
from residuum.identification.record_formats import CAN_LOGS, OLDER, READERS, ReadOptions
from residuum.identification.record_formats.loggers.logger_file import understand
from residuum.identification.record_formats.loggers.logger_mapping import parse_logger
from residuum.identification.record_formats.lvm import LONGEST_HEAD, has_head
from residuum.identification.record_formats.scope_csv import is_scope_csv
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.record_inspection import of_logger_file, of_record_file
from residuum.service.commands.records import (
    DbcFile,
    Resample,
    SampleTime,
    Units,
    is_can_log,
    pairs,
)
from residuum.service.commands.report import AsJson, report

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
    time_column = (
        mapped.removeprefix(_TIME) if mapped is not None and mapped.startswith(_TIME) else None
    )
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
