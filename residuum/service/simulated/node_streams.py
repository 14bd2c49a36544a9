"""NodeStreams: a simulated machine's slow streams as nodes of an OPC UA server of its own."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadInput


class NodeStreams:
    """Nodes `ns=2;s=MACHINE.STREAM.CHANNEL`, each value with the time at which the machine had it.

    Parameters
    ----------
    url : str
    machine : str
    streams : names of the streams that are offered
    speed : float
        How many times faster than real time the machine lives.
    """

    def __init__(self, url: str, machine: str, streams: Collection[str], speed: float) -> None:
        try:
            self._server: Any = import_module("residuum.service.fieldbus.opcua.node_server").NodeServer(url)
        except ModuleNotFoundError:
            raise BadInput("--opcua: needs the extra `opcua`: pip install 'residuum[opcua]'") from None
        self._machine, self._streams, self._speed = machine, streams, speed
        self._begun = time.time()
        self._lived = dict.fromkeys(streams, 0)
        self._waiting: list[tuple[str, float, float]] = []

    async def start(self) -> None:
        """Begin to serve."""
        await self._server.start()

    async def stop(self) -> None:
        """End all sessions."""
        await self._server.stop()

    def take(self, stream: str, channels: Mapping[str, npt.NDArray[np.float64]], sample_time: float) -> None:
        """Samples that the machine gave; `write` offers them."""
        if stream not in self._streams:
            return
        first = self._lived[stream]
        for name, values in channels.items():
            stamps = self._begun + (first + np.arange(len(values))) * sample_time / self._speed
            self._waiting += [(f"{stream}.{name}", *pair) for pair in zip(values.tolist(), stamps.tolist(), strict=True)]
            self._lived[stream] = first + len(values)

    async def write(self) -> None:
        """Offer what waits."""
        waiting, self._waiting = self._waiting, []
        for node, value, stamp in waiting:
            await self._server.write(self._machine, node, value, stamp)
