"""Scorer: takes windows from the broker, has them judged, stores them once, and only then says
so.
"""

from __future__ import annotations

import hashlib
import queue
import threading
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import orjson
import structlog

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names
from residuum.service.broker import BrokerAddress
from residuum.service.machines.baselines import baseline_file, deciding_method
from residuum.service.machines.scoring import score_window
from residuum.service.storage.disk_store import DiskStore
from residuum.service.store import NotFound, StorageUnavailable
from residuum.service.window_queue.set_aside import ATTEMPTS, Attempts, SetAside
from residuum.service.window_queue.stored_windows import StoredNews
from residuum.service.window_queue.window_message import (
    PARTITIONS,
    Listener,
    WindowMessage,
    broker_client,
    receipt_topic,
    stored_topic,
    windows_of_part,
)
from residuum.service.work.worker_pool import WorkerPool

log = structlog.get_logger()

# [s] For which a baseline is used before a newer one is looked for.
_LOOK_FOR_BASELINE = 2.0
# [s] Between two tries to store a window.
_STORAGE_RETRY = 2.0
# [s] How long it takes at most to notice that the scorer is to end.
_WAIT = 0.2
# [s] For the window that is being judged when it ends.
_LAST_WINDOW = 4.0


class Scorer:
    """One of several consumers of the window queue; each has its share of the machines.

    At least once: the broker and the gateway are told of a window after it is on disk. Once: the
    key under which it was sent is the store's idempotency key. A window whose judging ends its
    process again and again is stored as not assessable. A message that is refused, or that was
    begun several times and never finished, is set aside with its reason.

    Parameters
    ----------
    address : BrokerAddress
    part, parts : int
        Which of how many scorers this is, from 1. Two with the same part end each other's
        connection.
    pool : WorkerPool
    store : DiskStore
    data : Path
        Folder for baselines.
    fmus : bool
        Whether FMUs in them are run, in a process of their own.
    """

    def __init__(
        self,
        address: BrokerAddress,
        part: int,
        parts: int,
        pool: WorkerPool,
        store: DiskStore,
        data: Path,
        *,
        fmus: bool = False,
    ) -> None:
        if not 1 <= part <= parts <= PARTITIONS:
            raise BadInput(
                f"scorer {part}/{parts}: must be one of at most {PARTITIONS}, numbered from 1"
            )
        self._address, self._part, self._parts = address, part, parts
        self._pool, self._store, self._data, self._fmus = pool, store, data, fmus
        self._set_aside, self._attempts = SetAside(data), Attempts(data, f"{part}-of-{parts}")
        self._baselines: dict[str, tuple[float, str]] = {}
        self._came: queue.Queue[tuple[int, Any]] = queue.Queue()
        self._connection = 0
        self._stopped = threading.Event()
        self._thread = threading.Thread(
            target=self._score_all, name=f"scorer {part}/{parts}", daemon=True
        )
        self.stored = self.seen_before = self.refused = 0

    def start(self) -> None:
        """Begin to take windows; returns at once."""
        self._thread.start()

    def stop(self) -> None:
        """End; the window that is being judged is finished if that takes no longer than some
        seconds, else it comes again.
        """
        self._stopped.set()
        if self._thread.ident is not None:
            self._thread.join(_LAST_WINDOW)

    def _score_all(self) -> None:
        topics = windows_of_part(self._address.prefix, self._part, self._parts)
        name = f"residuum-scorer-{self._address.prefix}-{self._part}-of-{self._parts}"
        client = broker_client(
            self._address, name, topics, Listener(self._queue, self._reconnected), persistent=True
        )
        try:
            while not self._stopped.is_set():
                try:
                    connection, message = self._came.get(timeout=_WAIT)
                except queue.Empty:
                    continue
                if connection == self._connection:  # else it comes again over the new connection
                    self._take(client, message)
        finally:
            client.disconnect()
            client.loop_stop()

    def _reconnected(self) -> None:
        self._connection += 1

    def _queue(self, _client: Any, message: Any) -> None:
        self._came.put((self._connection, message))

    def _take(self, client: Any, message: Any) -> None:
        *_, gateway, key = message.topic.split("/")
        refused, stored = None, None
        # on disk before it is read: a message that ends this process is counted all the same
        attempt = self._attempts.begin(key)
        try:
            if attempt > ATTEMPTS:
                raise BadInput(f"window message: was begun {ATTEMPTS} times and never finished")
            stored = self._store_once(key, message.payload)
            self._attempts.finish(key)
            if stored is None:
                return
        except BadInput as error:
            refused = str(error)
            self.refused += 1
            self._set_aside.put(key, gateway, message.payload, refused, message.topic)
            self._attempts.finish(key)
            log.error("window refused and set aside", gateway=gateway, reason=refused)
        except Exception:
            # one window must not end the scorer; it is not acknowledged, so it comes again
            log.exception("window not scored", gateway=gateway, attempt=attempt)
            self._stopped.wait(_STORAGE_RETRY)
            return
        # before the receipt: a scorer that is killed in between stores nothing new, but tells anew
        if stored is not None:
            client.publish(stored_topic(self._address.prefix), stored.pack(), qos=1)
        client.publish(
            receipt_topic(self._address.prefix, gateway),
            orjson.dumps({"key": key, "refused": refused}),
            qos=1,
        )
        client.ack(message.mid, message.qos)

    def _store_once(self, key: str, payload: bytes) -> StoredNews | None:
        """The window that is on disk; None when the scorer was stopped before."""
        digest = hashlib.sha256(payload).hexdigest()
        message = WindowMessage.unpack(payload)
        if message.diagnoser not in DIAGNOSERS:
            raise BadInput(
                f"diagnoser {message.diagnoser[:60]!r}: there is none of this name;"
                f" {known_names(message.diagnoser, DIAGNOSERS)}"
            )
        record = message.window.record()
        finding: Finding | None = None
        while not self._stopped.is_set():
            try:
                # judged only where it is not stored: a window that came again costs one question
                known = self._store.window_with_key(message.asset, key, digest)
                if known is not None:
                    self.seen_before += 1
                    return StoredNews(message.asset, known)
                finding = finding or self._judge(message)
                window = self._store.add_window(message.asset, record, finding, key, digest)
                self.stored += 1
                return StoredNews(message.asset, window)
            except StorageUnavailable as error:
                log.error(
                    "window not stored, trying again", machine=message.asset, reason=str(error)
                )
                self._stopped.wait(_STORAGE_RETRY)
        return None

    def _judge(self, message: WindowMessage) -> Finding:
        try:
            baseline = self._baseline(message.baseline)
            method = deciding_method(self._store, message.asset, message.diagnoser, message.method)
            return self._pool.call(
                *(score_window, message.diagnoser, baseline, message.window, method, self._fmus)
            )
        except BrokenProcessPool:
            if self._stopped.is_set():
                raise
            return Finding.not_assessable(
                message.diagnoser, "judging it ended its process several times"
            )

    def _baseline(self, name: str) -> str:
        """The file of the newest version of a baseline; empty when there is none."""
        looked, file = self._baselines.get(name, (float("-inf"), ""))
        if time.monotonic() - looked < _LOOK_FOR_BASELINE:
            return file
        try:
            newest = self._store.model_versions(name)[0]
            file = baseline_file(self._data, self._store.model_content(name, newest.number))
        except NotFound:
            file = ""
        self._baselines[name] = time.monotonic(), file
        return file
