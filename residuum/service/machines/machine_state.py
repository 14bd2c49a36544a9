"""MachineState: whether a machine's windows are being judged now, and if not, what it waits for and
what would help.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from residuum.service.fieldbus.source import Block

# LiveValues: what the signals of a machine read now, and over the last half minute.

# Seconds between two points of the history.
_EVERY = 0.2
# Half a minute of them.
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

    def __init__(
        self, channels: Mapping[str, str], clock: Callable[[], float] = time.monotonic
    ) -> None:
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
            # the value of now is always the newest one; the history alone is thinned
            due = now - self._noted.get(block.stream, -np.inf) >= _EVERY
            if due:
                self._noted[block.stream] = now
            for name, values in block.channels.items():
                if len(values):
                    self._newest[name] = float(values[-1])
                    if due:
                        self._history.setdefault(name, deque(maxlen=_POINTS)).append(
                            (now, float(values[-1]))
                        )

    def now(self) -> dict[str, Any]:
        """By the bus's name of each signal: `name` (the diagnoser's), `value`, and `history` with
        ages [s] and values.
        """
        now = self._clock()
        with self._lock:
            return {
                bus: {
                    "name": self._name_of.get(bus, bus),
                    "value": value,
                    "age": now - (self._seen if self._seen is not None else now),
                    "history": {
                        "seconds": [at - now for at, _ in self._history.get(bus, ())],
                        "values": [sample for _, sample in self._history.get(bus, ())],
                    },
                }
                for bus, value in self._newest.items()
            }


STATES = ("idle", "recording", "training", "running", "waiting", "failed")
"""Every state that a machine can be in."""
LATE = 3.0
"""Lengths of a window without a judged one, after which a machine is late."""
SOON = 30.0
"""Seconds within which no machine is late, however short its windows are."""

_NEXT = {
    "movement": "the machine's next movement",
    "round": "the next whole round",
    "sliding": "the next whole window",
}
_BUS = "look at the device and its bus; `residuum doctor` tries each"
_WORKERS = (
    "give the service more `workers`, or see in its log whether the disk takes what it stores"
)
_LOSSES = "see at its sources how many samples are lost: no window reaches across a pause"


@dataclass(frozen=True)
class MachineState:
    """A state, a sentence on what is being done or waited for, and what a person can do; nothing
    where nothing is wrong.
    """

    state: str
    doing: str
    way_on: str = ""


def state_of_judging(
    cut: str, silent: Sequence[str], waiting: int, *, judged: bool, late: bool
) -> MachineState:
    """The state of a machine that has a baseline.

    Parameters
    ----------
    cut : str
        How its windows are cut.
    silent : sequence of str
        Its sources that give nothing, each with what is known of it.
    waiting : int
        Windows that are not judged and stored yet.
    judged : bool
        Whether any window was judged since the baseline was taken up.
    late : bool
        Whether the last one is longer ago than some lengths of a window.
    """
    if judged and not late:
        return MachineState("running", "judging windows")
    # the first that explains the others: without data no window comes, without windows none waits
    if silent:
        return MachineState(
            "waiting", f"waiting for data: {'; '.join(silent)}", _BUS if late else ""
        )
    if waiting:
        return MachineState(
            "waiting", "waiting until windows are judged and stored", _WORKERS if late else ""
        )
    # a machine that stands still moves nothing and turns no round
    lacking = late and cut == "sliding"
    return MachineState("waiting", f"waiting for {_NEXT[cut]}", _LOSSES if lacking else "")


def counted(states: Mapping[str, Mapping[str, object]]) -> dict[str, int]:
    """How many machines are in each state, from what each of them tells."""
    state_names = [state.get("state") for state in states.values()]
    return {state: state_names.count(state) for state in STATES}


def troubled(states: Mapping[str, Mapping[str, object]]) -> dict[str, dict[str, object]]:
    """The machines that somebody should look after: state, reason and way on of each."""
    return {
        name: {"state": state.get("state"), "reason": state.get("doing"), "way_on": state["way_on"]}
        for name, state in states.items()
        if state.get("way_on")
    }
