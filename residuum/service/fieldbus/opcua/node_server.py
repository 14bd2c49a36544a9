"""NodeServer: an OPC UA server of values as nodes, with their own time stamps and status: a simulated machine's, or findings."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import Any

from asyncua import Server, ua

logging.getLogger("asyncua").setLevel(logging.CRITICAL)
NAMESPACE = "urn:residuum:machines"


class NodeServer:
    """Nodes `ns=2;s=FOLDER.NAME` below a folder each; made when they are first written.

    Parameters
    ----------
    url : str
        `opc.tcp://127.0.0.1:4840/residuum/`.
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._server = Server()
        self._nodes: dict[tuple[str, str], Any] = {}
        self._folders: dict[str, Any] = {}
        self._space = 2

    async def start(self, declared: Mapping[str, Iterable[str]] | None = None) -> None:
        """Begin to serve; `declared` are numbers (folder → names) that clients find at once, not good before they are written."""
        await self._server.init()
        self._server.set_endpoint(self._url)
        self._server.set_server_name("Residuum")
        self._server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        self._space = await self._server.register_namespace(NAMESPACE)
        for folder, names in (declared or {}).items():
            for name in names:
                await self.write(folder, name, 0.0, time.time(), ua.StatusCodes.BadWaitingForInitialData)
        await self._server.start()

    async def stop(self) -> None:
        """End all sessions."""
        await self._server.stop()

    async def write(self, folder: str, name: str, value: Any, stamp: float, status: int = ua.StatusCodes.Good) -> None:
        """A value of a node at a time [s since 1970]."""
        node = await self._node(folder, name, value)
        at = datetime.fromtimestamp(stamp, UTC)
        told = ua.DataValue(_variant(value), StatusCode=ua.StatusCode(status), SourceTimestamp=at, ServerTimestamp=at)
        await node.write_value(told)

    async def _node(self, folder: str, name: str, value: Any) -> Any:
        if (folder, name) not in self._nodes:
            if folder not in self._folders:
                place = ua.NodeId(folder, self._space)
                self._folders[folder] = await self._server.nodes.objects.add_folder(place, f"{self._space}:{folder}")
            identifier = ua.NodeId(f"{folder}.{name}", self._space)
            self._nodes[folder, name] = await self._folders[folder].add_variable(
                identifier, f"{self._space}:{name}", _variant(value)
            )
        return self._nodes[folder, name]


def _variant(value: Any) -> ua.Variant:
    if isinstance(value, bool):
        return ua.Variant(value, ua.VariantType.Boolean)
    if isinstance(value, str):
        return ua.Variant(value, ua.VariantType.String)
    return ua.Variant(float(value), ua.VariantType.Double)
