"""Records as National Instruments TDMS (extra `formats`)."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.loggers.logger_time import seconds_of
from residuum.identification.record_formats.optional_package import need
from residuum.identification.record_formats.options import ReadOptions
from residuum.identification.record_formats.time_bases import (
    NOT_READ,
    TimedChannel,
    among,
    on_one_base,
)

_TIME_NAME = re.compile(
    r"(?i)time|timestamps?|zeit|zeitstempel|t|x[-_ ]?values?|elapsed[ _]time|time["
    r" _](axis|stamp|base)"
)


def read_tdms(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """Read the numeric channels, each at its own times (see `on_one_base`).

    Its times are said by `wf_increment` and `wf_start_offset`, else by a channel of times in its
    group, as long as it, that holds stamps or is called `time`; else by `options.sample_time`.
    Units are `unit_string` or `NI_UnitDescription`. Channels of one name in several groups become
    `group.name`. What is not read is named in the notes.

    Raises BadRecord when the file is no TDMS file, or nothing says the times of a channel.
    """
    groups = _groups(path)
    names = [channel.name for channels in groups.values() for channel in channels]
    timed, left_out = [], []
    for group, channels in groups.items():
        clock = _clock(channels, str(path))
        for channel in channels:
            if channel is clock:
                continue
            # Names are of their group; a record has one list of them.
            is_alone = names.count(channel.name) == 1
            name = channel.name if is_alone else f"{group}.{channel.name}"
            if not _is_signal(channel):
                left_out.append(f"{name} ({_why_not(channel)})")
                continue
            times = _times(channel, clock, options, str(path))
            values = np.asarray(channel[:], dtype=float)
            timed.append(TimedChannel(name, _unit(channel), times, values))
    if not timed:
        raise BadRecord(f"{path}: holds no numeric channel{among(left_out)}")
    notes = (f"{NOT_READ}{', '.join(left_out)}",) if left_out else ()
    return on_one_base(timed, str(path), options, notes)


def _why_not(channel: Any) -> str:
    return "no numbers" if len(channel) > 1 else f"{len(channel)} samples"


def _groups(path: str | Path) -> dict[str, list[Any]]:
    nptdms = need("nptdms", path)
    try:
        file = nptdms.TdmsFile.read(path)
        return {group.name: list(group.channels()) for group in file.groups()}
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        OverflowError,
        MemoryError,
        EOFError,
    ) as error:
        raise BadRecord(
            f"{path}: is not a TDMS file: {' '.join(str(error).split())[:120]}"
        ) from None


def _clock(channels: list[Any], source: str) -> Any:
    """The channel of a group that holds the times of the others, or None."""
    clocks = [channel for channel in channels if len(channel) > 1 and _tells_time(channel)]
    if len(clocks) > 1:
        both = ", ".join(repr(channel.name) for channel in clocks)
        raise BadRecord(f"{source}: several channels of times, {both}, in one group; keep one")
    return clocks[0] if clocks else None


def _tells_time(channel: Any) -> bool:
    if channel.dtype.kind == "M":
        return True
    # sampled at times of its own: a signal, whatever it is called
    if channel.properties.get("wf_increment"):
        return False
    unit = _unit(channel)
    return (
        channel.dtype.kind in "fiu"
        and bool(_TIME_NAME.fullmatch(channel.name))
        and (not unit or seconds_of(unit) is not None)
    )


def _times(channel: Any, clock: Any, options: ReadOptions, source: str) -> np.ndarray:
    """The instants of a channel's samples [s]."""
    start = float(channel.properties.get("wf_start_offset", 0.0))
    if step := float(channel.properties.get("wf_increment") or 0.0):
        return start + step * np.arange(len(channel))
    if clock is not None and len(clock) == len(channel):
        return _instants(clock, source)
    if options.sample_time is None:
        raise BadRecord(
            f"{source}: nothing says the sample time of channel {channel.name!r} (no wf_increment,"
            " no channel of times as long as it in its group)",
            way_on=[("sample_time", "SECONDS")],
        )
    return start + options.sample_time * np.arange(len(channel))


def _instants(clock: Any, source: str) -> np.ndarray:
    values = np.asarray(clock[:])
    if values.dtype.kind == "M":  # stamps
        return (values - values[0]) / np.timedelta64(1, "ns") * 1e-9
    if (seconds := seconds_of(_unit(clock))) is None:
        values = values.astype(float)
        step = float(np.median(np.diff(values)))
        # steps of a second and more may be milliseconds or a count of rows, and numbers above 1e9
        # may be of any epoch
        if step >= 1 or values[0] > 1e9:
            says = f"{source}: nothing says the unit of channel {clock.name!r} of times"
            raise BadRecord(says, way_on=[("sample_time", "SECONDS", "without it")])
        return values
    return values.astype(float) * seconds


def _unit(channel: Any) -> str:
    return str(
        channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription") or ""
    ).strip()


def write_tdms(record: Record, path: str | Path) -> None:
    """Write a record so that `read_tdms` gives it back."""
    nptdms = need("nptdms", path)
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject(
                    "record",
                    name,
                    np.asarray(signal),
                    properties={
                        "wf_increment": record.sample_time,
                        "wf_start_offset": record.t0,
                        "unit_string": record.units[name],
                    },
                )
                for name, signal in record.channels.items()
            ]
        )


def _is_signal(channel: Any) -> bool:
    return len(channel) > 1 and channel.dtype.kind in "fiu"
