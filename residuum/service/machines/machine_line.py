"""MachineLine: the way of one machine's signals from its buses to stored findings."""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import structlog

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.nearest_names import known_names
from residuum.service.alarms.machine_states import unknown_states
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.fieldbus.source import Block
from residuum.service.machines.adding import named, units_of_windows
from residuum.service.machines.machine_state import (
    LATE,
    SOON,
    LiveValues,
    MachineState,
    state_of_judging,
)
from residuum.service.machines.windows import make_cutter

log = structlog.get_logger()

# Blocks that wait to be cut; of more, new ones are dropped and counted by their source.
_MOST_BLOCKS = 4096
# So many windows wait at least, and more as long as their samples take no more than so many bytes:
# a database that is away for ten minutes is waited for.
_MOST_WINDOWS, _MOST_BYTES = 32, 16 * 2**20
# Windows under way: while one waits for the disk, the next is judged; at ten rounds a second they
# waited for it in turn.
_AT_ONCE = 2
# [s] How long it takes at most to notice that the machine is watched no more.
_WAIT = 0.2
# [s] For a thread to finish what it is at when the service stops.
_LAST_WINDOW = 3.0

Handle = Callable[
    [MachineSettings, Record, str | None, threading.Event], Callable[[], Finding | None]
]
"""Begins with a window: (machine, window, file of the baseline or None to record it only, stopped).
The call that it returns ends it, in the windows' order, and gives the finding that was stored, if
any was.
"""
Changed = Callable[[str], None]
"""Told when the state of the machine of this name has changed."""


