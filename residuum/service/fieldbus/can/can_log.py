"""CAN logs: the frames of a BLF, ASC, candump or TRC file, read by python-can."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

import can

from residuum.identification.errors import in_one_line
from residuum.identification.record_formats import CAN_LOGS
from residuum.service.fieldbus.can.frame_batch import EXTENDED
from residuum.service.fieldbus.can.frame_layout import BadBusDescription

_READERS: dict[str, Any] = dict(zip(CAN_LOGS, (can.BLFReader, can.ASCReader, can.CanutilsLogReader, can.TRCReader), strict=True))
_BINARY = ".blf"


class TimedFrame(NamedTuple):
    """One CAN frame, when it was seen [s], and on which bus of the logger."""

    time: float
    frame_id: int
    data: bytes
    is_fd: bool
    bus: str = ""


@dataclass(frozen=True)
class CanLog:
    """The data frames of a log in their order, and what is to be said of it: a line each."""

    name: str
    frames: Sequence[TimedFrame]
    remarks: Sequence[str]


def read_can_log(path: str | Path) -> CanLog:
    """The data frames of a CAN log; of one that is cut or damaged those before the damage, with a remark.

    Raises BadBusDescription when the file is no such log, or holds no data frame.
    """
    path = Path(path)
    frames: list[TimedFrame] = []
    damage, short = "", 0
    logging.getLogger("can").setLevel(logging.CRITICAL)  # the remarks say it
    try:
        with _opened(path) as file, _READERS[path.suffix.lower()](file) as log:
            for message in log:
                if message.is_error_frame or message.is_remote_frame:
                    continue
                if len(message.data) < can.util.dlc2len(message.dlc):
                    short += 1
                else:
                    frames.append(_timed(message))
            damage = _cut(path, log)
        if damage and path.suffix.lower() != _BINARY and not short:
            frames = frames[:-1]  # half of a frame's last byte would be a byte
    except MemoryError:
        raise
    except Exception as error:  # of a damaged file the readers raise their own, struct's, zlib's and Python's errors
        damage = in_one_line(error)
        if not frames:
            raise BadBusDescription(f"{path.name}: cannot be read as a CAN log: {damage}") from None
    if not frames:
        raise BadBusDescription(f"{path.name}: holds no data frame; the log must be one of {', '.join(CAN_LOGS)}")
    return CanLog(path.name, frames, _remarks(path.name, frames, damage, short))


def _opened(path: Path) -> IO[Any]:
    return path.open("rb") if path.suffix.lower() == _BINARY else path.open(encoding="utf-8")


def _timed(message: can.Message) -> TimedFrame:
    identifier = message.arbitration_id | EXTENDED * message.is_extended_id
    return TimedFrame(message.timestamp, identifier, bytes(message.data), message.is_fd, str(message.channel))


def _cut(path: Path, log: Any) -> str:
    """How it shows that the file ends before the log does; empty when it does not."""
    if path.suffix.lower() == _BINARY:
        size = path.stat().st_size
        return f"has {size} of {log.file_size} bytes" if size < log.file_size else ""
    return "" if _ends_a_line(path) else "ends in the middle of a line, which is left out"


def _ends_a_line(path: Path) -> bool:
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - 1))
        return file.read() in (b"\n", b"\r", b"")


def _remarks(name: str, frames: Sequence[TimedFrame], damage: str, short: int) -> list[str]:
    remarks = []
    if damage:
        remarks.append(
            f"{name}: is cut or damaged after frame {len(frames)} ({frames[-1].time:.6f} s): {damage}; "
            "the frames before are used, export the log anew for the rest"
        )
    if short:
        remarks.append(f"{name}: {short} frames have fewer bytes than they say, left out")
    return remarks
