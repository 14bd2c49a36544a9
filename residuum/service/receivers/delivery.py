"""How something is handed over to who may be away, or refuse it: tried again with growing pauses,
and what it failed by is told.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, NamedTuple

from residuum.service.fieldbus.source import Backoff
from residuum.service.receivers.receiver_settings import Refused

# [s] First and longest pause between two tries.
_FIRST, _LONGEST = 0.2, 30.0


class Words(NamedTuple):
    """What the log and health say: who gets which thing, and what becomes of one that is refused."""

    who: str
    thing: str
    refused: str


class Delivery:
    """Hands over one thing after the other.

    Parameters
    ----------
    name : str
        Whom to; without passwords.
    log : structlog's
        Bound to it.
    words : Words
    """

    def __init__(self, name: str, log: Any, words: Words) -> None:
        self.name, self._log = name, log
        self.sent = self.dropped = 0
        self.trouble: str | None = None
        """What the last attempt failed by, None where it did not."""
        self.stopped, self.news = threading.Event(), threading.Event()
        self._words = words
        self._backoff = Backoff(first=_FIRST, longest=_LONGEST)
        self._failed_by: set[str] = set()

    def look(self) -> None:
        """Something new may wait."""
        self.news.set()

    def stop(self) -> None:
        """Begin nothing more; what waits is let wait."""
        self.stopped.set()
        self.news.set()

    def attempt(self, deliver: Callable[[], object]) -> bool:
        """Whether it is taken, or refused for good (`deliver` raises Refused); False after a pause
        where it has to be tried again (OSError).
        """
        who, thing, refused = self._words
        try:
            deliver()
        except Refused as error:
            self.dropped += 1
            self.trouble = f"refused a {thing} at {_now()}, {self.dropped} are {refused}: {error}"
            self._log.warning(f"{who} refused a {thing}: it is {refused}", reason=str(error))
            return True
        except OSError as error:
            self.trouble = f"takes no {thing}, tried last at {_now()}: {error}"
            # each reason once, until it is taken again
            if str(error) not in self._failed_by:
                self._log.warning(f"{who} takes no {thing}, and it waits", reason=str(error))
            self._failed_by.add(str(error))
            self.pause()
            return False
        if self._failed_by:
            self._log.info(f"{who} takes every {thing} again")
        self.sent += 1
        self.trouble = None
        self._failed_by.clear()
        self._backoff.reset()
        return True

    def pause(self) -> None:
        """Wait for longer than the last time, or until it is stopped."""
        self.stopped.wait(self._backoff.next())


def _now() -> str:
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC"
