"""Gateway: sends the windows of its spool until a scorer has said that they are stored."""

from __future__ import annotations

import os
import threading
import time
import uuid
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import orjson
import structlog

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.broker import BrokerAddress
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.storage.durable_folder import make_folder, sync_folder
from residuum.service.window_queue.window_message import (
    Listener,
    WindowMessage,
    broker_client,
    receipt_topic,
    window_topic,
)
from residuum.service.work.worker_pool import PlainRecord

# Spool: a gateway's windows on its disk, until each of them is known to be stored elsewhere.

_ENDING = ".window"


class Spool:
    """Files in a folder, in the order in which they came; safe to use from any thread.

    A message is on disk when `put` returns. What was there at a crash is there at the next start,
    under the same keys.

    Parameters
    ----------
    folder : Path
    most_bytes : int
        When more would be kept, the oldest go, and are counted in `dropped`.
    """

    def __init__(self, folder: Path, most_bytes: int) -> None:
        make_folder(folder)
        self._folder, self._most = folder, most_bytes
        self._lock = threading.Lock()
        # a message that was not whole at a crash was never acknowledged to who put it
        for unfinished in folder.glob("*.part"):
            unfinished.unlink()
        files = sorted(folder.glob(f"*{_ENDING}"))
        self._files: dict[str, Path] = {}
        self._machine_of: dict[str, str] = {}
        self._keys_of: dict[str, dict[str, None]] = {}
        for file in files:
            _, *name_parts = file.name.removesuffix(_ENDING).split("-", maxsplit=2)
            if len(name_parts) != 2:
                raise BadInput(
                    f"{file}: its name does not say of which machine it is; move it out of the"
                    " spool"
                )
            self._list(name_parts[0], name_parts[1], file)
        self._sizes = {key: file.stat().st_size for key, file in self._files.items()}
        self._bytes = sum(self._sizes.values())
        self._next = int(files[-1].name.split("-", maxsplit=1)[0]) + 1 if files else 0
        self.dropped = 0

    def __len__(self) -> int:
        with self._lock:
            return len(self._files)

    def put(self, payload: bytes, machine: str) -> str:
        """Keep a message of a machine; returns its key once it is on disk. OSError when it cannot
        be written.
        """
        key = uuid.uuid4().hex
        with self._lock:
            file = self._folder / f"{self._next:012d}-{key}-{machine}{_ENDING}"
            self._next += 1
            # written beside, synced and moved: a file of this name is whole, also after a power cut
            part = self._folder / f"{key}.part"
            with part.open("wb") as opened:
                opened.write(payload)
                opened.flush()
                os.fsync(opened.fileno())
            part.replace(file)
            sync_folder(self._folder)
            self._list(key, machine, file)
            self._sizes[key] = len(payload)
            self._bytes += len(payload)
            # never the last one: a single window larger than the spool is sent all the same
            while self._bytes > self._most and len(self._files) > 1:
                self._forget(next(iter(self._files)))
                self.dropped += 1
        return key

    def oldest(self, count: int) -> dict[str, list[str]]:
        """Keys of the first messages of each machine, in order."""
        with self._lock:
            return {machine: list(islice(keys, count)) for machine, keys in self._keys_of.items()}

    def read(self, key: str) -> bytes | None:
        """A message; None when it is gone."""
        with self._lock:
            file = self._files.get(key)
            return None if file is None else file.read_bytes()

    def remove(self, key: str) -> bool:
        """Let a message go; False when it had gone before."""
        with self._lock:
            if key not in self._files:
                return False
            self._forget(key)
            return True

    def _list(self, key: str, machine: str, file: Path) -> None:
        self._files[key], self._machine_of[key] = file, machine
        self._keys_of.setdefault(machine, {})[key] = None

    def _forget(self, key: str) -> None:
        self._files.pop(key).unlink(missing_ok=True)
        keys = self._keys_of[machine := self._machine_of.pop(key)]
        del keys[key]
        if not keys:
            del self._keys_of[machine]
        self._bytes -= self._sizes.pop(key)


log = structlog.get_logger()

# Windows of a machine that are under way at once; what those of one machine wait for holds up no
# other.
_AHEAD = 8
# Seconds without a receipt for a machine after which its windows are sent again; doubled each time,
# up to the second.
_RESEND_AFTER, _LONGEST_RESEND = 15.0, 240.0
# [s] Between looks at what is due, where nothing happens.
_LOOK = 0.5
# [s] Between two tries to write a window to the spool.
_RETRY = 2.0


@dataclass
class _Machine:
    """What is under way of one machine's windows; `progress` is when the last was sent or known to
    be stored.
    """

    patience: float
    under_way: dict[str, None] = field(default_factory=dict)
    heard: bool = False
    progress: float = 0.0


