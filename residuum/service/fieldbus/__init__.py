"""Sources of measured signals: CAN, Modbus, OPC UA, Sparkplug B and JSON over MQTT, growing files.

A new kind of source is one file with a `Source` and its `SourceKind`, and one line in `SOURCES`;
settings, commands, the HTTP interface with its page, and
`tests/service/fieldbus/test_source_conformance.py` take all that they know of kinds from there.
"""

from __future__ import annotations

from residuum.service.fieldbus.can.can_kind import CAN
from residuum.service.fieldbus.growing_file import FILE
from residuum.service.fieldbus.modbus.modbus_kind import MODBUS
from residuum.service.fieldbus.mqtt.mqtt_kind import MQTT
from residuum.service.fieldbus.opcua.opcua_kind import OPCUA
from residuum.service.fieldbus.source_kind import SourceKind
from residuum.service.fieldbus.sparkplug.sparkplug_kind import SPARKPLUG

SOURCES: dict[str, SourceKind] = {
    "can": CAN,
    "modbus": MODBUS,
    "opcua": OPCUA,
    "sparkplug": SPARKPLUG,
    "mqtt": MQTT,
    "file": FILE,
}
"""Name of a kind of source → the kind; it opens one when it is called."""
TEXTS = {text: name for name, kind in SOURCES.items() for text in kind.texts}
"""Kind of a text that describes what is read → kind of the sources that are read by it."""
