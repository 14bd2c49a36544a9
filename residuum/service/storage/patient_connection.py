"""A connection to PostgreSQL that gives up a server from which nothing comes any more, as in a
network that is partitioned.

Keepalives and TCP's own timeouts notice a peer that is gone, but not one behind a proxy that still
takes what is sent. So each wait for an answer has a longest silence. The server is told, too, how
long a session may be idle in a transaction: one whose client is gone would keep its locks, and with
them hold up every other writer, until its system notices.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping
from typing import Any

import psycopg

from residuum.service.storage.database import SILENCE

CONNECT_WITHIN = 5
"""Seconds in which a server must take a connection."""
# Settings of the connection's socket [s; the last one ms]. A peer that is gone is noticed after 5 +
# 3 · 2 = 11 s, and after 10 s where data wait to be confirmed.
_KEEPALIVE = {
    "keepalives": 1,
    "keepalives_idle": 5,
    "keepalives_interval": 2,
    "keepalives_count": 3,
    "tcp_user_timeout": 10_000,
}
# Settings of each session [ms, s], so that the server lets go of one whose client is gone.
_OF_SESSIONS = {
    "idle_in_transaction_session_timeout": 10_000,
    "tcp_keepalives_idle": 5,
    "tcp_keepalives_interval": 2,
    "tcp_keepalives_count": 3,
}


class PatientConnection(psycopg.Connection[Any]):
    """A connection whose waits end with OperationalError, and with the connection, after `patience`
    seconds of silence.
    """

    patience: float = SILENCE

    def wait(self, gen: Generator[Any, Any, Any], *arguments: Any, **more: Any) -> Any:
        """Wait for what the server says."""
        return super().wait(self._watched(gen), *arguments, **more)

    def _watched(self, generator: Generator[Any, Any, Any]) -> Generator[Any, Any, Any]:
        """The same steps; silence that is too long ends them, and what the server did meanwhile is
        unknown.
        """
        try:
            # psycopg's generators yield what they wait for, and are sent what is ready; nothing is,
            # after each of its own short waits.
            step = next(generator)
            heard = time.monotonic()
            while True:
                ready = yield step
                if ready:
                    heard = time.monotonic()
                elif time.monotonic() - heard > self.patience:
                    # Closed, not cancelled: to cancel would ask the silent server, too.
                    self.pgconn.finish()
                    raise psycopg.OperationalError(
                        f"the server has been silent for {self.patience:g} s"
                    )
                step = generator.send(ready)
        except StopIteration as end:
            return end.value


def connect(arguments: list[Any], options: Mapping[str, Any]) -> PatientConnection:
    """A new connection with the timeouts of this module, as far as the URL says nothing else."""
    session = " ".join(f"-c {name}={value}" for name, value in _OF_SESSIONS.items())
    # What the URL says goes over the timeouts of this module.
    given = {"connect_timeout": CONNECT_WITHIN, **_KEEPALIVE, **options}
    given["options"] = f"{session} {options.get('options', '')}".strip()
    return PatientConnection.connect(*arguments, **given)
