"""Events: what happens in the service, handed to every listener in order, resumable after a broken
connection.
"""

from __future__ import annotations

import asyncio
import secrets
import threading
from collections import deque
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from typing import Any

import orjson

EVENTS_KEPT = 4096
"""Events kept for listeners that come back."""

# The part of an event's payload that names its machine, of the kinds that have one.
_ASSET_OF = {
    "finding": "asset",
    "confirmation": "asset",
    "alarm": "asset",
    "pipeline": "machine",
}


@dataclass(frozen=True)
class Event:
    """One thing that happened. `id` grows within one run of the service; `data` is its payload as
    JSON.

    `asset` is the machine that a finding, an alarm or a state of the pipeline is of; None for what
    is of the whole plant.
    """

    id: int
    kind: str
    data: bytes
    asset: str | None = None


class Events:
    """A bounded log of events with listeners.

    `publish` may be called from any thread. A listener that was away names the last event it saw
    and gets what it missed; when that is no longer kept, or the service has restarted since, it
    first gets an event `reset`, which means: read the state anew. No listener can hold up the
    others or the publisher, and memory is bounded by `most_kept`.

    Event kinds: `finding`, `confirmation`, `alarm`, `pipeline`, `job`, `model`, `reset`.
    """

    def __init__(self, most_kept: int = EVENTS_KEPT) -> None:
        # in every token, so that one of an earlier run of the service is known for what it is
        self.run = secrets.token_hex(4)
        self._log: deque[Event] = deque(maxlen=most_kept)
        self._last = 0
        self._lock = threading.Lock()
        self._wake: dict[asyncio.Event, asyncio.AbstractEventLoop] = {}
        self._closed = False

    def publish(self, kind: str, payload: Mapping[str, Any]) -> None:
        """Tell every listener. The payload is turned into JSON at once, so later changes to it do
        not matter.
        """
        asset = payload.get(_ASSET_OF.get(kind, ""))
        data = orjson.dumps(payload, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS)
        with self._lock:
            self._last += 1
            self._log.append(Event(self._last, kind, data, asset))
        self._wake_listeners()

    def close(self) -> None:
        """End every listener's stream (the service stops)."""
        self._closed = True
        self._wake_listeners()

    def now(self) -> str:
        """What a listener names who wants every event from now on."""
        with self._lock:
            return f"{self.run}-{self._last}"

    def token(self, event: Event) -> str:
        """What a listener hands back to resume after `event`."""
        return f"{self.run}-{event.id}"

    async def listen(
        self, last_seen: str | None, heartbeat: float = 15.0
    ) -> AsyncIterator[Event | None]:
        """Events after `last_seen` (a token), as they come; None when nothing happened for
        `heartbeat` seconds.
        """
        position, lost = self._position(last_seen)
        if lost:
            yield self._reset(position)
        woken = asyncio.Event()
        with self._lock:
            self._wake[woken] = asyncio.get_running_loop()
        try:
            while not self._closed:
                # before the look: what comes while it lasts wakes the next wait
                woken.clear()
                waiting, lost = self._after(position)
                if lost:
                    position = self._last
                    yield self._reset(position)
                for event in waiting:
                    position = event.id
                    yield event
                if waiting or lost:
                    continue
                try:
                    await asyncio.wait_for(woken.wait(), heartbeat)
                except TimeoutError:
                    yield None
        finally:
            with self._lock:
                self._wake.pop(woken, None)

    def _wake_listeners(self) -> None:
        # each on its own loop: `publish` is called from threads that have none
        with self._lock:
            listeners = list(self._wake.items())
        for woken, loop in listeners:
            if not loop.is_closed():
                loop.call_soon_threadsafe(woken.set)

    def _position(self, last_seen: str | None) -> tuple[int, bool]:
        """(id to go on after, whether something was lost)."""
        if last_seen is None:
            return self._last, False
        run, _, number = last_seen.partition("-")
        if (
            run != self.run
            or not number.isdecimal()
            or len(number) > 18  # no id has so many digits; a stranger's number may have thousands
            or int(number) > self._last
        ):
            return self._last, True
        return int(number), False

    def _after(self, position: int) -> tuple[list[Event], bool]:
        """(events after `position`, whether some of them are no longer kept)."""
        with self._lock:
            if self._last == position:
                return [], False
            first = self._log[0].id
            if position + 1 < first:
                return [], True
            return [event for event in self._log if event.id > position], False

    @staticmethod
    def _reset(position: int) -> Event:
        return Event(position, "reset", b"{}")
