"""The options by which every command takes records, and reading them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats import ReadOptions, read_record
from residuum.identification.record_formats.logger_mapping import ENDING, read_logger_file, read_mapping
from residuum.service.commands.report import progress

RecordFiles = Annotated[list[Path], typer.Argument(metavar="RECORD…", help="Record files; each is an experiment of its own.")]
Resample = Annotated[bool, typer.Option("--resample", help="Accept uneven time stamps; samples are interpolated.")]
SampleTime = Annotated[float | None, typer.Option(help="Seconds between samples, for files that do not say it.")]
Units = Annotated[
    list[str] | None, typer.Option("--unit", metavar="CHANNEL=UNIT", help="Unit of a channel, for files without units.")
]
ChannelMap = Annotated[
    list[str] | None, typer.Option("--map", metavar="NAME=COLUMN", help="Take the signal NAME from this column.")
]

MappingFile = Annotated[
    Path | None, typer.Option("--mapping", help="Read loggers' files by this mapping (`residuum inspect` writes it).")
]


def pairs(option: str, texts: Sequence[str] | None) -> dict[str, str]:
    """`NAME=VALUE` texts of an option as a mapping; BadRecord names the one that is malformed."""
    found = {}
    for text in texts or ():
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise BadRecord(f"option {option} {text!r}: must be NAME=VALUE")
        found[name] = value
    return found


def load_records(
    files: Sequence[Path],
    *,
    resample: bool = False,
    sample_time: float | None = None,
    units: Sequence[str] | None = None,
    channel_map: Sequence[str] | None = None,
    mapping: Path | None = None,
) -> list[Record]:
    """Read the record files of a command; `channel_map` renames column → name, `mapping` reads loggers' files."""
    options = ReadOptions(resample=resample, sample_time=sample_time, units=pairs("--unit", units))
    renames = {column: name for name, column in pairs("--map", channel_map).items()}
    return [_read(file, options, mapping).rename(renames) for file in files]


def _read(file: Path, options: ReadOptions, mapping: Path | None) -> Record:
    """One record, by `mapping` or the mapping beside it where there is one; what was done to its samples is told."""
    beside = file.with_name(file.name + ENDING)
    chosen = mapping or (beside if beside.is_file() else None)
    if chosen is None:
        return read_record(file, options)
    record = read_logger_file(file, read_mapping(chosen), options)
    for note in record.notes:
        progress(f"{file}: {note}")
    return record