class MachineLine:
    """One machine: its sources, the cutter of its windows, and the judging of them, each in a
    thread of its own.

    No part waits for the one behind it: blocks and windows that find no room are dropped and
    counted, and a failure of one machine stays with it.

    Parameters
    ----------
    settings : MachineSettings
    handle : callable
        Has a window judged and kept, or sends it to where that is done; the next window is begun
        while one is being kept.
    changed : callable

    Raises
    ------
    BadInput
        A bus description that cannot be read, or streams from which these windows cannot be cut.
    """

    def __init__(self, settings: MachineSettings, handle: Handle, changed: Changed) -> None:
        self.settings = settings
        self._handle, self._changed = handle, changed
        self._blocks: queue.Queue[Block] = queue.Queue(_MOST_BLOCKS)
        self._windows: deque[Record] = deque()
        self._begun: deque[Callable[[], Finding | None]] = deque()
        self._window_came = threading.Event()
        self._stopped = threading.Event()
        self.sources = [
            SOURCES[source.kind](source, partial(self._take, number))
            for number, source in enumerate(settings.sources)
        ]
        streams = {stream.name: stream for source in self.sources for stream in source.streams}
        # a round is cut out of two streams with clocks of their own, any other window out of one
        wanted = list(streams.values())
        if settings.window.cut != "round":
            wanted = wanted[:1]
        units = {name: unit for stream in wanted for name, unit in stream.units.items()}
        _refuse_unknown(settings, units)
        self.units = units_of_windows(settings.channels, units)
        """Unit of each signal of the windows."""
        self._cutter = make_cutter(settings.window, wanted, settings.asset)
        self._source_of = {
            stream.name: number
            for number, source in enumerate(self.sources)
            for stream in source.streams
            if stream in wanted
        }
        self._baseline: str | None = None
        self._recording = False
        self.live = LiveValues(settings.channels)
        self._state, self._progress = MachineState("idle", "waiting for a baseline"), 0.0
        self._not_judged: MachineState | None = None
        self._waits_since = time.monotonic()
        self._window_seconds = settings.window.length if settings.window.cut == "sliding" else 0.0
        self._told = self._state
        self._judged = self._recorded = self._dropped = self._errors = 0
        self._last: tuple[float, Finding] | None = None
        self._threads = [
            threading.Thread(target=self._cut, name=f"windows {settings.asset}", daemon=True),
            threading.Thread(target=self._judge, name=f"judge {settings.asset}", daemon=True),
        ]

    def start(self) -> None:
        """Begin to read and to cut; judging begins with the baseline."""
        for thread in self._threads:
            thread.start()
        for source in self.sources:
            source.start()

    def stop(self) -> None:
        """Stop reading, finish the window that is being judged, and keep what was stored."""
        self._stopped.set()
        self._window_came.set()
        # all are asked first: they end side by side
        for source in self.sources:
            source.stop()
        for source in self.sources:
            source.join()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(_LAST_WINDOW)

    def record_windows(self, doing: str) -> None:
        """Keep windows from now on although nothing can judge them: a baseline is to be trained
        from them.
        """
        self._baseline, self._recording = None, True
        self.set_state("recording", 0.0, doing)
        self._window_came.set()

    def use_baseline(self, file: str) -> None:
        """Judge from now on with the trained diagnoser in this file."""
        self._baseline, self._recording = file, False
        self._waits_since = time.monotonic()
        self.set_state("running", 1.0, "judging windows")
        self._window_came.set()

    def set_state(self, state: str, progress: float, doing: str, way_on: str = "") -> None:
        """What the interface shows: idle, recording, training, running or failed, how far, and what
        is being done.

        Of a machine that is `running`, `state` tells besides whether its windows are being judged
        now.
        """
        machine_state = MachineState(state, doing, way_on)
        if (machine_state, round(progress, 2)) != (self._state, round(self._progress, 2)):
            self._state, self._progress = machine_state, progress
            self._changed(self.settings.asset)

    def state(self) -> MachineState:
        """The state of this moment: `running` while windows are being judged, else what the machine
        waits for.
        """
        silent, late = self._silent(), self._late()
        if self._state.state == "running":
            waiting = len(self._windows) + len(self._begun)
            judging = state_of_judging(
                self.settings.window.cut, silent, waiting, judged=self._judged > 0, late=late
            )
            return self._not_judged or judging
        if self._state.state == "recording" and silent and late:
            return replace(
                state_of_judging("sliding", silent, 0, judged=False, late=True), state="recording"
            )
        return self._state

    def tell_of_time(self) -> MachineState | None:
        """Tell when the state became another one by time alone; gives the new state then."""
        now = self.state()
        if now == self._told:
            return None
        self._told = now
        self._changed(self.settings.asset)
        return now

    def _late(self) -> bool:
        return time.monotonic() - self._waits_since > max(SOON, LATE * self._window_seconds)

    def _silent(self) -> list[str]:
        """The sources that give nothing, each with its last trouble; none unless all of the windows
        wait for it.
        """
        silences = [(source.name, source.health.silence()) for source in self.sources]
        return [f"{name} {silence}" for name, silence in silences if silence]

    def status(self) -> dict[str, Any]:
        """State, progress, and what became of the windows."""
        last, now = self._last, self.state()
        return {
            "state": now.state,
            "progress": self._progress,
            "doing": now.doing,
            "way_on": now.way_on,
            "diagnoser": self.settings.diagnoser,
            "sources": [source.name for source in self.sources],
            "simulated": any(source.fault_ids for source in self.sources),
            "windows_judged": self._judged,
            "windows_recorded": self._recorded,
            "windows_waiting": len(self._windows) + len(self._begun),
            "windows_dropped": self._dropped,
            "scoring_errors": self._errors,
            "last_finding_at": None if last is None else last[0],
            "last_verdict": None if last is None else str(last[1].verdict.value),
        }

    def source_status(self) -> Mapping[str, dict[str, Any]]:
        """Counters and rates of every source of this machine."""
        return {
            f"{self.settings.asset} {source.name}": {
                "machine": self.settings.asset,
                "streams": [stream.name for stream in source.streams],
                **source.health.snapshot(),
            }
            for source in self.sources
        }

    def _take(self, source: int, block: Block) -> bool:
        """Queue a block; where two sources describe a stream of one name, the one that is listed
        last carries it.
        """
        if self._source_of.get(block.stream) != source:
            return True
        self.live.take(block)
        try:
            self._blocks.put_nowait(block)
        except queue.Full:
            return False
        return True

    def _cut(self) -> None:
        while not self._stopped.is_set():
            try:
                block = self._blocks.get(timeout=_WAIT)
            except queue.Empty:
                continue
            try:
                windows = self._cutter.push(block)
            # whatever a cutter raises
            except Exception:
                # one block must never end the machine's thread; it is counted and logged
                self._errors += 1
                log.exception("cutting windows", machine=self.settings.asset)
                continue
            for window in windows:
                self._add_window(named(window, self.settings.channels))

    def _add_window(self, window: Record) -> None:
        self._window_seconds = max(self._window_seconds, window.duration)
        self._windows.append(window)
        while len(self._windows) > _MOST_WINDOWS and sum(map(_bytes, self._windows)) > _MOST_BYTES:
            self._windows.popleft()
            self._dropped += 1
        self._window_came.set()

    def _judge(self) -> None:
        while not self._stopped.is_set():
            if (
                (self._baseline is not None or self._recording)
                and self._windows
                and len(self._begun) < _AT_ONCE
            ):
                self._safely(partial(self._begin, self._windows.popleft(), self._baseline))
            elif self._begun:
                self._safely(self._end_first)
            else:
                self._window_came.wait(_WAIT)
                self._window_came.clear()
        # what is being judged when the service stops is stored, too
        while self._begun:
            self._safely(self._end_first)

    def _safely(self, step: Callable[[], None]) -> None:
        try:
            step()
        except Exception as error:
            # one window must never end the machine's thread; it is counted and logged
            self._errors += 1
            if not self._stopped.is_set():  # else its worker was ended with the service
                log.exception("judging a window", machine=self.settings.asset, reason=str(error))
                reason = f"windows cannot be judged: {type(error).__name__}: {error}"
                way_on = f"see the log; train it anew: residuum watch train {self.settings.asset}"
                self._not_judged = MachineState("failed", " ".join(reason.split()), way_on)

    def _begin(self, window: Record, baseline: str | None) -> None:
        self._begun.append(self._handle(self.settings, window, baseline, self._stopped))

    def _end_first(self) -> None:
        finding = self._begun.popleft()()
        if finding is not None and finding.only_recorded:
            self._recorded += 1
            self._waits_since = time.monotonic()
        elif finding is not None:
            self._judged += 1
            self._not_judged, self._waits_since = None, time.monotonic()
            self._last = (time.time(), finding)


