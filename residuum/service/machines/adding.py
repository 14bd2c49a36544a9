"""Machines that somebody adds: what their buses say, what is kept of their settings."""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import orjson
import structlog
from pydantic import BaseModel, Field, StringConstraints, ValidationError

from residuum.identification.errors import BadInput
from residuum.identification.physics import BUILT_IN, PhysicalModel
from residuum.identification.record import Record
from residuum.identification.units import compatible
from residuum.nearest_names import known_names
from residuum.service.alarms.alarm_states import AlarmRule
from residuum.service.broker import is_hidden, with_hidden_password
from residuum.service.fieldbus import SOURCES, TEXTS
from residuum.service.fieldbus.settings import (
    MAPS,
    MachineSettings,
    SecondOpinion,
    SourceSettings,
    WindowSettings,
)
from residuum.service.fieldbus.source import StreamFormat
from residuum.service.settings import Settings
from residuum.service.storage.disk_store import DiskStore
from residuum.service.store import Conflict, NotFound

# What a DBC file, a map or a table of registers says of a bus, before any machine is
# read by it.

OF_SOURCE: Mapping[str, str] = TEXTS
"""Kind of a bus description → kind of the sources that are read by it."""
_CALLED = [text.called for kind in SOURCES.values() for text in kind.texts.values()]
DESCRIPTIONS = f"{', '.join(_CALLED[:-1])}, or {_CALLED[-1]}."
"""What they are, in a sentence."""


@dataclass(frozen=True)
class BusDescription:
    """A bus description that was understood: its file, and the streams of samples that it gives."""

    name: str
    text: str
    streams: Sequence[StreamFormat]
    remarks: Sequence[str]

    def to_json(self) -> dict[str, Any]:
        """As plain values."""
        streams = [
            {"name": s.name, "sample_time": s.sample_time, "channels": dict(s.units)}
            for s in self.streams
        ]
        return {
            "name": self.name,
            "text": self.text,
            "streams": streams,
            "remarks": list(self.remarks),
        }


def bus_description(
    kind: str, name: str, text: str, sample_time: float = 0.1, unit_id: int = 1
) -> BusDescription:
    """Understand a description, one of `TEXTS`; of a table of registers a map is made.

    BadBusDescription when it cannot be read, or carries no stream of samples.
    """
    stem, asked = Path(name).stem or "bus", SOURCES[TEXTS[kind]].texts[kind]
    if asked.made is not None:
        text = asked.made(text, sample_time, name, unit_id)
    # readers read files: what was sent is one for as long as it is read
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{stem}{asked.ending}"
        file.write_text(text, encoding="utf-8")
        streams, remarks = asked.read(file)
    return BusDescription(file.name, text, streams, remarks)


# Which signal of a bus a model means: the one of the same name, else the only one with a unit
# that can be converted.


def model_signals(model: PhysicalModel) -> dict[str, tuple[str, str, bool]]:
    """Every input and output of a model: its unit, `input` or `output`, and whether a machine must
    have it.
    """
    inputs = {
        name: (signal.unit, "input", signal.default is None)
        for name, signal in model.inputs.items()
    }
    return inputs | {name: (signal.unit, "output", False) for name, signal in model.outputs.items()}


def guessed_channels(model: PhysicalModel, bus: Mapping[str, str]) -> dict[str, str]:
    """Model's name of a signal → the bus's, where one is the obvious choice.

    Parameters
    ----------
    bus : mapping of name to unit
    """
    wanted = {name: unit for name, (unit, _, _) in model_signals(model).items()}
    channels = _of_equal_names(wanted, bus)
    open_names = [name for name in wanted if name not in channels]
    for name in open_names:
        unused = {
            channel: unit for channel, unit in bus.items() if channel not in channels.values()
        }
        left = _fitting(unused, wanted[name])
        # a channel that two signals of the model could mean is obvious for neither
        rivals = [
            rival for rival in open_names if rival not in channels and _fitting(left, wanted[rival])
        ]
        if len(left) == 1 and rivals == [name]:
            channels[name] = next(iter(left))
    return channels


def _of_equal_names(wanted: Iterable[str], bus: Iterable[str]) -> dict[str, str]:
    """Model's name → the bus's, where they are the same but for capitals."""
    lower = {name.lower(): name for name in bus}
    return {name: lower[name.lower()] for name in wanted if name.lower() in lower}


def _fitting(bus: Mapping[str, str], unit: str) -> dict[str, str]:
    """The channels whose unit can be converted to this one."""
    return {channel: its_unit for channel, its_unit in bus.items() if compatible(its_unit, unit)}


# The names of signals: those on the bus, and those that a diagnoser or its model uses.


