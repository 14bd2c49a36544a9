"""Records as ASAM MDF measurement files (extra `formats`)."""

from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.optional_package import need
from residuum.identification.record_formats.options import ReadOptions
from residuum.identification.record_formats.time_bases import (
    NOT_READ,
    TimedChannel,
    among,
    on_one_base,
)


def read_mdf(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """Read the numeric channels of an MDF file (version 3 or 4), each at its own times (see
    `on_one_base`).

    Channels of text, of arrays and of fewer than two samples are named in the notes.

    Raises BadRecord when the file is no MDF file, or its channels have several time bases that only
    `options.resample` brings together.
    """
    signals, left_out = _signals(path)
    if not signals:
        raise BadRecord(f"{path}: holds no numeric channel of two samples{among(left_out)}")
    channels = [
        TimedChannel(_free_name(signal, position, signals), signal.unit or "", *_finite(signal))
        for position, signal in enumerate(signals)
    ]
    notes = (f"{NOT_READ}{', '.join(left_out)}",) if left_out else ()
    return on_one_base(channels, str(path), options, notes)


def _signals(path: str | Path) -> tuple[list[Any], list[str]]:
    """The numeric channels of a file, and the others with the reason why they are none."""
    asammdf = need("asammdf", path)
    with open(path, "rb") as head:
        if head.read(3) != b"MDF":
            raise BadRecord(f"{path}: is not an MDF file: it does not begin with 'MDF'")
    try:
        with asammdf.MDF(path) as file:
            # Masters are the times, which each signal brings along.
            every = list(file.iter_channels(skip_master=True))
    except Exception as error:
        # the reader raises its own, struct's, NumPy's and zlib's errors on damaged files
        raise BadRecord(
            f"{path}: is not an MDF file: {' '.join(str(error).split())[:120]}"
        ) from None
    return [signal for signal in every if _is_signal(signal)], [
        _why_not(signal) for signal in every if not _is_signal(signal)
    ]


def _why_not(signal: Any) -> str:
    if len(signal.timestamps) < 2:
        return f"{signal.name} ({len(signal.timestamps)} samples)"
    return f"{signal.name} ({'an array' if signal.samples.ndim > 1 else 'no numbers'})"


def write_mdf(record: Record, path: str | Path) -> None:
    """Write a record so that `read_mdf` gives it back."""
    asammdf = need("asammdf", path)
    signals = [
        asammdf.Signal(
            samples=np.asarray(signal), timestamps=record.time, name=name, unit=record.units[name]
        )
        for name, signal in record.channels.items()
    ]
    with asammdf.MDF(version="4.10") as file:
        file.append(signals, comment="\n".join(record.notes))
        file.save(path, overwrite=True)


def _is_signal(signal: Any) -> bool:
    return (
        signal.samples.ndim == 1
        and signal.samples.dtype.kind in "fiu"
        and len(signal.timestamps) > 1
    )


def _finite(signal: Any) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of a signal; samples that its recorder marks as invalid are missing."""
    values = signal.samples.astype(float)
    if signal.invalidation_bits is not None:
        values[np.asarray(signal.invalidation_bits, dtype=bool)] = np.nan
    return np.asarray(signal.timestamps, dtype=float), values


def _free_name(signal: Any, position: int, signals: list[Any]) -> str:
    # A file may hold several channels of one name, of several groups.
    taken = [earlier.name for earlier in signals[:position]]
    return str(signal.name) if signal.name not in taken else f"{signal.name}.{position}"
