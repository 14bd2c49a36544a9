"""Notifications: changes of alarms and findings, told to webhooks and an MQTT broker; nobody waits
for them.

Alarms and floods of them go to both, findings to the broker alone (QoS 1, topics
`PREFIX/assets/ASSET/alarm`, `…/finding`, and `PREFIX/flood`). A receiver that is away is tried
again with growing pauses. Both come from the store's outbox, in their order and at least once, also
after a crash, and also those of other processes on the same database. What waits is bounded: the
oldest go, and the log says how many.
"""

from __future__ import annotations

import threading
import time
import urllib.request
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any
from urllib.error import HTTPError
from urllib.parse import urlsplit

import orjson
import structlog

from residuum.service.broker import BrokerAddress, connected_client, try_connection
from residuum.service.fieldbus.source import Backoff
from residuum.service.settings import Settings
from residuum.service.storage.outbox import Outbox
from residuum.service.storage.rows.alarm_floods import FLOOD
from residuum.service.store import StorageUnavailable

log = structlog.get_logger()

# Seconds between looks for what other processes on the same database changed. Changes of this
# process are told at once; only what others wrote is waited for.
_LOOK = 1.0
# Seconds for a receiver's answer, and after which the outbox is told which findings of a batch were
# told.
_PATIENCE = 5.0
# HTTP statuses that say that the request itself is wrong: sent again it would be, too.
_REFUSED = range(400, 500)

Send = Callable[[str, Mapping[str, Any]], None]
"""Delivers (kind of event, payload); raises OSError when it could not be delivered."""


class Receiver:
    """One receiver with its thread.

    Parameters
    ----------
    name : str
        For the log; without passwords.
    address : str
        The whole address, by which the outbox knows it.
    send : callable
    findings : bool
        Whether it is told findings, too.
    """

    def __init__(self, name: str, address: str, send: Send, *, findings: bool) -> None:
        self.name = name
        self.sent = self.dropped = 0
        self._address, self._send, self._findings = address, send, findings
        self._news = threading.Event()
        self._stopped = threading.Event()
        self._backoff = Backoff(first=0.2, longest=30.0)
        self._thread = threading.Thread(
            target=self._deliver_all, name=f"notify {name}", daemon=True
        )

    def start(self, outbox: Outbox) -> None:
        """Begin to tell what waits in the outbox."""
        self._outbox, self._id = outbox, outbox.register(self._address, findings=self._findings)
        self._thread.start()

    def look(self) -> None:
        """Something new may wait in the outbox."""
        self._news.set()

    def stop(self) -> None:
        """End; what still waits is told by whoever opens the store next."""
        self._stopped.set()
        self._news.set()
        if self._thread.ident is not None:
            self._thread.join(_PATIENCE)

    def _deliver_all(self) -> None:
        while not self._stopped.is_set():
            # before the look: news that come while it lasts are looked for in the next turn
            self._news.clear()
            try:
                self._tell_of_alarms()
                told_all = not self._findings or self._tell_of_findings()
            except Exception as error:  # the store may come back
                log.error("what waits to be told not read", receiver=self.name, reason=str(error))
                self._stopped.wait(self._backoff.next())
                continue
            if told_all:
                self._news.wait(_LOOK)

    def _tell_of_alarms(self) -> None:
        while not self._stopped.is_set() and (notice := self._outbox.next(self._id)) is not None:
            if notice.alarm is None:
                self.dropped += 1
                log.error(
                    "a change of an alarm is damaged and told to nobody: see the alarms",
                    receiver=self.name,
                )
            elif not self._attempt(_kind_of(notice.alarm), notice.alarm):
                continue
            self._lost("alarm", notice.passed_over)
            # noted after it was delivered: after a crash in between it is told twice, not never
            self._outbox.told(self._id, notice)

    def _tell_of_findings(self) -> bool:
        """Tell a batch of what waits; False when more may wait."""
        batch = self._outbox.findings(self._id)
        until, sent = time.monotonic() + _PATIENCE, []
        # in order: behind one that is not delivered, the others wait
        for finding in batch.findings:
            if (
                self._stopped.is_set()
                or time.monotonic() > until
                or not self._attempt("finding", finding.to_json())
            ):
                break
            sent.append(finding.id)
        if sent or batch.lost:
            self._lost("finding", batch.lost)
            self._outbox.told_findings(self._id, sent, batch.lost)
        return not batch.findings

    def _lost(self, kind: str, count: int) -> None:
        if count:
            self.dropped += count
            log.warning(
                "the oldest that waited were let go untold",
                receiver=self.name,
                kind=kind,
                count=count,
            )

    def _attempt(self, kind: str, payload: Mapping[str, Any]) -> bool:
        """Whether the receiver has it, or refused it for good; a pause after an attempt that
        failed.
        """
        try:
            self._send(kind, payload)
        except HTTPError as error:
            if error.code in _REFUSED:  # it will not like it better the next time
                self.dropped += 1
                log.warning(
                    "a receiver refused a notification", receiver=self.name, status=error.code
                )
                return True
            log.warning("a receiver gives no receipt", receiver=self.name, status=error.code)
            self._stopped.wait(self._backoff.next())
        except OSError as error:
            log.warning("a receiver does not answer", receiver=self.name, reason=str(error))
            self._stopped.wait(self._backoff.next())
        else:
            self.sent += 1
            self._backoff.reset()
            return True
        return False


