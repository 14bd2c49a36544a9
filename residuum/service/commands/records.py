"""The options by which every command takes records, and reading them."""

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, fields
from importlib import import_module
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats import CAN_LOGS, ReadOptions
from residuum.identification.record_formats.csv import AS_LOGGER
from residuum.identification.record_formats.even_time import RESAMPLED
from residuum.identification.record_formats.loggers.no_value import NO_VALUE
from residuum.identification.record_formats.read_apart import mapping_beside, read_mapped
from residuum.identification.record_formats.time_bases import MEASURED_AT, NOT_READ
from residuum.service.commands.options_of import expanded, parameter_of
from residuum.service.commands.report import progress

# The argument that names a model of balances.

ModelSource = Annotated[
    str, typer.Argument(metavar="MODEL", help="A built-in model or a model file.")
]


RecordFiles = Annotated[
    list[Path],
    typer.Argument(
        metavar="RECORD…",
        help=(
            "Record files, tables of a history (timescale:// or"
            " influx://host/database/table?tags=a,b), or"
            " nodes of an OPC UA server that keeps their history"
            " (opc.tcp://host:4840?nodes=ns=2;s=Speed&start=…&end=…); each is a separate"
            " experiment."
        ),
    ),
]
Resample = Annotated[
    bool,
    typer.Option(
        "--resample",
        help=(
            "Accept uneven time stamps: interpolate onto even ones. Holes of more than three steps"
            " stay missing."
        ),
    ),
]
SampleTime = Annotated[
    float | None,
    typer.Option(help="Seconds from sample to sample, for a file that does not say them."),
]
Units = Annotated[
    list[str] | None,
    typer.Option(
        "--unit",
        metavar="CHANNEL=UNIT",
        help=(
            "Unit of a channel for which the file says none, as speed=rpm; of the times too, as"
            " t=ms."
        ),
    ),
]
ChannelMap = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="NAME=COLUMN",
        help="Take the signal NAME from this column. time=COLUMN names the column of times.",
    ),
]

MappingFile = Annotated[
    Path | None,
    typer.Option(
        "--mapping",
        help=(
            "Mapping by which a logger's file is read (`residuum inspect` writes it). Default:"
            " FILE.mapping.yaml beside it."
        ),
    ),
]
DbcFile = Annotated[
    Path | None,
    typer.Option(
        "--dbc",
        metavar="FILE",
        help=f"DBC file by which CAN logs ({', '.join(CAN_LOGS)}) are read.",
    ),
]

# What notes tell of the samples themselves: a command says it.
_OF_SAMPLES = (RESAMPLED, MEASURED_AT, NOT_READ, NO_VALUE)


def pairs(option: str, texts: Sequence[str] | None) -> dict[str, str]:
    """`NAME=VALUE` texts of an option as a mapping; BadRecord names the one that is malformed."""
    mapping = {}
    for text in texts or ():
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise BadRecord(f"option {option} {text!r}: must be NAME=VALUE")
        mapping[name] = value
    return mapping


@dataclass(frozen=True)
class Reading:
    """How a command reads its records: an option a field."""

    channel_map: ChannelMap = None
    resample: Resample = False
    mapping: MappingFile = None
    dbc: DbcFile = None
    sample_time: SampleTime = None
    unit: Units = None

    @property
    def signals(self) -> dict[str, str]:
        """What a model maps itself: all but the column of times."""
        return {name: column for name, column in self._columns.items() if name != "time"}

    @property
    def options(self) -> ReadOptions:
        """How files and histories are read, their columns named as they are there."""
        # a unit is said of a column, or of the name that it gets
        units = {
            self._columns.get(name, name): unit for name, unit in pairs("--unit", self.unit).items()
        }
        return ReadOptions(
            resample=self.resample,
            sample_time=self.sample_time,
            units=units,
            time_column=self._columns.get("time"),
        )

    def for_model(self, files: Sequence[Path]) -> list[Record]:
        """The records, their columns named as in the file: a model maps them (`signals`)."""
        if self.dbc is not None and not any(is_can_log(file) for file in files):
            raise BadRecord(
                f"--dbc {self.dbc}: no record is a CAN log; these end in {', '.join(CAN_LOGS)}"
            )
        options = self.options
        return [_read(file, options, self.mapping, self.dbc) for file in files]

    def named(self, files: Sequence[Path]) -> list[Record]:
        """The records, their columns under the names that they were given."""
        return [self.renamed(record) for record in self.for_model(files)]

    def renamed(self, record: Record) -> Record:
        """A record, its columns under the names that they were given."""
        return record.rename({column: name for name, column in self.signals.items()})

    @property
    def _columns(self) -> dict[str, str]:
        return pairs("--map", self.channel_map)


def reads(without: Container[str] = ()) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Turn the parameter of a command that is a `Reading` into its options, but for those in
    `without`.
    """

    def command(function: Callable[..., Any]) -> Callable[..., Any]:
        name, kind = parameter_of(function, Reading)
        hints = get_type_hints(kind, include_extras=True)
        options = {
            field.name: Parameter(
                field.name,
                Parameter.KEYWORD_ONLY,
                default=field.default,
                annotation=hints[field.name],
            )
            for field in fields(kind)
            if field.name not in without
        }
        return expanded(function, name, options, lambda texts: kind(**texts))

    return command


def is_can_log(file: Path) -> bool:
    """Whether a file is one of a bus, by its ending."""
    # by its name: the libraries that could look into it take a second to load
    return file.suffix.lower() in CAN_LOGS


def _can_record(file: Path, options: ReadOptions, dbc: Path | None) -> Record:
    """The record of a CAN log; the libraries of buses are imported for one only, they take a
    second.
    """
    if dbc is None:
        raise BadRecord(f"{file}: is a CAN log; name the DBC file of its bus with --dbc FILE")
    if not file.is_file():
        raise BadRecord(f"{file}: no such file")
    record: Record = import_module("residuum.service.fieldbus.can.can_record").read_can_record(
        file, dbc, options
    )
    return record


def _read(file: Path, options: ReadOptions, mapping: Path | None, dbc: Path | None) -> Record:
    """One record, by `mapping` or the mapping beside it where there is one; what was done to its
    samples is told.
    """
    if is_can_log(file):
        record = _can_record(file, options, dbc)
        for note in record.notes:
            progress(f"{file}: {note}")
        return record
    # A mapping that was named goes over the one beside the file, which every door finds by itself.
    chosen = mapping or mapping_beside(file)
    record = read_mapped(file, options, chosen)
    for note in _notes_to_tell(record, mapped=chosen is not None):
        # the source is an address without its password
        progress(f"{record.source}: {note}")
    return record


def _notes_to_tell(record: Record, *, mapped: bool) -> Sequence[str]:
    """All notes of a logger's file, where they tell how it was understood; of others those of the
    samples alone.
    """
    if mapped or any(note.startswith(AS_LOGGER) for note in record.notes):
        return record.notes
    return [note for note in record.notes if any(word in note for word in _OF_SAMPLES)]
