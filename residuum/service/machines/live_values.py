"""LiveValues: what the signals of a machine read now, and over the last half minute."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from residuum.service.fieldbus.block import Block

_EVERY = 0.2
"""Seconds between two points of the history."""
_POINTS = 150


class LiveValues:
    """The newest value of every signal and a short history, safe to use from any thread.

    Parameters
    ----------
    channels : mapping
        The diagnoser's name of a signal → the bus's.
    clock : callable
        Monotonic seconds.
    """

    def __init__(self, channels: Mapping[str, str], clock: Callable[[], float] = time.monotonic) -> None:
        self._name_of = {bus: name for name, bus in channels.items()}
        self._clock = clock
        self._lock = threading.Lock()
        self._newest: dict[str, float] = {}
        self._history: dict[str, deque[tuple[float, float]]] = {}
        self._noted: dict[str, float] = {}
        self._seen: float | None = None

    def take(self, block: Block) -> None:
        """Note the last value of each signal of a block."""
        now = self._clock()
        with self._lock:
            self._seen = now
            due = now - self._noted.get(block.stream, -np.inf) >= _EVERY
            if due:
                self._noted[block.stream] = now
            for name, values in block.channels.items():
                if len(values):
                    self._newest[name] = float(values[-1])
                    if due:
                        self._history.setdefault(name, deque(maxlen=_POINTS)).append((now, float(values[-1])))

    def now(self) -> dict[str, Any]:
        """By the bus's name of each signal: `name` (the diagnoser's), `value`, and `history` with ages [s] and values."""
        now = self._clock()
        with self._lock:
            return {
                bus: {
                    "name": self._name_of.get(bus, bus),
                    "value": value,
                    "age": now - (self._seen if self._seen is not None else now),
                    "history": {
                        "seconds": [at - now for at, _ in self._history.get(bus, ())],
                        "values": [each for _, each in self._history.get(bus, ())],
                    },
                }
                for bus, value in self._newest.items()
            }
