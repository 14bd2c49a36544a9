"""CAN logs: the frames of a BLF, ASC, candump or TRC file, read by python-can."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import IO, Any, NamedTuple

import can

from residuum.identification.errors import in_one_line
from residuum.identification.record_formats import CAN_LOGS
from residuum.service.fieldbus.can.frame_batch import EXTENDED
from residuum.service.fieldbus.can.frame_layout import BadBusDescription

_BINARY = ".blf"
# A line of candump: `(stamp) bus id#bytes`, `id##flagbytes` of CAN FD, or `(stamp) bus id [length]
# bytes` as it prints them.
_CANDUMP = re.compile(
    r"\s*(?:\((?P<stamp>[^)]*)\)\s+)?(?P<bus>\S+)\s+(?:[RT]X\s+\S+\s+\S+\s+)?"
    r"(?P<id>[0-9A-Fa-f]{3,8})"
    r"(?:##(?P<flags>[0-9A-Fa-f])(?P<fd>(?:[0-9A-Fa-f]{2})*)"
    r"|#(?P<classic>R[0-9A-Fa-f]*|(?:[0-9A-Fa-f]{2})*(?:_[0-9A-Fa-f])?)"
    r"|\s+\[(?P<length>\d+)\]\s*(?P<bytes>(?:[0-9A-Fa-f]{2}(?=\s|$)\s*)*)(?P<mark>\S.*)?)"
    r"(?:\s+(?:[RT]X?|B|E)+)?\s*$"
)
# bits of an identifier as Linux has them (linux/can.h), which candump prints: CAN_ERR_FLAG, and the
# 29 bits that are the identifier's own
_ERROR_FRAME, _EXTENDED_MASK = 0x2000_0000, 0x1FFF_FFFF
# Steps back from which on stamps are no times but the time since the frame before.
_SHARE_BACK = 0.1


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


class _Candump:
    """The messages of a candump log in any form it prints; what it cannot read ends it as a damage
    does.
    """

    def __init__(self, file: IO[str]) -> None:
        self._file = file

    def __enter__(self) -> _Candump:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __iter__(self) -> Iterator[can.Message]:
        for number, line in enumerate(self._file, start=1):
            if line.strip():
                yield _candump_message(line, number)


def _candump_message(line: str, number: int) -> can.Message:
    fields = _CANDUMP.match(line)
    if fields is None:
        raise ValueError(
            f"line {number} is none of candump's (`(stamp) bus id#bytes`); record with `candump -l`"
            " or `-L`"
        )
    if fields["stamp"] is None:
        raise ValueError(
            f"line {number} has no time stamp; record with `candump -l` or `-L`, or print with -ta"
        )
    identifier, classic = int(fields["id"], 16), fields["classic"] or ""
    # candump writes a standard identifier in three digits and an extended one in eight, also a
    # small one: the value alone does not tell them apart
    is_extended = len(fields["id"]) > 3
    mark = fields["mark"] or ""
    data = _candump_bytes(fields, classic)
    length = int(fields["length"]) if fields["length"] else len(data)
    return can.Message(
        timestamp=_stamp(fields["stamp"].strip(), number),
        arbitration_id=identifier & _EXTENDED_MASK,
        is_extended_id=is_extended,
        is_error_frame=is_extended and bool(identifier & _ERROR_FRAME),
        is_remote_frame=classic.startswith("R") or mark.startswith("remote request"),
        is_fd=fields["fd"] is not None or length > 8,
        dlc=length,
        data=data,
        channel=fields["bus"],
    )


def _candump_bytes(fields: re.Match[str], classic: str) -> bytes:
    """The data of a line, in whichever form it is written; none of a remote frame."""
    if fields["fd"] or fields["bytes"]:
        return bytes.fromhex(fields["fd"] or fields["bytes"])
    # behind `_` stands the length code of a frame that says 9 to 15 and carries 8 bytes
    return b"" if classic.startswith("R") else bytes.fromhex(classic.partition("_")[0])


def _stamp(text: str, number: int) -> float:
    try:
        return float(text)
    except ValueError:
        pass
    try:
        return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()
    except ValueError:
        raise ValueError(
            f"line {number}: time stamp {text!r} is neither seconds nor a date"
        ) from None


_READERS: dict[str, Any] = dict(
    zip(CAN_LOGS, (can.BLFReader, can.ASCReader, _Candump, can.TRCReader), strict=True)
)


def _since_the_last(frames: Sequence[TimedFrame]) -> bool:
    """Whether the stamps are differences, as `candump -td` prints them: from zero on, and back
    again and again.
    """
    back = sum(after.time < before.time for before, after in pairwise(frames))
    return frames[0].time == 0 and back > _SHARE_BACK * len(frames)


def _summed(frames: Sequence[TimedFrame]) -> list[TimedFrame]:
    summed, now = [], 0.0
    for frame in frames:
        now += frame.time
        summed.append(frame._replace(time=now))
    return summed


@dataclass
class _Content:
    """What a log holds: its data frames, and how many others, which are counted alone."""

    frames: list[TimedFrame] = field(default_factory=list)
    short: int = 0
    errors: int = 0
    remote: int = 0

    def add(self, message: can.Message) -> None:
        """Take in the next message."""
        if message.is_error_frame:
            self.errors += 1
        elif message.is_remote_frame:
            self.remote += 1
        elif len(message.data) < message.dlc:  # of CAN FD, too, the number of bytes
            self.short += 1
        else:
            self.frames.append(_timed(message))


def read_can_log(path: str | Path) -> CanLog:
    """The data frames of a CAN log; of one that is cut or damaged those before the damage, with a
    remark.

    Raises BadBusDescription when the file is no such log, or holds no data frame.
    """
    path = Path(path)
    content = _Content()
    damage = _read_into(content, path)
    frames: Sequence[TimedFrame] = content.frames
    if not frames:
        raise BadBusDescription(
            f"{path.name}: holds no data frame; the log must be one of {', '.join(CAN_LOGS)}"
        )
    remarks = _remarks(path.name, content, damage)
    # candump alone can be told to print differences of stamps
    if path.suffix.lower() == ".log" and _since_the_last(frames):
        frames = _summed(frames)
        remarks.append(
            f"{path.name}: its stamps are the times since the frame before (candump -td), summed up"
        )
    return CanLog(path.name, frames, remarks)


def _read_into(content: _Content, path: Path) -> str:
    """Read a log as far as it goes; how it is damaged, empty for a whole one."""
    logging.getLogger("can").setLevel(logging.CRITICAL)  # the remarks say it
    try:
        with _opened(path) as file, _READERS[path.suffix.lower()](file) as log:
            for message in log:
                content.add(message)
            damage = _cut(path, log)
        if damage and path.suffix.lower() != _BINARY and not content.short:
            del content.frames[-1:]  # half of a frame's last byte would be a byte
        return damage
    except MemoryError:
        raise
    # of a damaged file the readers raise their own, struct's, zlib's and Python's errors
    except Exception as error:
        damage = in_one_line(error)
        if not content.frames:
            raise BadBusDescription(f"{path.name}: cannot be read as a CAN log: {damage}") from None
        return damage


def _opened(path: Path) -> IO[Any]:
    return path.open("rb") if path.suffix.lower() == _BINARY else path.open(encoding="utf-8")


def _timed(message: can.Message) -> TimedFrame:
    identifier = message.arbitration_id | EXTENDED * message.is_extended_id
    return TimedFrame(
        message.timestamp, identifier, bytes(message.data), message.is_fd, str(message.channel)
    )


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


def _remarks(name: str, content: _Content, damage: str) -> list[str]:
    frames, remarks = content.frames, []
    if damage:
        remarks.append(
            f"{name}: is cut or damaged after frame {len(frames)} ({frames[-1].time:.6f} s):"
            f" {damage}; the frames before are used, export the log anew for the rest"
        )
    if content.short:
        remarks.append(f"{name}: {content.short} frames have fewer bytes than they say, left out")
    if content.errors or content.remote:
        remarks.append(
            f"{name}: {content.errors} error frames and {content.remote} remote frames carry no"
            " data, left out"
        )
    return remarks
