"""FindingMetrics: the latest finding and alarm of every machine as metrics of a Sparkplug B edge
node of our own.

A machine `press-1` is the device `press-1` with the metrics `verdict`, `class`, `reason`,
`indicator/NAME` and, once it has had one, `alarm`. Nothing is written back: the only command that
is answered asks for the births.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from typing import Any

from residuum.service.broker import BrokerAddress
from residuum.service.fieldbus.sparkplug.sparkplug_payload import (
    BOOLEAN,
    DOUBLE,
    INT64,
    STRING,
    UINT64,
    BadPayload,
    Metric,
    Payload,
    pack,
    unpack,
)
from residuum.service.fieldbus.sparkplug.sparkplug_source import NAMESPACE, REBIRTH


class FindingMetrics:
    """Publishes while the broker is there; what it missed, the births of the next connection say.

    Parameters
    ----------
    address : BrokerAddress
    node : str
        `GROUP/NODE`.
    """

    def __init__(self, address: BrokerAddress, node: str) -> None:
        self._node = EdgeNode(address, node)

    def start(self) -> None:
        """Connect, now or when the broker is there."""
        self._node.start()

    def stop(self) -> None:
        """Tell the node's death and leave."""
        self._node.stop()

    def tell(self, kind: str, payload: Mapping[str, Any]) -> None:
        """A finding or an alarm that has been stored; anything else is left."""
        if kind == "alarm":
            self._node.write(str(payload["asset"]), {"alarm": str(payload["state"])}, time.time())
        elif kind == "finding":
            texts = {name: str(payload.get(name) or "") for name in ("verdict", "class", "reason")}
            numbers = {
                f"indicator/{name}": float(value)
                for name, value in (payload.get("indicators") or {}).items()
                if isinstance(value, int | float)
            }
            at = payload["at"]
            self._node.write(
                str(payload["asset"]),
                texts | numbers,
                at.timestamp() if isinstance(at, datetime) else time.time(),
            )


# EdgeNode: births, data and death of a Sparkplug B edge node on an MQTT broker.

# Sequence and birth numbers of Sparkplug count modulo this.
_TURN = 256
# [s] For the broker's receipt of the death when the service ends.
_PATIENCE = 5.0


class EdgeNode:
    """Publishes metrics of devices; safe to use from any thread.

    Births name the metrics and give each an alias; data go by the alias. A host that asks (`Node
    Control/Rebirth`) gets the births anew. The broker tells the death when the connection breaks;
    `stop` tells it itself.

    Parameters
    ----------
    address : BrokerAddress
    node : str
        `GROUP/NODE`.
    """

    def __init__(self, address: BrokerAddress, node: str) -> None:
        self._address = address
        self._group, self._node = node.split("/")
        self._lock = threading.RLock()
        self._devices: dict[str, dict[str, Metric]] = {}
        self._aliases: dict[tuple[str, str], int] = {}
        self._born, self._seq = False, 0
        # not from 0 on: a node that was restarted should not have the number of its earlier birth
        self._birth_number = int(time.time()) % _TURN
        self._client = address.client()
        # Bounded by seconds: paho's own two minutes would leave a control room without findings for
        # as long.
        self._client.reconnect_delay_set(1, 5)
        self._client.on_connect, self._client.on_disconnect = self._on_connect, self._on_disconnect
        self._client.on_message = self._on_command
        self._write_will()

    def start(self) -> None:
        """Connect, and again after each break."""
        self._client.connect_async(self._address.host, self._address.port, keepalive=20)
        self._client.loop_start()

    def stop(self) -> None:
        """Tell the death and leave."""
        with self._lock:
            if self._born:
                death = self._client.publish(self._topic("NDEATH"), self._death(), qos=1)
                self._born = False
                with suppress(RuntimeError, ValueError):
                    # A client that leaves in good order has no will: without this message hosts
                    # would take its last values for present ones.
                    death.wait_for_publish(_PATIENCE)
        self._client.disconnect()
        self._client.loop_stop()

    def write(self, device: str, values: Mapping[str, Any], stamp: float) -> None:
        """Values of a device at a time [s since 1970]; names that are new make it born again."""
        at = int(stamp * 1e3)
        with self._lock:
            known = self._devices.setdefault(device, {})
            fresh = [name for name in values if name not in known]
            for name, value in values.items():
                alias = self._aliases.setdefault((device, name), len(self._aliases) + 1)
                known[name] = Metric(name, value, _datatype(value), alias, at)
            # Kept all the same: the birth of the next connection tells it.
            if not self._born:
                return
            if fresh:
                self._send("DBIRTH", list(known.values()), device)
            else:
                changed = [known[name] for name in values]
                self._send(
                    "DDATA",
                    [Metric("", m.value, m.datatype, m.alias, m.stamp) for m in changed],
                    device,
                )

    def _send(self, kind: str, metrics: list[Metric], device: str = "") -> None:
        payload = Payload(metrics, _now(), self._seq)
        self._seq = (self._seq + 1) % _TURN
        self._client.publish(self._topic(kind, device), pack(payload))

    def _be_born(self) -> None:
        with self._lock:
            # A birth of the node begins the sequence at 0 (Sparkplug 3.0).
            self._seq, self._born = 0, True
            now = _now()
            own = [
                Metric("bdSeq", self._birth_number, INT64, stamp=now),
                Metric(REBIRTH, False, BOOLEAN, stamp=now),
            ]
            self._send("NBIRTH", own)
            for device, known in self._devices.items():
                self._send("DBIRTH", list(known.values()), device)

    def _on_connect(
        self, client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any
    ) -> None:
        if not reason.is_failure:
            client.subscribe(self._topic("NCMD"), 1)
            self._be_born()

    def _on_disconnect(self, *_: Any) -> None:
        with self._lock:
            self._born = False
            # the will is given to the broker with the next connection: it has to know its number
            # now
            self._birth_number = (self._birth_number + 1) % _TURN
            self._write_will()

    def _on_command(self, _client: Any, _data: Any, message: Any) -> None:
        with suppress(BadPayload):
            if any(
                metric.name == REBIRTH and metric.value is True
                for metric in unpack(message.payload).metrics
            ):
                self._be_born()

    def _write_will(self) -> None:
        self._client.will_set(self._topic("NDEATH"), self._death(), qos=1)

    def _death(self) -> bytes:
        return pack(Payload([Metric("bdSeq", self._birth_number, INT64)], _now()))

    def _topic(self, kind: str, device: str = "") -> str:
        return "/".join((NAMESPACE, self._group, kind, self._node, *([device] if device else [])))


def _datatype(value: Any) -> int:
    # bool before int, of which it is one in Python
    if isinstance(value, bool):
        return BOOLEAN
    if isinstance(value, str):
        return STRING
    if isinstance(value, int):
        return UINT64 if value >= 0 else INT64
    return DOUBLE


def _now() -> int:
    return int(time.time() * 1e3)