def _kind_of(notice: Mapping[str, Any]) -> str:
    """`flood` of a notice of one, else `alarm`."""
    return FLOOD if notice["kind"] == FLOOD else "alarm"


class Notifications:
    """All receivers of the settings."""

    def __init__(self, settings: Settings) -> None:
        urls = map(str, settings.webhooks)
        self.receivers = [
            Receiver(_without_secrets(url), url, _webhook(url), findings=False) for url in urls
        ]
        if settings.mqtt:
            address = settings.broker
            name = f"{'mqtt' if address.tls is None else 'mqtts'}://{address.host}:{address.port}"
            self.receivers.append(Receiver(name, settings.mqtt, Broker(address), findings=True))

    def start(self, outbox: Outbox) -> None:
        """Begin to tell; nothing is told before."""
        self._outbox = outbox
        for receiver in self.receivers:
            receiver.start(outbox)

    def tell(self, kind: str, _payload: Mapping[str, Any]) -> None:
        """A finding or a change of an alarm waits in the outbox."""
        if kind in ("finding", "alarm"):
            for receiver in self.receivers:
                receiver.look()

    def stop(self) -> None:
        """End all receivers."""
        for receiver in self.receivers:
            receiver.stop()
        if self.receivers:
            with suppress(StorageUnavailable):
                self._outbox.release()


class _NoDetour(urllib.request.HTTPRedirectHandler):
    """Follows nobody elsewhere: a notification would be asked for there, without its body, and the
    answer taken for a receipt.
    """

    def redirect_request(self, *_asked: Any, **_named: Any) -> None:
        """Nowhere: the answer becomes an HTTPError, as every other that is no receipt."""


_DIRECT = urllib.request.build_opener(_NoDetour)


def _webhook(url: str) -> Send:
    def post(kind: str, payload: Mapping[str, Any]) -> None:
        body = orjson.dumps({"event": kind, **payload}, option=orjson.OPT_SERIALIZE_NUMPY)
        request = urllib.request.Request(
            url, body, {"Content-Type": "application/json", "User-Agent": "residuum"}
        )
        with _DIRECT.open(request, timeout=_PATIENCE):
            """Any 2xx answer is a receipt."""

    return post


class Broker:
    """Publishes with QoS 1 over one connection, which is made when it is needed and again after it
    broke.
    """

    def __init__(self, address: BrokerAddress) -> None:
        address.client()  # what is wrong with it is told at the start
        self._address = address
        self._client: Any = None

    def __call__(self, kind: str, payload: Mapping[str, Any]) -> None:
        """Publish and wait for the broker's receipt; OSError without one."""
        place = f"assets/{payload['asset']}/{kind}" if "asset" in payload else kind
        topic = f"{self._address.prefix}/{place}"
        try:
            if self._client is None or not self._client.is_connected():
                self._connect()
            message = self._client.publish(
                topic, orjson.dumps(payload, option=orjson.OPT_SERIALIZE_NUMPY), qos=1
            )
            message.wait_for_publish(_PATIENCE)
            if not message.is_published():
                raise TimeoutError("the broker gave no receipt")
        except (RuntimeError, ValueError) as error:
            raise ConnectionError(str(error)) from error

    def try_connection(self) -> None:
        """Connect, as whoever the address names, and leave again; OSError when the broker does not
        let us in.
        """
        try_connection(self._address)

    def _connect(self) -> None:
        if self._client is not None:
            self._client.loop_stop()
        # a new client: what the broken one still holds was counted as not delivered
        self._client = connected_client(self._address)


def _without_secrets(url: str) -> str:
    """A webhook's address often carries its secret in user, path or query: the log gets the
    host.
    """
    parts = urlsplit(url)
    return f"{parts.scheme}://{parts.hostname}"
