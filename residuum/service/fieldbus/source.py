"""Source: one connection to a bus, read in a thread of its own; hands blocks of samples to a
sink.
"""

from __future__ import annotations

import random
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.health import SourceHealth

# Backoff: how long to wait before the next attempt to reach a device that does not answer.


class Backoff:
    """Waits that double from `first` to `longest` seconds, each spread by ±50 % so that many
    sources do not knock in step.

    Examples
    --------
    >>> backoff = Backoff(first=1.0, longest=4.0, seed=0)
    >>> waits = [backoff.next() for _ in range(4)]
    >>> all(low / 2 <= wait <= low * 1.5 for wait, low in zip(waits, (1, 2, 4, 4)))
    True
    """

    def __init__(self, first: float = 0.1, longest: float = 2.5, seed: int | None = None) -> None:
        self._first, self._longest = first, longest
        self._random = random.Random(seed)
        self._wait = first

    def next(self) -> float:
        """Seconds to wait now."""
        wait = self._wait
        # doubled without the spread: a short wait by chance must not keep the next ones short
        self._wait = min(2 * wait, self._longest)
        return wait * self._random.uniform(0.5, 1.5)

    def reset(self) -> None:
        """Begin anew after a success."""
        self._wait = self._first


# Block: samples of one stream, as they left the bus, each with its place on the stream's own
# clock.

Samples = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class StreamFormat:
    """What a stream carries: evenly sampled channels with units on one clock.

    Parameters
    ----------
    name : str
        Name within its machine.
    sample_time : float
        Seconds between samples.
    units : mapping of channel to unit
    """

    name: str
    sample_time: float
    units: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Block:
    """Samples of one stream.

    `number[k]` is the place of sample k on the stream's clock (sample time × number = seconds).
    Numbers are unique over the life of a source and mostly rise; a hole is a loss, and a late
    sample fills its hole.

    Parameters
    ----------
    stream : str
    number : int64 array, shape (n,)
    channels : mapping of name to float array, shape (n,)
    """

    stream: str
    number: Numbers
    channels: Mapping[str, Samples]

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(self.number)


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
        """Ask the device to switch a fault: 0 clears it, a negative size means its default.
        FaultsUnavailable when it cannot.
        """
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
        """Hand on a block, then count it: whoever reads the counters finds every counted sample
        delivered. An infinite number is no value that was measured.
        """
        block = self._without_infinite(block)
        if not self._sink(block):
            self.health.count(
                "queue_drops",
                block.n,
                f"{block.stream}: {block.n} samples dropped, the windows are behind",
            )
        self.health.received(frames, block.n)

    def _without_infinite(self, block: Block) -> Block:
        infinite = {name: np.isinf(values) for name, values in block.channels.items()}
        many = {name: int(where.sum()) for name, where in infinite.items() if where.any()}
        if not many:
            return block
        self.count_no_value(many)
        finite = {
            name: np.where(infinite[name], np.nan, values)
            for name, values in block.channels.items()
        }
        return Block(block.stream, block.number, finite)

    def count_no_value(self, many: Mapping[str, int]) -> None:
        """Count values that say that there is none: channel → how many, of those that have some."""
        for name, count in many.items():
            self.health.count("no_value", count, f"channel {name!r}: says that it has no value")
