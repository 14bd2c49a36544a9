"""Replay: recordings sent to a CAN bus, or offered by a Modbus server, at their own pace or
another.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import groupby
from pathlib import Path

import numpy as np

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.units import compatible
from residuum.service.fieldbus.can.can_bus import CanBus
from residuum.service.fieldbus.can.can_log import TimedFrame
from residuum.service.fieldbus.can.frame_layout import FrameLayout, read_dbc
from residuum.service.fieldbus.modbus.device_reading import DeviceRegisters
from residuum.service.fieldbus.modbus.register_map import RegisterMap, StreamRegisters
from residuum.service.fieldbus.modbus.register_server import RegisterServer
from residuum.service.fieldbus.modbus.register_trace import TracedPage

TRACE = ".trace"
"""Ending of a register trace."""

# [s] Frames of so much time are sent together, and slept for once.
_GROUP = 0.005
# [s] What a replay may make up for in a burst; see `replay_to_can`.
_FURTHEST_BEHIND = 0.2
# [s] Longest sleep at a stretch.
_SLICE = 0.2
# Part by which the rate of a record may differ from that of the message or stream that carries it.
_SAME_RATE = 0.01


def record_frames(record: Record, layout: FrameLayout) -> Iterator[TimedFrame]:
    """A record as the frames that would have carried it; a frame that lacks a sample is left out,
    its counter is not.

    Raises BadInput when a channel is absent, in an incompatible unit, or sampled at another rate.
    """
    _check_rate(record, layout.sample_time, layout.name)
    # what does not fill a frame at the end is left out: a frame carries all its samples or none
    n = record.n // layout.samples
    channels = {
        name: record.in_unit(name, unit)[: n * layout.samples]
        for name, unit in layout.units.items()
    }
    whole = layout.complete(channels, n)
    frames = layout.encode(np.arange(n) % (1 << layout.counter_bits), channels)
    for k in np.flatnonzero(whole).tolist():
        # a frame is sent with its last sample, not with its first
        last = record.t0 + ((k + 1) * layout.samples - 1) * record.sample_time
        yield TimedFrame(last, layout.bus_id, frames[k].tobytes(), layout.is_fd)


def record_pages(record: Record, name: str, stream: StreamRegisters) -> Iterator[TracedPage]:
    """A record as the pages that would have carried it; a page has no way to say that a sample is
    missing.

    Raises BadInput when a channel is absent, in an incompatible unit, sampled at another rate, or
    has missing samples.
    """
    _check_rate(record, stream.sample_time, name)
    n = record.n // stream.samples * stream.samples
    channels = {
        channel: record.in_unit(channel, where.unit)[:n]
        for channel, where in stream.channels.items()
    }
    for channel, values in channels.items():
        if np.isnan(values).any():
            raise BadInput(
                f"record {record.source!r}, channel {channel!r}: has missing samples; registers"
                " cannot carry them"
            )
    table = stream.encode(channels).reshape(-1, stream.words * stream.samples)
    for k, samples in enumerate(table):
        yield TracedPage((k + 1) * stream.samples * record.sample_time, name, samples)


def _check_rate(record: Record, sample_time: float, name: str) -> None:
    if abs(record.sample_time - sample_time) > _SAME_RATE * sample_time:
        raise BadInput(
            f"record {record.source!r}: has {record.sampling_rate:.6g} samples a second; {name!r}"
            f" carries {1 / sample_time:.6g}"
        )


def layout_for(record: Record, dbc_files: Iterable[Path]) -> FrameLayout:
    """The message among these DBC files that carries this record: all its channels are there, in
    fitting units, at its rate.

    Raises BadInput when none does.
    """
    for file in dbc_files:
        for layout in read_dbc(file).values():
            if not layout.why_no_stream and _carries(record, layout.units, layout.sample_time):
                return layout
    raise BadInput(
        f"record {record.source!r}: no known CAN message carries {', '.join(record.names)}; name a"
        " DBC file"
    )


def stream_for(record: Record, registers: RegisterMap) -> tuple[str, StreamRegisters]:
    """The paged stream of a register map that carries this record; BadInput when none does."""
    for name, stream in registers.streams.items():
        if stream.pages and _carries(record, stream.format(name).units, stream.sample_time):
            return name, stream
    raise BadInput(
        f"record {record.source!r}: no stream of this register map carries"
        f" {', '.join(record.names)}"
    )


def _carries(record: Record, units: Mapping[str, str], sample_time: float) -> bool:
    fits = all(
        name in record.names and compatible(record.units[name], unit)
        for name, unit in units.items()
    )
    return bool(fits and abs(record.sample_time - sample_time) <= _SAME_RATE * sample_time)


def replay_to_can(frames: Iterable[TimedFrame], bus: CanBus, speed: float = 1.0) -> int:
    """Send frames at their pace, `speed` times as fast; returns how many were sent.

    A computer that falls behind by more than 0.2 s takes longer: what it missed is not sent in one
    burst, which no bus could carry and no reader be ready for.
    """
    begun, first, sent = time.monotonic(), float("nan"), 0
    for _, group in groupby(frames, key=lambda frame: int(frame.time / (_GROUP * speed))):
        for frame in group:
            if sent == 0:
                first = frame.time
            bus.send(frame.frame_id, frame.data, is_fd=frame.is_fd)
            sent += 1
        ahead = (frame.time - first) / speed - (time.monotonic() - begun)
        if ahead > 0:
            time.sleep(ahead)
        begun += max(0.0, -ahead - _FURTHEST_BEHIND)
    return sent


async def replay_to_modbus(
    registers: RegisterMap,
    pages: Iterable[TracedPage],
    address: tuple[str, int],
    speed: float = 1.0,
    linger: float = 3.0,
    ready: Callable[[int], None] = lambda _: None,
) -> int:
    """Be a Modbus device that publishes these pages; time begins with the first request, so that a
    reader loses nothing.

    Serves for `linger` seconds more after the last page, and returns how many were published.
    `ready` is told the port.
    """
    device = DeviceRegisters(registers, on_fault=lambda _fault, _size: None)
    server = RegisterServer(device, *address)
    ready(await server.start())
    published = 0
    try:
        while not server.asked:
            await asyncio.sleep(0.02)
        begun = time.monotonic()
        for page in pages:
            while (ahead := page.time / speed - (time.monotonic() - begun)) > 0:
                await asyncio.sleep(min(ahead, _SLICE))
            device.pages[page.stream].append_registers(page.samples)
            published += 1
        await asyncio.sleep(linger)
    finally:
        await server.stop()
    return published
