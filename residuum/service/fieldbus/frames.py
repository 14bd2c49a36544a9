"""FrameBatch: the CAN frames that one read gave, by identifier and length, ready for block decoding."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, eq=False)
class FrameBatch:
    """Frames of one read: identifier → arrays of shape (n, length) in their order of arrival, and what was not a data frame."""

    frames: Mapping[int, list[npt.NDArray[np.uint8]]]
    errors: int = 0
    undecodable: int = 0

    @property
    def empty(self) -> bool:
        """Whether nothing at all came."""
        return not (self.frames or self.errors or self.undecodable)


@dataclass
class FrameBatchBuilder:
    """Collects frames into a FrameBatch."""

    frames: dict[int, list[npt.NDArray[np.uint8]]] = field(default_factory=dict)
    errors: int = 0
    undecodable: int = 0

    def add(self, frame_id: int, data: npt.NDArray[np.uint8]) -> None:
        """Frames of one message, shape (n, length)."""
        self.frames.setdefault(frame_id, []).append(data)

    def batch(self) -> FrameBatch:
        """What was collected."""
        return FrameBatch(self.frames, self.errors, self.undecodable)


class FrameBus(Protocol):
    """A CAN bus that is read in batches."""

    gather: float
    """How long frames may wait in the bus's own buffer, so that they are read together [s]."""

    def read(self, timeout: float) -> FrameBatch:
        """Frames that came within `timeout` seconds; an empty batch when none came."""

    def send(self, frame_id: int, data: bytes, *, is_fd: bool = False) -> None:
        """Send one frame."""

    def send_many(self, frame_id: int, frames: npt.NDArray[np.uint8], *, is_fd: bool = False) -> None:
        """Send frames of one message, shape (n, length), in order."""

    def close(self) -> None:
        """Leave the bus."""
