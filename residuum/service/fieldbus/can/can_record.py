"""A record from a CAN log and the DBC file of its bus."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.even_time import resampled, resampling
from residuum.identification.record_formats.options import ReadOptions
from residuum.service.fieldbus.can.can_log import CanLog, TimedFrame, read_can_log
from residuum.service.fieldbus.can.frame_layout import BusMessages, read_dbc
from residuum.service.fieldbus.can.logged_messages import LoggedMessage, logged_messages
from residuum.service.fieldbus.can.packets import Packets
from residuum.service.fieldbus.settings import map_file
from residuum.service.fieldbus.source import Samples

# Of all channels together: 800 MB as doubles. A log whose stamps are torn apart would ask for more.
_MOST_SAMPLES = 100_000_000
# Part of all instants that may be cut off at both ends: what is more is a gap, and stays to be
# seen.
_MOST_TRIMMED = 0.01
# Of a frame's time, where no counter says which place a frame has.
_MOST_JITTER = 0.25


def read_can_record(
    path: str | Path, dbc: str | Path, options: ReadOptions = ReadOptions()
) -> Record:
    """The signals of all messages of a DBC file that a CAN log holds, on the even clock of the
    fastest one.

    Lost frames, and signals that a frame does not carry, are missing; nothing is interpolated
    unless `options.resample` asks for it. A slower message's samples stand at the nearest instants
    of the fastest one's clock, and are missing between. What was seen on the way (losses, no
    counter, a cut file) are the record's notes.

    `dbc` is a file, or the name of one that comes with Residuum.

    Raises
    ------
    BadBusDescription
        The log or the DBC file cannot be read.
    BadRecord
        No message of the DBC file is in the log; uneven frames without a counter where resampling
        is not allowed.
    """
    log, messages = read_can_log(path), read_dbc(map_file(str(dbc)))
    begins = log.frames[0].time
    log = _put_together(log, messages)
    heard, unused = logged_messages(log, messages)
    if not heard:
        raise BadRecord(f"{log.name}: {_none_known(messages, unused)}")
    signals, step = _on_own_clocks(log.name, heard, options)
    # one clock for all: from the first sample of any channel on, in steps of the fastest one's
    begin = min(first for first, _, _ in signals.values())
    n = 1 + max(
        round((first - begin) / step + (len(values) - 1) * own / step)
        for first, own, values in signals.values()
    )
    if n < 1:
        raise BadRecord(
            f"{log.name}: its time stamps go back again and again; record with `candump -l`, or cut"
            " the log there"
        )
    if n * len(signals) > _MOST_SAMPLES:
        raise BadRecord(
            f"{log.name}: {n} instants of {len(signals)} channels are more than 1e8 samples; cut"
            " the log at its gaps"
        )
    channels = {name: _placed(*signal, begin, step, n) for name, signal in signals.items()}
    notes = _notes(log.remarks, messages, heard, unused, options.resample)
    # trimmed last: at the ends, what filling has left; it draws lines between two values alone
    if options.resample:
        channels, filled = _interpolated(channels, step, log.name)
        begin, channels, cut = _trimmed(begin, channels, step)
        notes += filled + cut
    else:
        notes += _missing(channels)
    units = _units(heard)
    return Record(
        channels,
        {name: options.unit_of(name, units[name]) for name in channels},
        options.settle_sample_time(step, log.name),
        t0=begin - begins,
        source=str(path),
        notes=tuple(notes),
    )


def _on_own_clocks(
    source: str, heard: list[LoggedMessage], options: ReadOptions
) -> tuple[dict[str, tuple[float, float, Samples]], float]:
    """Each channel as the time of its first sample, its own sample time and its samples; and the
    shortest of these times.
    """
    signals: dict[str, tuple[float, float, Samples]] = {}
    names = _names(heard)
    for message in heard:
        _, channels = message.layout.decode(message.frames)
        for name, values in channels.items():
            own = names[message.layout.name, name]
            # with stamps alone, jitter of more than a quarter of a frame's time may put a frame
            # into the next one's place
            if message.placed or message.jitter <= _MOST_JITTER:
                signals[own] = (message.begin, message.sample_time, _with_holes(message, values))
            elif options.resample:
                at = np.repeat(message.time, message.layout.samples) - message.time[0]
                step, (even,), _ = resampled(at, values[None, :], source)
                signals[own] = (float(message.time[0]), step, even)
            else:
                raise BadRecord(
                    f"{source}, message {message.layout.name}: has no counter, and its frames come"
                    f" up to {message.jitter:.2g} of their time of {message.frame_time:.6g} s off",
                    way_on=[("resample", True, "to accept it")],
                )
    return signals, min(own for _, own, _ in signals.values())


def _with_holes(message: LoggedMessage, values: Samples) -> Samples:
    """Samples on the message's clock, missing where a frame was lost."""
    samples = message.layout.samples
    whole = np.full((int(message.number[-1]) + 1, samples), np.nan)
    whole[message.number] = values.reshape(-1, samples)
    return whole.reshape(-1)


def _placed(
    first: float, own: float, values: Samples, begin: float, step: float, n: int
) -> Samples:
    """Samples at the nearest instants of the common clock."""
    placed = np.full(n, np.nan)
    # a sample time that is no multiple of the step may round beyond the last instant: clipped
    place = np.clip(
        np.rint((first - begin + own * np.arange(len(values))) / step).astype(np.int64), 0, n - 1
    )
    # two samples may fall to one instant: a missing one must not take the place of a value
    held = ~np.isnan(values)
    placed[place[held]] = values[held]
    return placed


