"""Sparkplug B over MQTT as a kind of source."""

from __future__ import annotations

from residuum.service.fieldbus.source import Sink, Source
from residuum.service.fieldbus.source_kind import (
    Address,
    SourceKind,
    broker_look,
    check_broker,
    of_extra,
    text_of_map,
)
from residuum.service.fieldbus.sparkplug.metric_map import read_metric_map


def _open(source: Address, sink: Sink) -> Source:
    metrics = read_metric_map(source.map_file)
    place = "residuum.service.fieldbus.sparkplug.sparkplug_source"
    module = of_extra(place, "a Sparkplug source", "sparkplug")
    opened: Source = module.SparkplugSource(metrics.entered(source.channel), metrics, sink)
    return opened


def _look(source: Address, _seconds: float) -> str:
    metrics = read_metric_map(source.map_file)
    says = f"{len(metrics.streams)} streams of {metrics.node}"
    return broker_look(source, metrics.entered, says)


SPARKPLUG = SourceKind(
    called="Sparkplug B",
    open=_open,
    map_called="metric map (Sparkplug)",
    asked="Broker of a Sparkplug B node, for example mqtt://192.168.0.11.",
    example="mqtt://broker:1883",
    texts={"metrics": text_of_map("a map of Sparkplug's metrics", read_metric_map)},
    check=check_broker,
    look=_look,
    template=(
        '- {kind: sparkplug, channel: "mqtt://192.168.0.11", map: metrics.yaml}  ',
        "map: `residuum sparkplug browse`",
    ),
)
