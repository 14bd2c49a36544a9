"""What the births of a Sparkplug edge node name: devices and their metrics that are numbers, with
units where they say them.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Mapping
from itertools import chain, count
from typing import Any

from residuum.service.broker import BrokerAddress
from residuum.service.fieldbus.sparkplug.sparkplug_payload import (
    BOOLEAN,
    BadPayload,
    Metric,
    Payload,
    pack,
    unpack,
)
from residuum.service.fieldbus.sparkplug.sparkplug_source import NAMESPACE, REBIRTH, kind_and_device

# [s] Without a further birth, all have been heard.
_QUIET = 1.0


def numeric_metrics(
    address: BrokerAddress, node: str, timeout: float
) -> dict[str, dict[str, tuple[str, str]]]:
    """Device (empty: the node) → channel → (metric, unit), of a node that was asked to be born
    again; empty without an answer.

    Raises OSError when the broker does not let us in.
    """
    group, name = node.split("/")
    heard: queue.Queue[Any] = queue.Queue()
    client = address.client()
    refused: list[str] = []

    def on_connect(client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            refused.append(str(reason))
            return
        client.subscribe(f"{NAMESPACE}/{group}/+/{name}/#", 1)

    def on_subscribe(client: Any, *_: Any) -> None:
        asked = Payload([Metric(REBIRTH, True, BOOLEAN)], int(time.time() * 1e3))
        client.publish(f"{NAMESPACE}/{group}/NCMD/{name}", pack(asked))

    client.on_connect, client.on_subscribe = on_connect, on_subscribe
    client.on_message = lambda _client, _data, message: heard.put(message)
    client.connect(address.host, address.port)
    client.loop_start()
    try:
        devices = _heard(heard, refused, timeout)
    finally:
        client.disconnect()
        client.loop_stop()
    return devices


def _heard(
    heard: queue.Queue[Any], refused: list[str], timeout: float
) -> dict[str, dict[str, tuple[str, str]]]:
    devices: dict[str, dict[str, tuple[str, str]]] = {}
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        if refused:
            raise ConnectionError(f"the broker refuses the connection: {refused[0]}")
        try:
            message = heard.get(timeout=0.1)
        except queue.Empty:
            continue
        kind, device = kind_and_device(message.topic)
        if kind in ("NBIRTH", "DBIRTH"):
            metrics = _numbers(message.payload)
            # births of devices follow the node's one after the other; how many, nobody says
            devices |= {device: metrics} if metrics else {}
            end = min(end, time.monotonic() + _QUIET)
    return devices


def _numbers(content: bytes) -> dict[str, tuple[str, str]]:
    try:
        metrics = unpack(content).metrics
    except BadPayload:
        return {}
    # data types 1 to 11 are numbers and booleans; bdSeq and Node Control/… belong to Sparkplug, not
    # to a machine
    numeric = [
        m
        for m in metrics
        if 1 <= m.datatype <= BOOLEAN and m.name != "bdSeq" and "Control/" not in m.name
    ]
    return channels_of({m.name: m.unit for m in numeric})


def channels_of(units: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Channel → (metric, unit) of metrics and their units; of metrics whose channels would be the
    same, later ones are numbered.

    >>> channels_of({"Motor/Speed": "rpm", "Motor.Speed": "1/s"})
    {'Motor.Speed': ('Motor/Speed', 'rpm'), 'Motor.Speed-2': ('Motor.Speed', '1/s')}
    """
    channels: dict[str, tuple[str, str]] = {}
    for metric, unit in units.items():
        plain = metric.replace("/", ".").replace(" ", "-")
        names = chain([plain], (f"{plain}-{number}" for number in count(2)))
        channels[next(name for name in names if name not in channels)] = metric, unit
    return channels
