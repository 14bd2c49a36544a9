"""StoredWindows: what scorers store, told to the listeners of this service as what it stores
itself.
"""

from __future__ import annotations

import secrets
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import orjson
import structlog

from residuum.identification.errors import BadInput
from residuum.service.broker import BrokerAddress
from residuum.service.storage.disk_store import DiskStore
from residuum.service.store import StorageUnavailable
from residuum.service.window_queue.window_message import (
    ASSET_NAME,
    PARTITIONS,
    Listener,
    broker_client,
    stored_topic,
)

# StoredNews: which window has been stored, as bytes. It names what to read from the store and
# says nothing of what is in it.

# Bytes of a message: a name and a number, and room for newer versions.
_LONGEST = 500
# The database's whole numbers have 64 bits with a sign.
_LARGEST = 2**63


@dataclass(frozen=True)
class StoredNews:
    """Window `window` of `asset` is on disk.

    >>> StoredNews.unpack(StoredNews("press-1", 7).pack())
    StoredNews(asset='press-1', window=7)
    """

    asset: str
    window: int

    def pack(self) -> bytes:
        """The news as bytes: JSON."""
        return orjson.dumps({"asset": self.asset, "window": self.window})

    @classmethod
    def unpack(cls, payload: bytes) -> StoredNews:
        """The news again; BadInput, in one line, when it is none."""
        if len(payload) > _LONGEST:
            raise BadInput(f"stored news: {len(payload)} bytes; at most {_LONGEST} are read")
        try:
            plain = orjson.loads(payload)
        except orjson.JSONDecodeError as error:
            raise BadInput(f"stored news: cannot be read: {error}") from None
        asset, window = (
            (plain.get("asset"), plain.get("window")) if isinstance(plain, dict) else (None, None)
        )
        if not isinstance(asset, str) or not ASSET_NAME.fullmatch(asset):
            raise BadInput("stored news, asset: is no name of a machine")
        if type(window) is not int or not 0 < window < _LARGEST:
            raise BadInput("stored news, window: is no number of a window")
        return cls(asset, window)


log = structlog.get_logger()

# Machines of which news wait; of more, pages read the state anew.
_MOST_WAITING = 10_000
# Findings of a machine that are told one by one; of more, pages read the state anew.
_AT_ONCE = 100
# [s] In which news are gathered.
_PAUSE = 0.05
# [s] Between two tries to read the store.
_STORAGE_RETRY = 2.0
# Findings that are known to have been told.
_REMEMBERED = 20_000

Tell = Callable[[str, Mapping[str, Any]], None]
Count = Callable[[str], None]
"""Told what became of a message: `taken`, `refused` (it is none), or `overflow` (too many machines
wait).
"""


class Told:
    """Findings that were told of late, so that none is told twice; safe to use from any thread."""

    def __init__(self, remembered: int = _REMEMBERED) -> None:
        self._numbers: OrderedDict[int, None] = OrderedDict()
        self._remembered, self._lock = remembered, threading.Lock()

    def first(self, finding: int) -> bool:
        """Whether this finding is told for the first time; from now on it is not."""
        with self._lock:
            if finding in self._numbers:
                return False
            self._numbers[finding] = None
            if len(self._numbers) > self._remembered:
                self._numbers.popitem(last=False)
            return True


