"""Sources of measured signals: CAN, Modbus.

A new kind of source is one file with a `Source` and one line in `SOURCES`.
"""

from __future__ import annotations

from collections.abc import Callable

from residuum.service.fieldbus.can import CanSource
from residuum.service.fieldbus.frame_layout import read_dbc
from residuum.service.fieldbus.modbus import ModbusSource
from residuum.service.fieldbus.register_map import read_register_map
from residuum.service.fieldbus.settings import SourceSettings
from residuum.service.fieldbus.source import Sink, Source

Open = Callable[[SourceSettings, Sink], Source]

SOURCES: dict[str, Open] = {
    "can": lambda settings, sink: CanSource(settings.channel, read_dbc(settings.map_file), sink),
    "modbus": lambda settings, sink: ModbusSource(settings.host, settings.port, read_register_map(settings.map_file), sink),
}
"""Kind of source → how to open it."""
