"""HTTP connections within bounds: so many at once, and none that holds its place without asking for something."""

from __future__ import annotations

import asyncio
import resource

from uvicorn.protocols.http.h11_impl import H11Protocol

ASK_WITHIN = 10.0
"""Seconds in which the head of a request must have come, from the connection's begin or the answer before."""


def most_connections() -> int:
    """Half of the files that this process may open: the others are for the database, blocks and workers.

    >>> 0 < most_connections() <= resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    True
    """
    return max(1, min(resource.getrlimit(resource.RLIMIT_NOFILE)[0], 2**16) // 2)


class BoundedConnection(H11Protocol):
    """A connection that is closed when there are too many, or when it waits too long without a request under way.

    Without this a client that sends heads a byte at a time, and none to its end, takes every file that the process may open.
    """

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take the connection, or close it at once."""
        super().connection_made(transport)
        if len(self.connections) > most_connections():
            transport.abort()
        else:
            self._watch()

    def data_received(self, data: bytes) -> None:
        """Read on."""
        super().data_received(data)
        self._watch()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        super().on_response_complete()
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing is waited for any more."""
        self._stop_watching()
        super().connection_lost(exc)

    def _watch(self) -> None:
        """Wait for a head from now on, unless one is waited for already or a request is under way."""
        if self.cycle is not None and not self.cycle.response_complete:
            self._stop_watching()
        elif self._deadline is None:
            self._deadline = self.loop.call_later(ASK_WITHIN, self.transport.abort)

    def _stop_watching(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None