class StoredWindows:
    """The listening side of the news of stored windows.

    A message is a hint to look: what is told is read from the store, is newer than the connection
    to the broker, and is told once, so whoever can write to the broker can show nobody anything but
    what is there. With every connection listeners are told `reset`: what was stored meanwhile is in
    the state that they then read anew. Memory and work are bounded however many messages come.

    Parameters
    ----------
    address : BrokerAddress
    store : DiskStore
    shown : Told
        Shared with what else tells of findings.
    tell : callable
        Told `finding`, `alarm` and `reset` with their payloads, in a thread of this object.
    count : callable
    """

    def __init__(
        self, address: BrokerAddress, store: DiskStore, shown: Told, tell: Tell, count: Count
    ) -> None:
        self._address, self._store, self._shown, self._tell, self._count = (
            address,
            store,
            shown,
            tell,
            count,
        )
        self._lock = threading.Lock()
        self._waiting: dict[str, int] = {}
        self._anew = False
        self._since = 0
        self._seen: dict[str, int] = {}
        self._came, self._stopped = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._follow, name="stored windows", daemon=True)

    def start(self) -> None:
        """Begin to follow; returns at once, whether the broker is there or not."""
        self._thread.start()

    def stop(self) -> None:
        """End; what is not told by then is told to nobody."""
        self._stopped.set()
        self._came.set()
        if self._thread.ident is not None:
            self._thread.join(_STORAGE_RETRY)

    def _follow(self) -> None:
        name = f"residuum-live-{secrets.token_hex(8)}"
        topics = [stored_topic(self._address.prefix)]
        client = broker_client(
            self._address,
            name,
            topics,
            Listener(self._take, subscribed=self._begin_anew),
            # what was missed is in the state that listeners read anew
            persistent=False,
        )
        try:
            while not self._stopped.is_set():
                self._came.wait()
                self._came.clear()
                try:
                    self._look()
                # the store may come back, and nothing that comes over the network may end this
                except Exception as error:
                    note = log.error if isinstance(error, StorageUnavailable) else log.exception
                    note("stored windows not read, trying again", reason=str(error))
                    self._came.set()
                    self._stopped.wait(_STORAGE_RETRY)
                self._stopped.wait(_PAUSE)  # what comes meanwhile is read at once
        finally:
            client.disconnect()
            client.loop_stop()

    def _take(self, client: Any, message: Any) -> None:
        """In the network thread."""
        try:
            news = StoredNews.unpack(message.payload)
        except BadInput as error:
            self._count("refused")
            log.debug("message refused", topic=message.topic[:80], reason=str(error))
        else:
            self._wait(news)
        client.ack(message.mid, message.qos)

    def _wait(self, news: StoredNews) -> None:
        with self._lock:
            full = news.asset not in self._waiting and len(self._waiting) >= _MOST_WAITING
            if full:
                self._anew = True
            else:
                self._waiting[news.asset] = max(news.window, self._waiting.get(news.asset, 0))
        self._count("overflow" if full else "taken")
        self._came.set()

    def _begin_anew(self) -> None:
        """What was stored until now, listeners read themselves: a new subscription, or more than is
        told one by one.
        """
        with self._lock:
            self._anew = True
        self._came.set()

    def _look(self) -> None:
        if self._anew:
            # A number may be given before another's and be committed after it, but a scorer stores
            # one window after the other.
            since = max(0, self._store.newest_finding() - PARTITIONS)
            with self._lock:
                self._anew = False
            self._since, self._seen = since, {}
            self._tell("reset", {})
        while not self._stopped.is_set():
            with self._lock:
                if not self._waiting:
                    return
                asset, window = next(iter(self._waiting.items()))
            self._tell_of(asset)
            with self._lock:
                if self._waiting[asset] == window:  # else there is more of it by now
                    del self._waiting[asset]

    def _tell_of(self, asset: str) -> None:
        """Tell what the store has of a machine that was not told yet."""
        findings = self._store.findings_after(
            asset, self._seen.get(asset, self._since), _AT_ONCE + 1
        )
        if not findings:
            return
        if len(findings) > _AT_ONCE:
            self._begin_anew()
            return
        changed = self._store.alarms_changed(asset, [finding.at for finding in findings])
        self._seen[asset] = findings[-1].id
        new = [finding for finding in findings if self._shown.first(finding.id)]
        for finding in new:
            self._tell("finding", finding.to_json())
        for alarm in changed if new else []:
            self._tell("alarm", alarm.to_json())
