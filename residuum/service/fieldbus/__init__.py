"""Sources of measured signals: CAN, Modbus, OPC UA, Sparkplug B over MQTT.

A new kind of source is one file with a `Source` and one line in `SOURCES`.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from residuum.service.fieldbus.can.can_source import CanSource
from residuum.service.fieldbus.can.frame_layout import BadBusDescription, read_dbc
from residuum.service.fieldbus.modbus.modbus_source import ModbusSource
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.fieldbus.opcua.node_map import read_node_map
from residuum.service.fieldbus.settings import SourceSettings
from residuum.service.fieldbus.source import Sink, Source
from residuum.service.fieldbus.sparkplug.metric_map import read_metric_map

Open = Callable[[SourceSettings, Sink], Source]


def _opcua(settings: SourceSettings, sink: Sink) -> Source:
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


def _sparkplug(settings: SourceSettings, sink: Sink) -> Source:
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


SOURCES: dict[str, Open] = {
    "can": lambda settings, sink: CanSource(settings.channel, read_dbc(settings.map_file), sink),
    "opcua": _opcua,
    "sparkplug": _sparkplug,
    "modbus": lambda settings, sink: ModbusSource(
        settings.host, settings.port, read_register_map(settings.map_file), sink
    ),
}
"""Kind of source → how to open it."""
