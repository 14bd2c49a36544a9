"""Source: one connection to a bus, read in a thread of its own; hands blocks of samples to a sink."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence

from residuum.service.fieldbus.block import Block, StreamFormat
from residuum.service.fieldbus.health import SourceHealth

Sink = Callable[[Block], bool]
"""Takes a block; False when it has no room and the block is dropped (the source counts it)."""


class FaultsUnavailable(Exception):
    """A source cannot switch faults: it has no command for it, or its device does not answer."""


class Source(ABC):
    """A bus connection that lives in its own thread and outlives every failure of the device.

    Parameters
    ----------
    name : str
        Shown with its counters: the bus address.
    sink : callable
        Takes each block; called in the source's thread.
    """

    def __init__(self, name: str, sink: Sink) -> None:
        self.name = name
        self.health = SourceHealth()
        self._sink = sink
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"source {name}", daemon=True)

    @property
    @abstractmethod
    def streams(self) -> Sequence[StreamFormat]:
        """The streams that this source delivers."""

    @property
    def fault_ids(self) -> Sequence[str]:
        """Faults that the device on this bus can switch (simulated devices only)."""
        return []

    @property
    def fault_sizes(self) -> Mapping[str, float]:
        """Sizes of the faults that are on, as the device reports them."""
        return {}

    def switch_fault(self, fault: str, size: float) -> None:
        """Ask the device to switch a fault: 0 clears it, a negative size means its default. FaultsUnavailable when it cannot."""
        raise FaultsUnavailable(f"{self.name}: cannot switch fault {fault!r}")

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """Ask the thread to end; `join` waits for it."""
        self._stopped.set()

    def join(self, timeout: float = 5.0) -> None:
        """Wait for the thread's end."""
        if self._thread.ident is not None:
            self._thread.join(timeout)

    @abstractmethod
    def _run(self) -> None:
        """Read until stopped; never raises."""

    def _deliver(self, block: Block, frames: int) -> None:
        """Hand on a block, then count it: whoever reads the counters finds every counted sample delivered."""
        if not self._sink(block):
            self.health.count("queue_drops", block.n, f"{block.stream}: {block.n} samples dropped, the windows are behind")
        self.health.received(frames, block.n)