class Gateway:
    """The sending side of the window queue.

    The windows of a machine come to its scorer in their order. Before the scorer has ever
    subscribed, a broker forgets what it is sent; so after each connecting a machine's first window
    goes alone, and the others once its receipt has come.

    Parameters
    ----------
    name : str
        Of this gateway, unlike that of any other: receipts come under it.
    spool : Spool
    address : BrokerAddress
    resend_after : float
        See `_RESEND_AFTER` [s].
    """

    def __init__(
        self, name: str, spool: Spool, address: BrokerAddress, resend_after: float = _RESEND_AFTER
    ) -> None:
        self.name, self.spool = name, spool
        self._address, self._resend_after = address, resend_after
        self.sent = self.stored = self.refused = 0
        self._counting = threading.Lock()
        self._moved, self._connected = threading.Event(), threading.Event()
        self._stopped = threading.Event()
        self._answered: set[str] = set()
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

    def handle(
        self,
        machine: MachineSettings,
        window: Record,
        _baseline: str | None,
        stopped: threading.Event,
    ) -> Finding | None:
        """Keep a window of a machine in the spool (what a `MachineLine` does with it); there is no
        finding yet.
        """
        message = WindowMessage(
            machine.asset,
            machine.diagnoser,
            machine.baseline or machine.asset,
            PlainRecord.of(window),
            machine.method,
        )
        payload = message.pack()
        while True:
            try:
                self.spool.put(payload, machine.asset)
                self._moved.set()
                return None
            except OSError as error:
                log.error(
                    "window not spooled, trying again", machine=machine.asset, reason=str(error)
                )
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
            self._address,
            f"residuum-gateway-{self.name}",
            receipts,
            Listener(self._take_receipt, self._connected.set),
            # what is not known to be stored is sent again: no receipt has to be kept
            persistent=False,
        )
        machines: dict[str, _Machine] = {}
        try:
            while not self._stopped.is_set():
                self._moved.wait(_LOOK)
                self._moved.clear()
                # of a new connection nobody knows what came over the old one: all is sent again
                if self._connected.is_set():
                    self._connected.clear()
                    machines.clear()
                    self._answered.clear()
                if client.is_connected():
                    self._send_what_is_due(client, machines)
        finally:
            client.disconnect()
            client.loop_stop()

    def _send_what_is_due(self, client: Any, machines: dict[str, _Machine]) -> None:
        waiting = self.spool.oldest(_AHEAD)
        for asset in waiting.keys() | machines.keys():
            machine, keys = (
                machines.setdefault(asset, _Machine(self._resend_after)),
                waiting.get(asset, []),
            )
            self._follow(machine, keys)
            for key in keys if machine.heard else keys[:1]:
                if key not in machine.under_way:
                    self._send(client, asset, key)
                    machine.under_way[key] = None
                    machine.progress = time.monotonic()

    def _follow(self, machine: _Machine, waiting: list[str]) -> None:
        """Note what has been stored since, or send all again when that takes too long."""
        settled = [key for key in machine.under_way if key not in waiting]
        if settled:
            machine.heard |= not self._answered.isdisjoint(settled)  # else the spool let them go
            machine.patience, machine.progress = self._resend_after, time.monotonic()
            self._answered.difference_update(settled)
            machine.under_way = {key: None for key in machine.under_way if key in waiting}
        elif machine.under_way and time.monotonic() - machine.progress > machine.patience:
            machine.patience = min(2 * machine.patience, _LONGEST_RESEND)
            machine.under_way.clear()

    def _send(self, client: Any, asset: str, key: str) -> None:
        payload = self.spool.read(key)
        if payload is not None:
            client.publish(
                window_topic(self._address.prefix, asset, self.name, key), payload, qos=1
            )
            self.sent += 1

    def _take_receipt(self, client: Any, message: Any) -> None:
        try:
            receipt = orjson.loads(message.payload)
            key, refused = str(receipt["key"]), receipt["refused"]
        except (orjson.JSONDecodeError, KeyError, TypeError):
            log.warning("not a receipt", topic=message.topic)
            key, refused = "", None
        with self._counting:
            # noted before the spool lets it go: `_follow` asks which of the gone ones were answered
            self._answered.add(key)
            known = self.spool.remove(key)
            if not known:
                self._answered.discard(key)
            self.stored += known and refused is None
            self.refused += known and refused is not None
        if known and refused is not None:
            log.error("a window was refused", reason=str(refused)[:300])
        client.ack(message.mid, message.qos)
        self._moved.set()