def named(record: Record, channels: Mapping[str, str]) -> Record:
    """The record with the names that the diagnoser uses, where `channels` gives them (diagnoser's
    name → bus's name).

    A channel of the bus that is called as another one is to be called gives way to it. A record
    that has the diagnoser's names already stays as it is.
    """
    renamed, chosen = _chosen(channels, record.names)
    return record.select(chosen).rename(renamed) if renamed else record


def units_of_windows(channels: Mapping[str, str], units: Mapping[str, str]) -> dict[str, str]:
    """Unit of each signal that windows of a bus with these units have, by the names of `named`."""
    renamed, chosen = _chosen(channels, list(units))
    return {renamed.get(name, name): units[name] for name in chosen}


def _chosen(channels: Mapping[str, str], names: Sequence[str]) -> tuple[dict[str, str], list[str]]:
    """What is called otherwise (bus's name → diagnoser's), and all that is taken from the bus."""
    renamed = {bus: name for name, bus in channels.items() if bus in names and bus != name}
    taken = set(renamed.values())
    return renamed, [name for name in names if name in renamed or name not in taken]


# Machines that were added while the service ran: kept in the store, each with the bus
# descriptions that it needs.

log = structlog.get_logger()

KIND = "machine"
ENDINGS = (f".{KIND}", ".method", ".limits")
"""What the names of a machine's documents end in: no model is given such a name."""
# Characters of an asset's name; with an ending it must still be a document's.
_LONGEST = 55
# No path: whoever adds a machine names none of this computer's files.
_PLAIN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


def document_name(asset: str) -> str:
    """The name under which a machine's document is kept; Conflict for a name that is too long."""
    if len(asset) > _LONGEST:
        raise Conflict(f"machine {asset!r}: its name is longer than {_LONGEST} characters")
    return f"{asset}.{KIND}"


def keep_machine(
    store: DiskStore, machine: MachineSettings, maps: Mapping[str, str], by: str
) -> None:
    """Keep a machine's settings with the texts of the bus descriptions that its sources name."""
    content = orjson.dumps({"machine": machine.model_dump(mode="json"), "maps": dict(maps)})
    store.add_model_version(document_name(machine.asset), KIND, content, "settings", by)


def forget_machine(store: DiskStore, asset: str, by: str) -> None:
    """Note that a machine is watched no more."""
    store.add_model_version(
        document_name(asset), KIND, orjson.dumps({"machine": None}), "removed", by
    )


def kept_document(store: DiskStore, name: str) -> Any:
    """The newest version of a machine's document; None where there is none, also where a model has
    that name.
    """
    try:
        newest = store.model_versions(name)[0]
    except NotFound:
        return None
    return orjson.loads(store.model_content(name, newest.number)) if newest.kind == KIND else None


def kept_maps(store: DiskStore, asset: str) -> Mapping[str, str]:
    """The bus descriptions that are kept with a machine; none for one that is not kept."""
    return dict((kept_document(store, f"{asset}.{KIND}") or {}).get("maps", {}))


def kept_machines(store: DiskStore, settings: Settings) -> Sequence[MachineSettings]:
    """All machines that are kept, their bus descriptions as files below the data folder."""
    machines: list[MachineSettings] = []
    cursor = None
    while True:
        page = store.models(KIND, cursor)
        for version in page.items:
            if not version.model.endswith(f".{KIND}"):
                continue
            # one that cannot be read, by an older version perhaps, must not keep the others out
            try:
                document = orjson.loads(store.model_content(version.model))
                if document["machine"] is not None:
                    machines.append(
                        with_server_files(
                            MachineSettings(**document["machine"]), document["maps"], settings
                        )
                    )
            except (
                ValidationError,
                BadInput,
                KeyError,
                TypeError,
                orjson.JSONDecodeError,
            ) as error:
                log.error(
                    "a kept machine cannot be read", document=version.model, reason=str(error)
                )
        cursor = page.next_cursor
        if cursor is None:
            return machines


def with_server_files(
    machine: MachineSettings, maps: Mapping[str, str], settings: Settings
) -> MachineSettings:
    """The settings with the files of this computer in place of what names them: those that hold the
    bus descriptions, and growing files.

    BadInput for the name of a map that is neither among `maps` nor one that comes with Residuum,
    and for a growing file that is not below the folder that the settings say: other files of this
    computer are not read for who adds a machine.
    """
    sources = [
        {
            **source.model_dump(),
            "map": _file(source.map, maps, settings.data),
            "channel": SOURCES[source.kind].sent(source.channel, settings.growing_files),
        }
        for source in machine.sources
    ]
    return MachineSettings(**{**machine.model_dump(), "sources": sources})


