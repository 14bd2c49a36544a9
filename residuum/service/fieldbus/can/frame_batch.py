"""FrameBatch: the CAN frames that one read gave, by identifier and length, ready for block
decoding.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import can
import numpy as np
import numpy.typing as npt

BUS_OFF = 0x40
"""Bit of an error frame's identifier: the controller has left the bus."""
EXTENDED = 1 << 31
"""Set in the identifier of an extended frame, as in DBC files: a short identifier is of two kinds,
which are not the same.
"""


@dataclass(frozen=True, eq=False)
class FrameBatch:
    """Frames of one read: identifier (with `EXTENDED`) → arrays of shape (n, length) as they came,
    and what was no data frame.
    """

    frames: Mapping[int, list[npt.NDArray[np.uint8]]]
    errors: int = 0
    undecodable: int = 0

    @property
    def empty(self) -> bool:
        """Whether nothing at all came."""
        return not (self.frames or self.errors or self.undecodable)


@dataclass
class FrameBatchBuilder:
    """Collects messages into a FrameBatch."""

    errors: int = 0
    undecodable: int = 0
    _data: dict[tuple[int, int], list[bytes | bytearray]] = field(default_factory=dict)

    def add(self, message: can.Message) -> None:
        """One message; a bus-off is not counted here but when it ends the connection, a remote
        frame carries nothing.
        """
        if message.is_error_frame:
            self.errors += not message.arbitration_id & BUS_OFF
        elif not message.is_remote_frame:
            self.put(message.arbitration_id | EXTENDED * message.is_extended_id, message.data)

    def put(self, identifier: int, data: bytes | bytearray) -> None:
        """The bytes of one data frame."""
        self._data.setdefault((identifier, len(data)), []).append(data)

    def batch(self) -> FrameBatch:
        """What was collected."""
        frames: dict[int, list[npt.NDArray[np.uint8]]] = {}
        for (frame_id, length), data in self._data.items():
            frames.setdefault(frame_id, []).append(
                np.frombuffer(b"".join(data), np.uint8).reshape(len(data), length)
            )
        return FrameBatch(frames, self.errors, self.undecodable)
