"""CanSource: streams of samples from a CAN bus, decoded in blocks after a DBC file."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import can
import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.can.can_bus import CanBus, open_bus
from residuum.service.fieldbus.can.frame_batch import FrameBatch
from residuum.service.fieldbus.can.frame_layout import (
    BadBusDescription,
    BusMessages,
    FrameLayout,
    source_of,
)
from residuum.service.fieldbus.can.frame_matching import FrameMatching, several_sources
from residuum.service.fieldbus.can.packets import Packets, WholeMessages
from residuum.service.fieldbus.sequence import BREAK, Placed, SequenceCounter
from residuum.service.fieldbus.source import (
    Backoff,
    Block,
    FaultsUnavailable,
    Sink,
    Source,
    StreamFormat,
)

# Seconds that one read waits for a frame: how long it takes at most to notice that it was stopped.
_POLL = 0.1
# How long frames wait in the bus's own buffer, so that they are decoded together [s]; some buses
# keep some hundred.
_GATHER = 0.01
COMMAND, STATE = "FAULT_COMMAND", "FAULT_STATE"


def streamed(layouts: Mapping[str, FrameLayout]) -> list[FrameLayout]:
    """The messages that carry streams of samples, those with a counter first; BadBusDescription
    when there are none.
    """
    streams = [
        layout
        for layout in layouts.values()
        if not layout.why_no_stream and layout.name not in (COMMAND, STATE)
    ]
    if not streams:
        why = [
            f"message {layout.name} {layout.why_no_stream}"
            for layout in layouts.values()
            if layout.why_no_stream
        ]
        where = "bus"
        if isinstance(layouts, BusMessages):
            where, why = layouts.where, [*why, *layouts.unusable.values()]
        raise BadBusDescription(
            f"{where}: has nothing to stream: {'; '.join(why) or 'no message has signals'}"
        )
    return sorted(streams, key=lambda layout: layout.counter_bits == 0)


class CanSource(Source):
    """Streams from the CAN frames that a DBC file describes.

    Parameters
    ----------
    channel : str
        Bus address, see `can_bus.open_bus`.
    layouts : mapping of message name to FrameLayout
        Messages with a time between frames become streams, those with a counter first;
        `FAULT_COMMAND` and `FAULT_STATE` switch the faults of simulated machines.
    sink : callable

    Raises
    ------
    BadBusDescription
        No message can be streamed; each is named with the reason.
    """

    def __init__(self, channel: str, layouts: Mapping[str, FrameLayout], sink: Sink) -> None:
        super().__init__(channel, sink)
        self.channel = channel
        self._streamed = streamed(layouts)
        self._matching = FrameMatching(layouts.values())
        self._long = [layout for layout in layouts.values() if layout.in_packets]
        self._sources: dict[str, set[int]] = {}
        """J1939 message of any device → source addresses from which it came."""
        self.health.remarks = [
            f"message {layout.name}: {layout.remark}" for layout in self._streamed if layout.remark
        ]
        self._command, self._state = layouts.get(COMMAND), layouts.get(STATE)
        self._faults = {
            name: number
            for number, name in (self._state.choices["fault"] if self._state else {}).items()
        }
        self._sizes: dict[str, float] = {}
        self._places = {layout.bus_id: _place_of(layout) for layout in self._streamed}
        self._bases: dict[int, int] = {}
        self._newest: dict[int, int] = {}
        self._last_seen: dict[int, float] = {}
        self._was_empty = False
        self._clock = time.monotonic
        self._bus: CanBus | None = None

    @property
    def streams(self) -> Sequence[StreamFormat]:
        """One stream a message with a time between frames."""
        return [layout.format for layout in self._streamed]

    @property
    def fault_ids(self) -> Sequence[str]:
        """The faults that the DBC file names."""
        return list(self._faults)

    @property
    def fault_sizes(self) -> Mapping[str, float]:
        """Faults that the last `FAULT_STATE` frames said are on."""
        return {fault: size for fault, size in self._sizes.items() if size}

    def switch_fault(self, fault: str, size: float) -> None:
        """Send a `FAULT_COMMAND` frame."""
        if self._command is None or self._bus is None or fault not in self._faults:
            raise FaultsUnavailable(f"{self.name}: cannot switch fault {fault!r}")
        frame = self._command.encode([0], {"fault": [self._faults[fault]], "size": [size]})
        try:
            self._bus.send(self._command.bus_id, frame[0].tobytes())
        except (OSError, can.CanError) as error:
            raise FaultsUnavailable(f"{self.name}: cannot send the command: {error}") from error

    def _run(self) -> None:
        backoff, opened_before = Backoff(), False
        while not self._stopped.is_set():
            try:
                self._bus = open_bus(self.channel)
                if opened_before:
                    self.health.count("reconnects")
                opened_before = True
                self._read_while_it_works(backoff)
            # ValueError: drivers of python-can raise it where a channel does not fit the interface
            except (OSError, can.CanError, ValueError) as error:
                self.health.count("bus_errors", 1, f"{type(error).__name__}: {error}")
                self._stopped.wait(backoff.next())
            finally:
                self._close()

    def _close(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()

    def _read_while_it_works(self, backoff: Backoff) -> None:
        packets = Packets(self._long)
        while not self._stopped.is_set() and self._bus is not None:
            bus = self._bus
            batch = bus.read(_POLL, WholeMessages(packets=packets))
            # the bus was seen empty: only then is the time since the last frame a silence of the
            # bus
            if batch.empty:
                self._was_empty = True
                continue
            self._take(batch)
            for name, times in packets.given_up():
                self.health.count("lost", times, f"{name}: a packet of it did not come")
            # a bus that opens and gives nothing is not back: frames alone end the longer waits
            backoff.reset()
            self._was_empty = False
            self._stopped.wait(_GATHER)

    def _take(self, batch: FrameBatch) -> None:
        if batch.errors:
            self.health.count("bus_errors", batch.errors, "error frame on the bus")
        if batch.undecodable:
            self.health.count("undecodable", batch.undecodable, "a frame that cannot be unpacked")
        for frame_id, arrays in batch.frames.items():
            layout = self._matching.get(frame_id)
            if layout is not None:
                for frames in arrays:
                    self._take_frames(layout, frame_id, frames)

    def _take_frames(
        self, layout: FrameLayout, frame_id: int, frames: npt.NDArray[np.uint8]
    ) -> None:
        if layout.bus_id in self._places:
            if self._is_meant(layout, frame_id, len(frames)):
                self._take_samples(layout, frames)
        elif layout is self._state and layout.fits(frames.shape[1]):
            self._take_state(layout, frames)

    def _is_meant(self, layout: FrameLayout, frame_id: int, frames: int) -> bool:
        """Whether frames of a message are of the device that is meant: of J1939 the one that the
        DBC file names, else the only one; of several none is read.
        """
        if not layout.is_j1939 or layout.source_address is not None:
            return True
        source, sources = source_of(frame_id), self._sources.setdefault(layout.name, set())
        is_new = source not in sources
        sources.add(source)
        if layout.own_source in sources:
            if is_new and source == layout.own_source and len(sources) > 1:
                self._begin_anew(layout)
            return source == layout.own_source
        if len(sources) > 1:
            self.health.count("undecodable", frames, several_sources(layout, sources))
        return len(sources) == 1

    def _begin_anew(self, layout: FrameLayout) -> None:
        """What came before was another device's."""
        says = (
            f"message {layout.name}: source address 0x{layout.own_source:02X} is read from now on"
        )
        self.health.count("counter_jumps", 1, says)
        self._places[layout.bus_id] = _place_of(layout)
        newest = self._newest.get(layout.bus_id, 0)
        self._bases[layout.bus_id] = (newest // BREAK + 1) * BREAK

    def _take_samples(self, layout: FrameLayout, frames: npt.NDArray[np.uint8]) -> None:
        if not layout.fits(frames.shape[1]):
            self.health.count(
                "undecodable",
                len(frames),
                f"{layout.name}: {frames.shape[1]} bytes, not {layout.length}",
            )
            return
        now = self._clock()
        since = now - self._last_seen.get(layout.bus_id, now)
        self._last_seen[layout.bus_id] = now
        counter, channels = layout.decode(frames)
        self.count_no_value(layout.codes(frames))
        rate = 1.0 / (layout.sample_time * layout.samples)
        # a reader that was held up is no silence where the counter tells how many came
        counted = layout.counter_bits > 0
        placed = self._places[layout.bus_id].place(
            counter, since if self._was_empty or not counted else 0.0, rate
        )
        for name, times in (
            ("lost", placed.lost),
            ("duplicated", placed.duplicated),
            ("reordered", placed.reordered),
        ):
            if times:
                self.health.count(name, times, f"{layout.name}: frames {name}")
        if placed.jumps and counted:
            self.health.count(
                "counter_jumps", placed.jumps, f"{layout.name}: the sequence counter jumped"
            )
        elif placed.jumps:
            self.health.count("pauses", placed.jumps, f"{layout.name}: no frames for {since:.3g} s")
        keep = np.repeat(placed.keep, layout.samples)
        number = (placed.number[:, None] * layout.samples + np.arange(layout.samples)).reshape(-1)
        number += self._bases.get(layout.bus_id, 0)
        self._newest[layout.bus_id] = int(number.max(initial=0))
        block = Block(
            layout.name, number[keep], {name: values[keep] for name, values in channels.items()}
        )
        self._deliver(block, len(frames))

    def _take_state(self, layout: FrameLayout, frames: npt.NDArray[np.uint8]) -> None:
        _, values = layout.decode(frames)
        for number, size in zip(values["fault"], values["size"], strict=True):
            if fault := layout.choices["fault"].get(int(number)):
                self._sizes[fault] = float(size)


def _place_of(layout: FrameLayout) -> SequenceCounter | ArrivalOrder:
    return SequenceCounter(layout.counter_bits) if layout.counter_bits else ArrivalOrder()


# ArrivalOrder: places of frames that carry no counter, as they come; a pause breaks them off.

# [s] A reader that was held up for less finds its frames waiting in the bus's buffer.
_SHORTEST_PAUSE = 0.5
# Of a slow message: some frames' time, in which one may come late without being lost.
_FRAMES_OF_A_PAUSE = 4.0


class ArrivalOrder:
    """Numbers frames in the order in which they come; single losses cannot be seen, and what they
    were worth is not known.

    A time without frames of more than half a second, and of more than four frames' time, is a
    pause: the numbers advance by `BREAK`, and no window reaches across.

    Examples
    --------
    >>> order = ArrivalOrder()
    >>> order.place(np.zeros(3)).number
    array([0, 1, 2])
    >>> int(order.place(np.zeros(1), since=10.0, rate=100.0).number[0]) == 3 + BREAK
    True
    """

    def __init__(self) -> None:
        self._next = 0

    def place(
        self, counters: npt.NDArray[np.generic], since: float = 0.0, rate: float = 0.0
    ) -> Placed:
        """Place the frames of one batch that comes `since` seconds after the one before, at a rate
        of `rate` frames a second.

        Of `counters`, shape (n,), only the length counts.
        """
        n = len(counters)
        # a batch that comes late has its own frames' time in it, which was no pause
        waited = since - n / rate if rate else 0.0
        paused = bool(waited > max(_SHORTEST_PAUSE, _FRAMES_OF_A_PAUSE / (rate or np.inf)))
        begin = self._next + BREAK * paused
        self._next = begin + n
        return Placed(
            np.arange(begin, begin + n, dtype=np.int64), np.ones(n, bool), jumps=int(paused)
        )
