"""FindingNodes: the latest finding and alarm of every machine, offered as nodes of an OPC UA server
of our own.

For a machine `press-1` there are `ns=2;s=press-1.verdict`, `….class`, `….reason`,
`….indicator.NAME` and, once it has had one, `….alarm` with its state; a client subscribes to them,
and at the object Server to the alarms' events. Nothing is written back: clients read.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

import structlog

from residuum.service.fieldbus.opcua.node_server import Entrance, NodeServer
from residuum.service.security.access import LONGEST_NAME, ApiKeys, Role
from residuum.service.settings import Settings

log = structlog.get_logger()
# [s] Between looks for news, which come a window at a time; one look serves all machines.
_TICK = 0.05
# [s] For the server to start, and for its sessions to end: a certificate may have to be made.
_STARTING = 30.0


class FindingNodes:
    """Serves in a thread of its own; of news that wait, a machine's latest finding and each alarm's
    latest change are kept.

    Parameters
    ----------
    url : str
        `opc.tcp://0.0.0.0:4840/residuum/`.
    entrance : Entrance, optional
        Who may read; without one: anybody.
    """

    def __init__(self, url: str, entrance: Entrance | None = None) -> None:
        self._url, self._entrance = url, entrance
        self._news: dict[tuple[str, str, str], Mapping[str, Any]] = {}
        self._lock = threading.Lock()
        self._stopped, self._begun = threading.Event(), threading.Event()
        self._trouble: Exception | None = None
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve()), name="opcua findings", daemon=True
        )

    def start(self) -> None:
        """Begin to serve.

        Raises
        ------
        OSError
            The address cannot be taken.
        """
        self._thread.start()
        self._begun.wait(_STARTING)
        if self._trouble is not None:
            raise OSError(f"OPC UA server at {self._url}: {self._trouble}")

    def stop(self) -> None:
        """End all sessions."""
        self._stopped.set()
        self._thread.join(_STARTING)

    def tell(self, kind: str, payload: Mapping[str, Any]) -> None:
        """A finding or an alarm that has been stored; anything else is left."""
        if kind not in ("finding", "alarm"):
            return
        with self._lock:
            self._news[kind, str(payload["asset"]), str(payload.get("kind", ""))] = payload

    async def _serve(self) -> None:
        server = NodeServer(self._url, self._entrance)
        try:
            await server.start()
        except Exception as error:  # told to who started it
            self._trouble = error
            with suppress(Exception):
                await server.stop()
            return
        finally:
            self._begun.set()
        while not self._stopped.is_set():
            # one a turn: a machine whose news come fast has its latest alone, and keeps nobody
            # waiting
            with self._lock:
                first = next(iter(self._news), None)
                payload = self._news.pop(first) if first is not None else {}
            if first is None:
                await asyncio.sleep(_TICK)
                continue
            try:
                await _offer(server, first[0], payload)
            except Exception as error:  # a finding that cannot be shown must not end the others
                log.error(
                    "a finding cannot be offered over OPC UA",
                    asset=payload.get("asset"),
                    reason=str(error),
                )
        await server.stop()


async def _offer(server: NodeServer, kind: str, payload: Mapping[str, Any]) -> None:
    asset = str(payload["asset"])
    if kind == "alarm":
        await server.write(asset, "alarm", str(payload["state"]), _seconds(None))
        await server.tell_alarm(payload, datetime.now(UTC))
        return
    stamp = _seconds(payload["at"])
    for name in ("verdict", "class", "reason"):
        await server.write(asset, name, str(payload.get(name) or ""), stamp)
    for name, value in (payload.get("indicators") or {}).items():
        if isinstance(value, int | float):
            await server.write(asset, f"indicator.{name}", float(value), stamp)


def entrance_of(settings: Settings, keys: ApiKeys) -> Entrance | None:
    """Who may read the findings: holders of a key that may read all of them, by its name and
    itself; None: anybody.
    """

    def lets_in(name: str, key: str) -> bool:
        caller = keys.caller(key)
        may = (
            caller is not None
            and caller.name == name
            and caller.role >= Role.VIEWER
            # A server has one tree of nodes for all its clients: a key of some sites would see the
            # others.
            and caller.sites is None
        )
        if not may:
            log.warning("refused at the OPC UA server", by=name[:LONGEST_NAME])
        return may

    return None if settings.opcua_anonymous else Entrance(settings.data / "opcua", lets_in)


def _seconds(at: Any) -> float:
    """Seconds since 1970 of an instant; now, where there is none."""
    return (at if isinstance(at, datetime) else datetime.now().astimezone()).timestamp()