def _interpolated(
    channels: dict[str, Samples], step: float, source: str
) -> tuple[dict[str, Samples], list[str]]:
    """Channels with straight lines between their own samples, longer holes missing; and what was
    done to each.
    """
    n = len(next(iter(channels.values())))
    _, filled, done = resampled(
        step * np.arange(n, dtype=np.float64), np.stack(list(channels.values())), source
    )
    notes = [
        f"{name}: {resampling(step, *fill)}" for name, fill in zip(channels, done, strict=True)
    ]
    return dict(zip(channels, filled, strict=True)), notes


def _trimmed(
    begin: float, channels: dict[str, Samples], step: float
) -> tuple[float, dict[str, Samples], list[str]]:
    """Without the first and last few instants that come before a page's first frame, or after its
    last; and what was cut.
    """
    held = [
        np.flatnonzero(~np.isnan(values))
        for values in channels.values()
        if not np.isnan(values).all()
    ]
    n = len(next(iter(channels.values())))
    first, last = (
        max((known[0] for known in held), default=0),
        min((known[-1] for known in held), default=n - 1),
    )
    if not 0 < first + n - 1 - last <= _MOST_TRIMMED * n or last <= first:
        return begin, channels, []
    cut = (
        f"the first {first} and the last {n - 1 - last} instants are left out: not every channel"
        " has a value there"
    )
    return (
        begin + step * float(first),
        {name: values[first : last + 1] for name, values in channels.items()},
        [cut],
    )


def _missing(channels: dict[str, Samples]) -> list[str]:
    """How much of each channel is missing."""
    lacks = {name: int(np.isnan(values).sum()) for name, values in channels.items()}
    return [
        f"{name}: {lacking} of {len(channels[name])} samples are missing"
        for name, lacking in lacks.items()
        if lacking
    ]


def _names(heard: list[LoggedMessage]) -> dict[tuple[str, str], str]:
    """Message and signal → name of the channel: the signal's, with its message's before it where
    two messages have it.
    """
    times = Counter(name for message in heard for name in message.layout.units)
    return {
        (message.layout.name, name): name if times[name] == 1 else f"{message.layout.name}.{name}"
        for message in heard
        for name in message.layout.units
    }


def _units(heard: list[LoggedMessage]) -> dict[str, str]:
    names = _names(heard)
    return {
        names[message.layout.name, name]: unit
        for message in heard
        for name, unit in message.layout.units.items()
    }


def _notes(
    remarks: Iterable[str],
    messages: BusMessages,
    heard: list[LoggedMessage],
    unused: dict[str, int],
    resample: bool,
) -> list[str]:
    notes = [*remarks, *(remark for message in heard for remark in message.remarks)]
    if len(heard) > 1:
        fastest = min(heard, key=lambda message: message.sample_time)
        notes.append(
            f"{len(heard)} messages on the clock of {fastest.layout.name}"
            f" ({fastest.sample_time:.6g} s); samples of others stand at its nearest instants and"
            f" are {'interpolated' if resample else 'missing'} between"
        )
    names = _names(heard)
    for message in heard:
        for name, count in message.layout.codes(message.frames).items():
            many = f"{count} frame{'s say' if count > 1 else ' says'}"
            notes.append(
                f"{names[message.layout.name, name]}: {many} that there is no value (not available,"
                " error); missing there"
            )
    notes += [f"not read: {why}" for why in messages.unusable.values()]
    if unused:
        notes.append(
            f"{sum(unused.values())} frames of {len(unused)} identifiers are not used:"
            f" {_some(unused)}"
        )
    return notes


def _put_together(log: CanLog, messages: BusMessages) -> CanLog:
    """The log with what J1939 sends in packets in one piece, at the time of the last packet."""
    long = [layout for layout in messages.values() if layout.in_packets]
    if not long:
        return log
    frames: list[TimedFrame] = []
    of_bus: dict[str, Packets] = defaultdict(lambda: Packets(long))
    for frame in log.frames:
        packets = of_bus[frame.bus]
        if not packets.is_known(frame.frame_id, frame.data):
            frames.append(frame)
        if whole := packets.put(frame.frame_id, frame.data):
            frames.append(frame._replace(frame_id=whole[0], data=whole[1]))
    given_up: Counter[str] = Counter()
    for packets in of_bus.values():
        given_up.update(dict(packets.given_up()))
    says = [
        f"message {name}: {times} of it left out, of which a packet is not in the log"
        for name, times in given_up.items()
    ]
    return replace(log, frames=frames, remarks=[*log.remarks, *says])


def _none_known(messages: BusMessages, unused: dict[str, int]) -> str:
    unusable = f"; not usable: {'; '.join(messages.unusable.values())}" if messages.unusable else ""
    return f"no message of {messages.where} is in it; it holds {_some(unused)}{unusable}"


def _some(unused: dict[str, int]) -> str:
    most = sorted(unused.items(), key=lambda entry: -entry[1])
    return ", ".join(f"{name} ({count} frames)" for name, count in most[:8]) + (
        ", …" if len(most) > 8 else ""
    )
