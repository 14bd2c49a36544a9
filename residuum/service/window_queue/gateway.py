"""Gateway: sends the windows of its spool until a scorer has said that they are stored."""

from __future__ import annotations

import threading
import time
from typing import Any

import orjson
import structlog

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.scoring import PlainRecord
from residuum.service.settings import BrokerAddress
from residuum.service.window_queue.broker_client import broker_client
from residuum.service.window_queue.spool import Spool
from residuum.service.window_queue.topics import receipt_topic, window_topic
from residuum.service.window_queue.window_message import WindowMessage

log = structlog.get_logger()

_AHEAD = 16
"""Windows that are under way at once."""
_RESEND_AFTER, _LONGEST_RESEND = 15.0, 240.0
"""Seconds without any receipt after which what is under way is sent again; doubled each time, up to the second."""
_LOOK = 0.5
_RETRY = 2.0


class Gateway:
    """The sending side of the window queue.

    Parameters
    ----------
    name : str
        Of this gateway, unlike that of any other: receipts come under it.
    spool : Spool
    address : BrokerAddress
    resend_after : float
        See `_RESEND_AFTER` [s].
    """

    def __init__(self, name: str, spool: Spool, address: BrokerAddress, resend_after: float = _RESEND_AFTER) -> None:
        self.name, self.spool = name, spool
        self._address, self._resend_after = address, resend_after
        self.sent = self.stored = self.refused = 0
        self._counting = threading.Lock()
        self._moved, self._connected = threading.Event(), threading.Event()
        self._stopped = threading.Event()
        self._progress = 0.0
        self._thread = threading.Thread(target=self._send_all, name=f"gateway {name}", daemon=True)

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def stop(self) -> None:
        """End; what is not known to be stored stays in the spool."""
        self._stopped.set()
        self._moved.set()
        if self._thread.ident is not None:
            self._thread.join(5.0)

    def handle(self, machine: MachineSettings, window: Record, _baseline: str, stopped: threading.Event) -> Finding | None:
        """Keep a window of a machine in the spool (what a `MachineLine` does with it); there is no finding yet."""
        message = WindowMessage(machine.asset, machine.diagnoser, machine.baseline or machine.asset, PlainRecord.of(window))
        payload = message.pack()
        while True:
            try:
                self.spool.put(payload)
                self._moved.set()
                return None
            except OSError as error:
                log.error("window not spooled, trying again", machine=machine.asset, reason=str(error))
                if stopped.wait(_RETRY):
                    return None

    def status(self) -> dict[str, int]:
        """What became of the windows so far: one that is gone from the spool is counted."""
        with self._counting:
            numbers = {"sent": self.sent, "stored": self.stored, "refused": self.refused}
            return {**numbers, "waiting": len(self.spool), "dropped": self.spool.dropped}

    def _send_all(self) -> None:
        receipts = [receipt_topic(self._address.prefix, self.name)]
        client = broker_client(
            self._address, f"residuum-gateway-{self.name}", receipts, self._take_receipt, self._connected.set, kept=False
        )
        under_way: dict[str, None] = {}
        patience = self._resend_after
        try:
            while not self._stopped.is_set():
                self._moved.wait(_LOOK)
                self._moved.clear()
                if self._connected.is_set():
                    self._connected.clear()
                    under_way.clear()
                if not client.is_connected():
                    continue
                waiting = self.spool.oldest(_AHEAD)
                if any(key not in waiting for key in under_way):
                    patience = self._resend_after
                    under_way = {key: None for key in under_way if key in waiting}
                if under_way and time.monotonic() - self._progress > patience:
                    patience = min(2 * patience, _LONGEST_RESEND)
                    under_way.clear()
                for key in waiting:
                    if key not in under_way:
                        self._send(client, key)
                        under_way[key] = None
        finally:
            client.disconnect()
            client.loop_stop()

    def _send(self, client: Any, key: str) -> None:
        payload = self.spool.read(key)
        if payload is None:
            return
        asset = WindowMessage.unpack(payload).asset
        client.publish(window_topic(self._address.prefix, asset, self.name, key), payload, qos=1)
        self.sent += 1
        self._progress = time.monotonic()

    def _take_receipt(self, client: Any, message: Any) -> None:
        try:
            receipt = orjson.loads(message.payload)
            key, refused = str(receipt["key"]), receipt["refused"]
        except (orjson.JSONDecodeError, KeyError, TypeError):
            log.warning("not a receipt", topic=message.topic)
            key, refused = "", None
        with self._counting:
            known = self.spool.remove(key)
            self.stored += known and refused is None
            self.refused += known and refused is not None
        if known:
            self._progress = time.monotonic()
        if known and refused is not None:
            log.error("a window was refused", reason=str(refused)[:300])
        client.ack(message.mid, message.qos)
        self._moved.set()
