"""Notifications: what the store announces, told to webhooks and an MQTT broker; nobody waits for them.

Alarms go to both, findings to the broker alone (QoS 1, topics `PREFIX/assets/ASSET/alarm` and `…/finding`). Each receiver has a
queue of its own; one that is away is tried again with growing pauses, and what finds no room in its queue is dropped and
counted. The queues are in memory: what they hold at a crash is not told; the alarm list and the audit trail have it.
"""

from __future__ import annotations

import importlib
import queue
import threading
import urllib.request
from collections.abc import Callable, Mapping, Sequence
from typing import Any
from urllib.error import HTTPError
from urllib.parse import urlsplit

import orjson
import structlog

from residuum.identification.errors import BadInput
from residuum.service.fieldbus.backoff import Backoff
from residuum.service.settings import BrokerAddress, Settings, broker_address

log = structlog.get_logger()

_MOST_WAITING = 1000
_PATIENCE = 5.0
"""Seconds for a receiver's answer."""
_REFUSED = range(400, 500)

Send = Callable[[str, Mapping[str, Any]], None]
"""Delivers (kind, payload); raises OSError when it could not be delivered."""


class Receiver:
    """One receiver with its queue and thread.

    Parameters
    ----------
    name : str
        For the log; without passwords.
    kinds : sequence of str
        What it is told.
    send : callable
    """

    def __init__(self, name: str, kinds: Sequence[str], send: Send) -> None:
        self.name, self.kinds = name, kinds
        self.sent = self.dropped = 0
        self._send = send
        self._waiting: queue.Queue[tuple[str, Mapping[str, Any]]] = queue.Queue(_MOST_WAITING)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._deliver_all, name=f"notify {name}", daemon=True)
        self._thread.start()

    def tell(self, kind: str, payload: Mapping[str, Any]) -> None:
        """Queue it; dropped and counted when there is no room."""
        try:
            self._waiting.put_nowait((kind, payload))
        except queue.Full:
            self.dropped += 1

    def stop(self) -> None:
        """End; what still waits is not told."""
        self._stopped.set()
        self._thread.join(_PATIENCE)

    def _deliver_all(self) -> None:
        backoff = Backoff(first=0.2, longest=30.0)
        while not self._stopped.is_set():
            try:
                kind, payload = self._waiting.get(timeout=0.2)
            except queue.Empty:
                continue
            while not self._stopped.is_set():
                try:
                    self._send(kind, payload)
                except HTTPError as error:
                    if error.code in _REFUSED:  # it will not like it better the next time
                        self.dropped += 1
                        log.warning("a receiver refused a notification", receiver=self.name, status=error.code)
                        break
                    self._stopped.wait(backoff.next())
                except OSError as error:
                    log.warning("a receiver does not answer", receiver=self.name, reason=str(error))
                    self._stopped.wait(backoff.next())
                else:
                    self.sent += 1
                    backoff.reset()
                    break


class Notifications:
    """All receivers of the settings."""

    def __init__(self, settings: Settings) -> None:
        self.receivers = [Receiver(_without_secrets(str(url)), ("alarm",), _webhook(str(url))) for url in settings.webhooks]
        if settings.mqtt:
            address = broker_address(settings.mqtt)
            self.receivers.append(Receiver(f"mqtt://{address.host}:{address.port}", ("alarm", "finding"), Broker(address)))

    def tell(self, kind: str, payload: Mapping[str, Any]) -> None:
        """Tell all who want to know this kind."""
        for receiver in self.receivers:
            if kind in receiver.kinds:
                receiver.tell(kind, payload)

    def stop(self) -> None:
        """End all receivers."""
        for receiver in self.receivers:
            receiver.stop()


def _webhook(url: str) -> Send:
    def post(kind: str, payload: Mapping[str, Any]) -> None:
        body = orjson.dumps({"kind": kind, **payload}, option=orjson.OPT_SERIALIZE_NUMPY)
        request = urllib.request.Request(url, body, {"Content-Type": "application/json", "User-Agent": "residuum"})
        with urllib.request.urlopen(request, timeout=_PATIENCE):
            """Any 2xx answer is a receipt."""

    return post


class Broker:
    """Publishes with QoS 1 over one connection, which is made when it is needed and again after it broke."""

    def __init__(self, address: BrokerAddress) -> None:
        try:
            self._mqtt: Any = importlib.import_module("paho.mqtt.client")
        except ImportError:
            raise BadInput("setting mqtt: needs the extra 'mqtt'") from None
        self._address = address
        self._client: Any = None

    def __call__(self, kind: str, payload: Mapping[str, Any]) -> None:
        """Publish and wait for the broker's receipt; OSError without one."""
        topic = f"{self._address.prefix}/assets/{payload['asset']}/{kind}"
        try:
            if self._client is None or not self._client.is_connected():
                self._connect()
            told = self._client.publish(topic, orjson.dumps(payload, option=orjson.OPT_SERIALIZE_NUMPY), qos=1)
            told.wait_for_publish(_PATIENCE)
            if not told.is_published():
                raise TimeoutError("the broker gave no receipt")
        except (RuntimeError, ValueError) as error:
            raise ConnectionError(str(error)) from error

    def _connect(self) -> None:
        if self._client is not None:
            self._client.loop_stop()
        self._client = self._mqtt.Client(self._mqtt.CallbackAPIVersion.VERSION2)
        if self._address.user:
            self._client.username_pw_set(self._address.user, self._address.password)
        answered = threading.Event()
        self._client.on_connect = lambda *_: answered.set()
        self._client.connect(self._address.host, self._address.port)
        self._client.loop_start()
        if not answered.wait(_PATIENCE) or not self._client.is_connected():
            raise ConnectionError("the broker did not take the connection")


def _without_secrets(url: str) -> str:
    """A webhook's address often carries its secret in user, path or query: the log gets the host."""
    parts = urlsplit(url)
    return f"{parts.scheme}://{parts.hostname}"
