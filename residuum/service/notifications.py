"""Notifications: changes of alarms and findings, told to receivers and an MQTT broker; nobody waits
for them.

Alarms and floods of them go to all (`residuum.service.receivers`), findings to the broker alone
(QoS 1, topics `PREFIX/assets/ASSET/alarm`, `…/finding`, and `PREFIX/flood`). A receiver that is away
is tried again with growing pauses. Both come from the store's outbox, in their order and at least once, also
after a crash, and also those of other processes on the same database. What waits is bounded: the
oldest go, and the log says how many.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import orjson
import structlog
from pydantic import ValidationError

from residuum.identification.errors import BadInput
from residuum.service.broker import BrokerAddress, connected_client, try_connection
from residuum.service.receivers.delivery import Delivery, Words
from residuum.service.receivers.receiver_settings import (
    PATIENCE,
    ReceiverSettings,
    Send,
)
from residuum.service.receivers.webhook import Webhook
from residuum.service.settings import Settings
from residuum.service.storage.outbox import Outbox
from residuum.service.storage.rows.alarm_floods import FLOOD
from residuum.service.store import StorageUnavailable

log = structlog.get_logger()

# Seconds between looks for what other processes on the same database changed. Changes of this
# process are told at once; only what others wrote is waited for.
_LOOK = 1.0


NoteOrder = Callable[[int, str, str], None]
"""Keeps of (alarm, number of its work order, receiver that made it)."""


Wants = Callable[[Mapping[str, Any]], bool]
"""Whether a receiver is told an alarm, or a flood of them."""


def _all(_alarm: Mapping[str, Any]) -> bool:
    return True


def _kept_nowhere(_alarm: int, _number: str, _receiver: str) -> None:
    """Of who keeps no numbers."""


_WORDS = Words("a receiver", "notification", "lost")


class Receiver(Delivery):
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
    wants : callable
    """

    def __init__(
        self, name: str, address: str, send: Send, *, findings: bool, wants: Wants = _all
    ) -> None:
        super().__init__(name, log.bind(receiver=name), _WORDS)
        self._order: str | None = None
        self._address, self._send, self._findings = address, send, findings
        self._wants = wants
        self._thread = threading.Thread(
            target=self._deliver_all, name=f"notify {name}", daemon=True
        )

    def start(self, outbox: Outbox, note_order: NoteOrder = _kept_nowhere) -> None:
        """Begin to tell what waits in the outbox, and have the numbers of work orders kept."""
        self._note_order = note_order
        self._outbox, self._id = outbox, outbox.register(self._address, findings=self._findings)
        self._thread.start()

    def stop(self) -> None:
        """End; what still waits is told by whoever opens the store next."""
        super().stop()
        if self._thread.ident is not None:
            self._thread.join(PATIENCE)

    def _deliver_all(self) -> None:
        while not self.stopped.is_set():
            # before the look: news that come while it lasts are looked for in the next turn
            self.news.clear()
            try:
                self._tell_of_alarms()
                told_all = not self._findings or self._tell_of_findings()
            except Exception as error:  # the store may come back
                log.error("what waits to be told not read", receiver=self.name, reason=str(error))
                self.pause()
                continue
            if told_all:
                self.news.wait(_LOOK)

    def _tell_of_alarms(self) -> None:
        while not self.stopped.is_set() and (notice := self._outbox.next(self._id)) is not None:
            if notice.alarm is None:
                self.dropped += 1
                log.error(
                    "a change of an alarm is damaged and told to nobody: see the alarms",
                    receiver=self.name,
                )
            elif not self._told(notice.alarm, notice.number):
                continue
            self._lost("alarm", notice.passed_over)
            # noted after it was delivered: after a crash in between it is told twice, not never
            self._until_kept(partial(self._outbox.told, self._id, notice))
            if self._order is not None and notice.alarm is not None:
                kept = (notice.alarm["id"], self._order, self.name)
                self._until_kept(partial(self._note_order, *kept))

    def _told(self, alarm: Mapping[str, Any], number: int) -> bool:
        """Whether the receiver has it, refused it for good, or is not to be told it."""
        self._order = None
        if not self._wants(alarm):
            return True
        return self._attempt(_kind_of(alarm), {**alarm, "notice": number})

    def _until_kept(self, note: Callable[[], None]) -> None:
        """Note what was delivered; the store may be away, and what was delivered is not delivered
        again for that.
        """
        while True:
            try:
                note()
                return
            except StorageUnavailable as error:
                log.error("what was told is not noted", receiver=self.name, reason=str(error))
                self.pause()
                if self.stopped.is_set():
                    return

    def _tell_of_findings(self) -> bool:
        """Tell a batch of what waits; False when more may wait."""
        batch = self._outbox.findings(self._id)
        # so long, until the outbox is told which of the batch were told
        until, sent = time.monotonic() + PATIENCE, []
        # in order: behind one that is not delivered, the others wait
        for finding in batch.findings:
            if (
                self.stopped.is_set()
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
        """Whether the receiver has it, or refused it for good."""

        def deliver() -> None:
            self._order = self._send(kind, payload)

        return self.attempt(deliver)


def _kind_of(notice: Mapping[str, Any]) -> str:
    """`flood` of a notice of one, else `alarm`."""
    return FLOOD if notice["kind"] == FLOOD else "alarm"


def receivers_of(settings: Settings) -> Sequence[ReceiverSettings]:
    """All receivers of the settings, those of `webhooks` first; BadInput where two are one."""
    receivers = [*map(_plain_webhook, map(str, settings.webhooks)), *settings.receivers]
    addresses = [receiver.address() for receiver in receivers]
    for number, receiver in enumerate(receivers):
        if addresses[number] in addresses[:number]:
            raise BadInput(
                f"setting receivers: {receiver.called}: there are two with this address, and each"
                " would be told twice; leave one out"
            )
    return receivers


def _told_apart(names: Sequence[str]) -> list[str]:
    """The names, those that there are twice with their number: a host has several receivers."""
    return [
        f"{name} ({names[: place + 1].count(name)})" if names.count(name) > 1 else name
        for place, name in enumerate(names)
    ]


def _plain_webhook(url: str) -> Webhook:
    try:
        return Webhook.model_validate({"kind": "webhook", "url": url})
    except ValidationError as error:
        says = error.errors(include_url=False)[0]["msg"].removeprefix("Value error, ")
        raise BadInput(f"setting webhooks: {says}") from None


class Notifications:
    """All receivers of the settings; BadInput for one that cannot be told as they say."""

    def __init__(self, settings: Settings) -> None:
        public_url = None if settings.public_url is None else str(settings.public_url)
        receivers = receivers_of(settings)
        self.receivers = [
            Receiver(name, of.address(), of.opened(public_url), findings=False, wants=of.wants)
            for name, of in zip(
                _told_apart([of.called for of in receivers]), receivers, strict=True
            )
        ]
        if settings.mqtt:
            address = settings.broker
            name = f"{'mqtt' if address.tls is None else 'mqtts'}://{address.host}:{address.port}"
            self.receivers.append(Receiver(name, settings.mqtt, Broker(address), findings=True))

    def start(self, outbox: Outbox, note_order: NoteOrder = _kept_nowhere) -> None:
        """Begin to tell, and have the numbers of work orders kept; nothing is told before."""
        self._outbox = outbox
        for receiver in self.receivers:
            receiver.start(outbox, note_order)

    def tell(self, kind: str, _payload: Mapping[str, Any]) -> None:
        """A finding or a change of an alarm waits in the outbox."""
        if kind in ("finding", "alarm"):
            for receiver in self.receivers:
                receiver.look()

    def troubles(self) -> dict[str, str]:
        """Receiver → what the last attempt to tell it failed by."""
        return {
            receiver.name: receiver.trouble
            for receiver in self.receivers
            if receiver.trouble is not None
        }

    def stop(self) -> None:
        """End all receivers."""
        for receiver in self.receivers:
            receiver.stop()
        if self.receivers:
            with suppress(StorageUnavailable):
                self._outbox.release()


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
            message.wait_for_publish(PATIENCE)
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
