"""JSON over MQTT as a kind of source."""

from __future__ import annotations

from residuum.service.fieldbus.mqtt.topic_map import read_topic_map
from residuum.service.fieldbus.source import Sink, Source
from residuum.service.fieldbus.source_kind import (
    Address,
    SourceKind,
    broker_look,
    check_broker,
    of_extra,
    text_of_map,
)


def _open(source: Address, sink: Sink) -> Source:
    topics = read_topic_map(source.map_file)
    module = of_extra("residuum.service.fieldbus.mqtt.mqtt_source", "an MQTT source", "mqtt")
    opened: Source = module.MqttSource(topics.entered(source.channel), topics, sink)
    return opened


def _look(source: Address, _seconds: float) -> str:
    """A connection alone: whether messages come shows when the service reads them."""
    topics = read_topic_map(source.map_file)
    says = f"{len(topics.streams)} streams of {', '.join(topics.topics)}"
    return broker_look(source, topics.entered, says)


MQTT = SourceKind(
    called="JSON over MQTT",
    open=_open,
    map_called="topic map (MQTT)",
    asked="Broker of JSON messages, for example mqtt://192.168.0.11.",
    example="mqtt://broker:1883",
    texts={"topics": text_of_map("a map of JSON messages' topics", read_topic_map)},
    check=check_broker,
    look=_look,
    template=(
        '- {kind: mqtt, channel: "mqtt://192.168.0.11", map: topics.yaml}  ',
        "JSON messages; docs: read JSON over MQTT",
    ),
)