def _bytes(window: Record) -> int:
    return sum(signal.nbytes for signal in window.channels.values())


def unreadable(settings: MachineSettings, reason: str) -> dict[str, Any]:
    """The status of a machine that was added once and can no longer be read."""
    counters = ("judged", "recorded", "waiting", "dropped")
    return {
        "state": "failed",
        "progress": 0.0,
        "doing": f"cannot be watched: {reason}",
        "way_on": "put what it needs back, or add it again",
        "diagnoser": settings.diagnoser,
        "sources": [],
        "simulated": False,
        **{f"windows_{name}": 0 for name in counters},
        "scoring_errors": 0,
        "last_finding_at": None,
        "last_verdict": None,
    }


def _refuse_unknown(settings: MachineSettings, units: Mapping[str, str]) -> None:
    """BadInput for a name in `channels`, or in `suppress` of its alarms, that the bus has not, or
    has in another kind of unit.

    Parameters
    ----------
    units : mapping
        Name on the bus → unit.
    """
    for name, bus in settings.channels.items():
        if bus not in units:
            known = known_names(bus, sorted(units), "it has")
            raise BadInput(
                f"machine {settings.asset!r}, channels, {name}: the bus has no signal {bus!r};"
                f" {known}"
            )
    # only its own rule: one of the service names signals that other machines have
    if settings.alarms is not None:
        of_windows = units_of_windows(settings.channels, units)
        for says in unknown_states(settings.alarm_rule(settings.alarms), of_windows):
            raise BadInput(f"machine {settings.asset!r}, alarms, suppress: {says}")
