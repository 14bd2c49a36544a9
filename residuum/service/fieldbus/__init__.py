"""Sources of measured signals: CAN, Modbus, OPC UA, Sparkplug B and JSON over MQTT, growing
files.

A new kind of source is one file with a `Source` and one line in `SOURCES`; settings, the HTTP
interface and `tests/service/fieldbus/test_source_conformance.py` take the kinds from there.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Protocol

from residuum.service.fieldbus.can.can_source import CanSource
from residuum.service.fieldbus.can.frame_layout import BadBusDescription, read_dbc
from residuum.service.fieldbus.growing_file import growing_file_source, read_column_map
from residuum.service.fieldbus.modbus.modbus_source import ModbusSource
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.fieldbus.mqtt.topic_map import read_topic_map
from residuum.service.fieldbus.opcua.node_map import read_node_map
from residuum.service.fieldbus.source import Sink, Source
from residuum.service.fieldbus.sparkplug.metric_map import read_metric_map


class Address(Protocol):
    """How a source is reached: `SourceSettings`, which takes its kinds from `SOURCES`."""

    @property
    def channel(self) -> str:
        """Address of the bus."""

    @property
    def host(self) -> str:
        """Address of the device."""

    @property
    def port(self) -> int:
        """Port of the device."""

    @property
    def map_file(self) -> Path:
        """What says which channels there are."""


Open = Callable[[Address, Sink], Source]


def _opcua(settings: Address, sink: Sink) -> Source:
    """Imported when it is opened: the library is an extra."""
    nodes = read_node_map(settings.map_file)
    try:
        source: Source = import_module("residuum.service.fieldbus.opcua.opcua_source").OpcuaSource(
            settings.channel, nodes, sink
        )
    except ModuleNotFoundError:
        raise BadBusDescription(
            "an OPC UA source needs the extra `opcua`: pip install 'residuum[opcua]'"
        ) from None
    return source


def _sparkplug(settings: Address, sink: Sink) -> Source:
    """Imported when it is opened: the libraries are an extra."""
    metrics = read_metric_map(settings.map_file)
    try:
        module = import_module("residuum.service.fieldbus.sparkplug.sparkplug_source")
    except ModuleNotFoundError:
        raise BadBusDescription(
            "a Sparkplug source needs the extra `sparkplug`: pip install 'residuum[sparkplug]'"
        ) from None
    source: Source = module.SparkplugSource(metrics.entered(settings.channel), metrics, sink)
    return source


def _mqtt(settings: Address, sink: Sink) -> Source:
    """Imported when it is opened: the library is an extra."""
    topics = read_topic_map(settings.map_file)
    try:
        module = import_module("residuum.service.fieldbus.mqtt.mqtt_source")
    except ModuleNotFoundError:
        raise BadBusDescription(
            "an MQTT source needs the extra `mqtt`: pip install 'residuum[mqtt]'"
        ) from None
    source: Source = module.MqttSource(topics.entered(settings.channel), topics, sink)
    return source


SOURCES: dict[str, Open] = {
    "can": lambda settings, sink: CanSource(settings.channel, read_dbc(settings.map_file), sink),
    "modbus": lambda settings, sink: ModbusSource(
        settings.host, settings.port, read_register_map(settings.map_file), sink
    ),
    "opcua": _opcua,
    "sparkplug": _sparkplug,
    "mqtt": _mqtt,
    "file": lambda settings, sink: growing_file_source(
        settings.channel, read_column_map(settings.map_file), sink
    ),
}
"""Kind of source → how to open it."""
