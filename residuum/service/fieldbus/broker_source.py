"""BrokerSource: messages that a broker publishes, taken from a queue in the source's own thread."""

from __future__ import annotations

import queue
import sys
import threading
import time
from abc import abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import paho.mqtt.client as mqtt

from residuum.service.broker import BrokerAddress
from residuum.service.fieldbus.source import Sink, Source

# [s] For which a message is waited for before samples are handed on.
_TICK = 0.05
# [s] After which the client asks a silent broker whether it is there.
_KEEP_ALIVE = 20
CONNECTED, LOST = "connected", "lost"
# Messages that wait, and that are taken in one turn.
MOST_WAITING, _A_TURN = 10_000, 1000


class Arrived(NamedTuple):
    """A message: its topic, what it says, when it came [s, monotonic], and whether the broker had
    kept it.
    """

    topic: str
    content: bytes
    now: float
    retained: bool = False


class BrokerSource(Source):
    """A source that subscribes to topics of a broker.

    `CONNECTED` and `LOST` are topics of messages, too: they stand in the queue where the connection
    was made or lost.

    Parameters
    ----------
    name : str
    address : BrokerAddress
        Its prefix is not used.
    topics : sequence of str
        What is subscribed to, at QoS 1; `+` and `#` are wildcards.
    says : str
        What messages come of, for the trouble of those without room.
    sink : callable
    """

    def __init__(
        self, name: str, address: BrokerAddress, topics: Sequence[str], says: str, sink: Sink
    ) -> None:
        super().__init__(name, sink)
        self._address, self._topics, self._says = address, topics, says
        self._arrived: queue.Queue[Arrived] = queue.Queue(MOST_WAITING)
        self._connected, self._overflown = threading.Event(), threading.Event()
        self._opened_before = False

    def _run(self) -> None:
        client = self._client()
        try:
            while not self._stopped.is_set():
                self._take_what_arrived()
                self._turn(client, time.monotonic())
        finally:
            client.disconnect()
            client.loop_stop()

    @abstractmethod
    def _turn(self, client: mqtt.Client, now: float) -> None:
        """What is done after the messages of a turn: samples are handed on."""

    @abstractmethod
    def _take(self, message: Arrived) -> None:
        """Take a message."""

    def _broken_off(self) -> None:
        """Messages without room were dropped, and those that waited with them."""

    def _client(self) -> mqtt.Client:
        client: mqtt.Client = self._address.client()
        client.reconnect_delay_set(1, 5)
        client.on_connect, client.on_connect_fail = self._on_connect, self._on_connect_fail
        client.on_subscribe, client.on_disconnect = self._on_subscribe, self._on_disconnect
        client.on_message = lambda _client, _data, message: self._wait(
            message.topic, bytes(message.payload), bool(message.retain)
        )
        client.connect_async(self._address.host, self._address.port, keepalive=_KEEP_ALIVE)
        client.loop_start()
        return client

    def _on_connect(
        self, client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any
    ) -> None:
        if reason.is_failure:
            self.health.count("bus_errors", 1, f"the broker refuses the connection: {reason}")
            return
        client.subscribe([(topic, 1) for topic in self._topics])

    def _on_connect_fail(self, *_: Any) -> None:
        self.health.count("bus_errors", 1, f"the broker does not let us in: {sys.exception()}")

    def _on_subscribe(
        self, _client: Any, _data: Any, _mid: Any, reasons: Sequence[Any], _properties: Any
    ) -> None:
        for topic, reason in zip(self._topics, reasons, strict=False):
            if reason.is_failure:
                self.health.count("bus_errors", 1, f"the broker refuses topic {topic!r}: {reason}")
        if self._opened_before:
            self.health.count("reconnects")
        self._opened_before = True
        self._connected.set()
        self._wait(CONNECTED, b"")

    def _on_disconnect(self, *_: Any) -> None:
        self._connected.clear()
        self._wait(LOST, b"")

    def _wait(self, topic: str, content: bytes, retained: bool = False) -> None:
        """In the network thread, which never waits: a message without room is dropped."""
        try:
            self._arrived.put_nowait(Arrived(topic, content, time.monotonic(), retained))
        except queue.Full:
            self.health.count(
                "overflow", 1, f"{self._says}: messages come faster than they are read"
            )
            self._overflown.set()

    def _take_what_arrived(self) -> None:
        """What waits, up to a turn's share; for a tick when nothing does."""
        if self._overflown.is_set():
            self._let_go_after_overflow()
        with suppress(queue.Empty):
            self._take(self._arrived.get(timeout=_TICK))
            for _ in range(_A_TURN - 1):
                self._take(self._arrived.get_nowait())

    def _let_go_after_overflow(self) -> None:
        """What waits has a hole behind it: it goes."""
        self._overflown.clear()
        with suppress(queue.Empty):
            for _ in range(self._arrived.maxsize):
                self._arrived.get_nowait()
                self.health.count("overflow")
        self._broken_off()
