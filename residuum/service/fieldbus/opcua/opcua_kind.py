"""OPC UA as a kind of source."""

from __future__ import annotations

import asyncio
import urllib.parse

from residuum.service.fieldbus.opcua.node_map import read_node_map
from residuum.service.fieldbus.source import Sink, Source
from residuum.service.fieldbus.source_kind import (
    Address,
    SourceKind,
    Wrong,
    of_extra,
    text_of_map,
)

# Of an address that says none: the port registered for OPC UA.
_PORT = 4840


def _open(source: Address, sink: Sink) -> Source:
    nodes = read_node_map(source.map_file)
    module = of_extra("residuum.service.fieldbus.opcua.opcua_source", "an OPC UA source", "opcua")
    opened: Source = module.OpcuaSource(source.channel, nodes, sink)
    return opened


def _check(source: Address) -> None:
    if not source.channel.startswith("opc.tcp://"):
        raise ValueError(
            "an OPC UA source needs a channel, for example opc.tcp://192.168.0.10:4840"
        )


def _look(source: Address, seconds: float) -> str:
    """A connection alone: whether the nodes are there shows when the service reads them."""
    streams = len(read_node_map(source.map_file).streams)
    url = urllib.parse.urlsplit(source.channel)
    host, port = url.hostname or "", url.port or _PORT
    address = f"{host}:{port}"
    try:
        asyncio.run(asyncio.wait_for(_connect(host, port), seconds))
    except OSError as error:
        raise Wrong(f"{address}: no connection: {error or 'timed out'}") from None
    return f"{address} accepts connections; {source.map} has {streams} streams"


async def _connect(host: str, port: int) -> None:
    _, writer = await asyncio.open_connection(host, port)
    writer.close()


OPCUA = SourceKind(
    called="OPC UA",
    open=_open,
    map_called="node map (OPC UA)",
    asked="OPC UA server, for example opc.tcp://192.168.0.10:4840.",
    example="opc.tcp://host:4840",
    texts={"nodes": text_of_map("a map of OPC UA's nodes", read_node_map)},
    check=_check,
    look=_look,
    template=(
        '- {kind: opcua, channel: "opc.tcp://192.168.0.10:4840", map: nodes.yaml}  ',
        "map: `residuum opcua browse`",
    ),
)