def _file(name: str, maps: Mapping[str, Any], data: Path) -> str:
    if _PLAIN_NAME.fullmatch(name) is None:
        raise BadInput(
            f"map {name[:60]!r}: must be a plain file name of letters, digits, '.', '_' and '-'"
        )
    if name not in maps:
        if not (MAPS / name).is_file():
            raise BadInput(
                f"map {name!r}: is not among the bus descriptions that were sent, and none comes"
                " with Residuum"
            )
        return name
    text = str(maps[name]).encode()
    # by content: machines may have maps of one name, and a map that is changed is another file
    folder = data / "maps" / hashlib.sha256(text).hexdigest()[:24]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(text)
    return str((folder / name).resolve())


# Passwords of machines' sources: they are never shown, and they are kept when what was shown
# comes back.


def with_kept_passwords(
    asked: Sequence[SourceSettings], stored: Sequence[SourceSettings]
) -> list[SourceSettings]:
    """The sources that are asked for, with a kept password wherever one is hidden.

    A password goes to no other address, user or kind of source than those it was given for:
    BadInput when none was.
    """
    return [_with_password(place, source, stored) for place, source in enumerate(asked)]


def _with_password(
    place: int, source: SourceSettings, stored: Sequence[SourceSettings]
) -> SourceSettings:
    if not is_hidden(source.channel):
        return source
    same = {
        old.channel
        for old in stored
        if (old.kind, with_hidden_password(old.channel)) == (source.kind, source.channel)
    }
    if len(same) != 1:
        raise BadInput(
            f"sources[{place}].channel: its password is hidden, and not one alone is kept for this"
            " address; give it"
        )
    return source.model_copy(update={"channel": same.pop()})


# The DBC files that a service knows: those of its machines, and those that come with Residuum.


def known_dbc(settings: Settings, store: DiskStore, name: str) -> Path:
    """The DBC file of this name; BadInput names those that are known. No other file of the computer
    can be asked for.
    """
    machines = [*settings.machines, *kept_machines(store, settings)]
    files = [
        source.map_file
        for machine in machines
        for source in machine.sources
        if source.kind == "can"
    ]
    known = {file.name: file for file in [*sorted(MAPS.glob("*.dbc")), *files]}
    if name not in known:
        raise BadInput(
            f"dbc {name[:60]!r}: no machine has a DBC file of this name; {known_names(name, known)}"
        )
    return known[name]


# The text of a physical model: a built-in one, a stored one, or a file that the settings name.

ModelText = tuple[str, bytes | None]
"""A model's name and text; None for the text of a built-in one."""


def stored_model(
    store: DiskStore, name: str, version: int | None = None, kinds: Sequence[str] = ("physical",)
) -> ModelText:
    """Name and text of a built-in or stored model; NotFound, or Conflict when it is of none of the
    kinds.
    """
    if version is None and name in BUILT_IN:
        return name, None
    actual = store.model_versions(name)[0].kind
    if actual not in kinds:
        raise Conflict(f"model {name!r}: is a {actual} model; this needs a physical one")
    return name, store.model_content(name, version)


def model_of_settings(
    store: DiskStore, name: str, kinds: Sequence[str] = ("physical",)
) -> ModelText:
    """The model that a machine's settings name: built in, stored, or a file of this computer."""
    try:
        return stored_model(store, name, kinds=kinds)
    except NotFound:
        pass
    try:
        return Path(name).stem, Path(name).read_bytes()
    except OSError as error:
        raise BadInput(
            f"model {name!r}: is neither stored nor built in, and no file that can be read:"
            f" {error.strerror}"
        ) from None


# A machine as somebody adds it to the running service: its settings, and the bus descriptions
# that its sources name.

Text = Annotated[str, StringConstraints(min_length=1, max_length=200)]


class WatchedMachine(BaseModel, extra="forbid"):
    """What is watched, where it is read, how it is cut into windows, and who judges."""

    diagnoser: str = Field(max_length=64)
    window: WindowSettings
    sources: list[SourceSettings] = Field(min_length=1, max_length=8)
    channels: dict[Text, Text] = Field(
        {}, max_length=100, description="Diagnoser's name of a signal → the bus's."
    )
    model: Text | None = Field(None, description="model-based: a stored or a built-in model.")
    second: SecondOpinion | None = None
    alarms: AlarmRule | None = None
    maps: dict[Text, Annotated[str, StringConstraints(max_length=2**20)]] = Field(
        {},
        max_length=8,
        description="Texts of the DBC files and register maps that the sources name.",
    )

    def settings(self, asset: str) -> MachineSettings:
        """The settings, as a file would have them; ValueError when they contradict each other."""
        return MachineSettings(asset=asset, **self.model_dump(exclude={"maps"}))
