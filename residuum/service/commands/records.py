"""The options by which every command takes records, and reading them."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats import CAN_LOGS, ReadOptions
from residuum.identification.record_formats.csv import AS_LOGGER
from residuum.identification.record_formats.even_time import RESAMPLED
from residuum.identification.record_formats.loggers.no_value import NO_VALUE
from residuum.identification.record_formats.read_apart import mapping_beside, read_mapped
from residuum.identification.record_formats.time_bases import MEASURED_AT, NOT_READ
from residuum.service.commands.report import progress

RecordFiles = Annotated[list[Path], typer.Argument(metavar="RECORD…", help="Record files; each is a separate experiment.")]
Resample = Annotated[
    bool,
    typer.Option(
        "--resample", help="Accept uneven time stamps: interpolate onto even ones. Holes of more than three steps stay missing."
    ),
]
SampleTime = Annotated[float | None, typer.Option(help="Seconds from sample to sample, for a file that does not say them.")]
Units = Annotated[
    list[str] | None,
    typer.Option(
        "--unit",
        metavar="CHANNEL=UNIT",
        help="Unit of a channel for which the file says none, as speed=rpm; of the times too, as t=ms.",
    ),
]
ChannelMap = Annotated[
    list[str] | None,
    typer.Option(
        "--map", metavar="NAME=COLUMN", help="Take the signal NAME from this column. time=COLUMN names the column of times."
    ),
]

MappingFile = Annotated[
    Path | None,
    typer.Option(
        "--mapping",
        help="Mapping by which a logger's file is read (`residuum inspect` writes it). Default: FILE.mapping.yaml beside it.",
    ),
]
DbcFile = Annotated[
    Path | None, typer.Option("--dbc", metavar="FILE", help=f"DBC file by which CAN logs ({', '.join(CAN_LOGS)}) are read.")
]

_TOLD = (RESAMPLED, MEASURED_AT, NOT_READ, NO_VALUE)
"""What notes tell of the samples themselves: a command says it."""


def pairs(option: str, texts: Sequence[str] | None) -> dict[str, str]:
    """`NAME=VALUE` texts of an option as a mapping; BadRecord names the one that is malformed."""
    found = {}
    for text in texts or ():
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise BadRecord(f"option {option} {text!r}: must be NAME=VALUE")
        found[name] = value
    return found


def signals(channel_map: Sequence[str] | None) -> dict[str, str]:
    """What a model maps: all but the column of times."""
    return {name: column for name, column in pairs("--map", channel_map).items() if name != "time"}


def load_records(
    files: Sequence[Path],
    *,
    resample: bool = False,
    sample_time: float | None = None,
    units: Sequence[str] | None = None,
    channel_map: Sequence[str] | None = None,
    model_map: Sequence[str] | None = None,
    mapping: Path | None = None,
    dbc: Path | None = None,
) -> list[Record]:
    """Read the record files of a command; `channel_map` renames column → name (`time`: the column of times), `mapping` reads
    loggers' files, `dbc` CAN logs, `model_map` is what a model maps itself (`signals`). A unit is said of a column, or of the
    name that it gets.
    """
    if dbc is not None and not any(is_can_log(file) for file in files):
        raise BadRecord(f"--dbc {dbc}: no record is a CAN log; these end in {', '.join(CAN_LOGS)}")
    columns = pairs("--map", channel_map or model_map)
    told = {columns.get(name, name): unit for name, unit in pairs("--unit", units).items()}
    time = columns.pop("time", None)
    options = ReadOptions(resample=resample, sample_time=sample_time, units=told, time_column=time)
    renames = {column: name for name, column in columns.items()} if channel_map else {}
    return [_read(file, options, mapping, dbc).rename(renames) for file in files]


def is_can_log(file: Path) -> bool:
    """Whether a file is one of a bus, by its ending."""
    return file.suffix.lower() in CAN_LOGS


def _can_record(file: Path, options: ReadOptions, dbc: Path | None) -> Record:
    """The record of a CAN log; the libraries of buses are imported for one only, they take a second."""
    if dbc is None:
        raise BadRecord(f"{file}: is a CAN log; name the DBC file of its bus with --dbc FILE")
    if not file.is_file():
        raise BadRecord(f"{file}: no such file")
    made: Record = import_module("residuum.service.fieldbus.can.can_record").read_can_record(file, dbc, options)
    return made


def _read(file: Path, options: ReadOptions, mapping: Path | None, dbc: Path | None) -> Record:
    """One record, by `mapping` or the mapping beside it where there is one; what was done to its samples is told."""
    if is_can_log(file):
        record = _can_record(file, options, dbc)
        for note in record.notes:
            progress(f"{file}: {note}")
        return record
    chosen = mapping or mapping_beside(file)
    record = read_mapped(file, options, chosen)
    done = record.notes if chosen is not None or any(note.startswith(AS_LOGGER) for note in record.notes) else ()
    for note in done or [note for note in record.notes if any(word in note for word in _TOLD)]:
        progress(f"{file}: {note}")
    return record
