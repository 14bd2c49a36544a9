"""The DBC files that a service knows: those of its machines, and those that come with Residuum."""

from __future__ import annotations

from pathlib import Path

from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names
from residuum.service.fieldbus.settings import MAPS
from residuum.service.machines.adding.kept_machines import kept_machines
from residuum.service.settings import Settings
from residuum.service.store import Store


def known_dbc(settings: Settings, store: Store, name: str) -> Path:
    """The DBC file of this name; BadInput names those that are known. No other file of the computer can be asked for."""
    machines = [*settings.machines, *kept_machines(store, settings.data)]
    files = [source.map_file for machine in machines for source in machine.sources if source.kind == "can"]
    known = {file.name: file for file in [*sorted(MAPS.glob("*.dbc")), *files]}
    if name not in known:
        raise BadInput(f"dbc {name[:60]!r}: no machine has a DBC file of this name; {known_names(name, known)}")
    return known[name]
