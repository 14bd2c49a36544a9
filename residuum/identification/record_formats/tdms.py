"""Records as National Instruments TDMS (extra `formats`)."""

from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.optional_package import need
from residuum.identification.record_formats.options import ReadOptions


def read_tdms(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """Read the numeric channels of the longest length; sample time from `wf_increment`, units from `unit_string`.

    Channels of one name in several groups become `group.name`. Raises BadRecord when the file is no TDMS
    file, or its channels differ in sample time.
    """
    channels = _longest_signals(path)
    steps = {float(step) for channel in channels if (step := channel.properties.get("wf_increment"))}
    if len(steps) > 1:
        raise BadRecord(f"{path}: channels differ in sample time {sorted(steps)}; one record has one")
    plain = [channel.name for channel in channels]
    names = [channel.name if plain.count(channel.name) == 1 else f"{channel.group_name}.{channel.name}" for channel in channels]
    return Record(
        {name: np.asarray(channel[:]) for name, channel in zip(names, channels, strict=True)},
        {
            name: options.unit_of(name, str(channel.properties.get("unit_string", "")))
            for name, channel in zip(names, channels, strict=True)
        },
        options.settle_sample_time(next(iter(steps), None), str(path)),
        t0=float(channels[0].properties.get("wf_start_offset", 0.0)),
        source=str(path),
    )


def _longest_signals(path: str | Path) -> list[Any]:
    """The numeric channels of the longest length."""
    nptdms = need("nptdms", path)
    try:
        file = nptdms.TdmsFile.read(path)
        channels = [channel for group in file.groups() for channel in group.channels() if _is_signal(channel)]
    except (OSError, ValueError, KeyError, TypeError, OverflowError, MemoryError, EOFError) as error:
        raise BadRecord(f"{path}: is not a TDMS file: {' '.join(str(error).split())[:120]}") from None
    if not channels:
        raise BadRecord(f"{path}: holds no numeric channel")
    longest = max(len(channel) for channel in channels)
    return [channel for channel in channels if len(channel) == longest]


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
