"""Machines that were added while the service ran: kept in the store, each with the bus descriptions that it needs."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import orjson
import structlog
from pydantic import ValidationError

from residuum.identification.errors import BadInput
from residuum.service.fieldbus.settings import MAPS, MachineSettings
from residuum.service.store import Conflict, NotFound, Store

log = structlog.get_logger()

KIND = "machine"
ENDINGS = (f".{KIND}", ".method", ".limits")
"""What the names of a machine's documents end in: no model is given such a name."""
_LONGEST = 55
"""Characters of an asset's name; with an ending it must still be a document's."""
_PLAIN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


def document_name(asset: str) -> str:
    """The name under which a machine's document is kept; Conflict for a name that is too long."""
    if len(asset) > _LONGEST:
        raise Conflict(f"machine {asset!r}: its name is longer than {_LONGEST} characters")
    return f"{asset}.{KIND}"


def keep_machine(store: Store, machine: MachineSettings, maps: Mapping[str, str], by: str) -> None:
    """Keep a machine's settings with the texts of the bus descriptions that its sources name."""
    content = orjson.dumps({"machine": machine.model_dump(mode="json"), "maps": dict(maps)})
    store.add_model_version(document_name(machine.asset), KIND, content, "settings", by)


def forget_machine(store: Store, asset: str, by: str) -> None:
    """Note that a machine is watched no more."""
    store.add_model_version(document_name(asset), KIND, orjson.dumps({"machine": None}), "removed", by)


def kept_document(store: Store, name: str) -> Any:
    """The newest version of a machine's document; None where there is none, also where a model has that name."""
    try:
        newest = store.model_versions(name)[0]
    except NotFound:
        return None
    return orjson.loads(store.model_content(name, newest.number)) if newest.kind == KIND else None


def kept_maps(store: Store, asset: str) -> Mapping[str, str]:
    """The bus descriptions that are kept with a machine; none for one that is not kept."""
    return dict((kept_document(store, f"{asset}.{KIND}") or {}).get("maps", {}))


def kept_machines(store: Store, data: Path) -> Sequence[MachineSettings]:
    """All machines that are kept, their bus descriptions as files below the data folder."""
    found: list[MachineSettings] = []
    cursor = None
    while True:
        page = store.models(KIND, cursor)
        for version in page.items:
            if not version.model.endswith(f".{KIND}"):
                continue
            try:
                document = orjson.loads(store.model_content(version.model))
                if document["machine"] is not None:
                    found.append(with_map_files(MachineSettings(**document["machine"]), document["maps"], data))
            except (ValidationError, BadInput, KeyError, TypeError, orjson.JSONDecodeError) as error:
                log.error("a kept machine cannot be read", document=version.model, reason=str(error))
        cursor = page.next_cursor
        if cursor is None:
            return found


def with_map_files(machine: MachineSettings, maps: Mapping[str, str], data: Path) -> MachineSettings:
    """The settings with the files that hold the bus descriptions in place of their names.

    BadInput for a name that is neither among `maps` nor one that comes with Residuum: other files of this computer are
    not read for who adds a machine.
    """
    sources = [{**source.model_dump(), "map": _file(source.map, maps, data)} for source in machine.sources]
    return MachineSettings(**{**machine.model_dump(), "sources": sources})


def _file(name: str, maps: Mapping[str, Any], data: Path) -> str:
    if _PLAIN_NAME.fullmatch(name) is None:
        raise BadInput(f"map {name[:60]!r}: must be a plain file name of letters, digits, '.', '_' and '-'")
    if name not in maps:
        if not (MAPS / name).is_file():
            raise BadInput(f"map {name!r}: is not among the bus descriptions that were sent, and none comes with Residuum")
        return name
    text = str(maps[name]).encode()
    folder = data / "maps" / hashlib.sha256(text).hexdigest()[:24]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(text)
    return str((folder / name).resolve())
