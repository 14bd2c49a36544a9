"""CanBus: a bus of python-can, read in batches."""

from __future__ import annotations

import logging
import socket
import sys
from contextlib import suppress
from types import NoneType

import can
import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.can.can_channel import bus_arguments
from residuum.service.fieldbus.can.frame_batch import (
    BUS_OFF,
    EXTENDED,
    FrameBatch,
    FrameBatchBuilder,
)

# Frames: a bus that never falls silent must not keep a read from ending.
_MOST_IN_ONE_READ = 2048
# [s] For room in the interface's queue.
_SEND_TIMEOUT = 0.2
# Bytes: what a busy bus sends while the reader is held up for a while
# (`docs/explanation/buses.md`).
_RECEIVE_BUFFER = 16 << 20
_SO_RCVBUFFORCE = 33  # Linux's name, which Python does not have


class CanBus:
    """A bus of python-can. On `udp_multicast` what is sent here comes back here, too."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._ended: Exception | None = None
        _make_room(bus)

    def read(self, timeout: float, into: FrameBatchBuilder | None = None) -> FrameBatch:
        """Frames that came within `timeout` seconds, collected `into` a builder; OSError or
        can.CanError once the bus has failed or reported a bus-off.
        """
        if self._ended:
            raise self._ended
        batch = into or FrameBatchBuilder()
        for number in range(_MOST_IN_ONE_READ):
            if not self._take(batch, 0 if number else timeout):
                break
        return batch.batch()

    def _take(self, batch: FrameBatchBuilder, timeout: float) -> bool:
        """Add the next message; whether another may follow. What came before a failure is not lost
        with it.
        """
        try:
            message = self._bus.recv(timeout)
        except (OSError, can.CanError) as error:
            # python-can wraps what its unpacking of a frame raises: then the bus itself is in order
            could_not_unpack = not isinstance(error.__cause__, NoneType | OSError | can.CanError)
            batch.undecodable += could_not_unpack
            self._ended = None if could_not_unpack else error
            return could_not_unpack
        if message is None:
            return False
        batch.add(message)
        # raised by the next read, so that what this one has is delivered first
        if message.is_error_frame and message.arbitration_id & BUS_OFF:
            self._ended = can.CanOperationError("bus-off")
        return self._ended is None

    def send(self, frame_id: int, data: bytes, *, is_fd: bool = False) -> None:
        """Send one frame; an identifier that is long or has `EXTENDED` makes it an extended one."""
        kind = {"is_extended_id": frame_id > 0x7FF, "is_fd": is_fd, "bitrate_switch": is_fd}
        self._bus.send(
            can.Message(arbitration_id=frame_id & ~EXTENDED, data=data, **kind),
            timeout=_SEND_TIMEOUT,
        )

    def send_many(
        self, frame_id: int, frames: npt.NDArray[np.uint8], *, is_fd: bool = False
    ) -> None:
        """Send frames of one message, shape (n, length), in order."""
        for data in frames:
            self.send(frame_id, data.tobytes(), is_fd=is_fd)

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()


def open_bus(channel: str) -> CanBus:
    """Open `interface:channel`, for example `socketcan:can0`, `virtual:bench`,
    `udp_multicast:239.74.163.2:43113`.

    Raises BadInput for an address that is none, OSError or can.CanError when the bus cannot be
    opened.
    """
    arguments = bus_arguments(channel)
    try:
        return CanBus(can.Bus(**arguments, fd=True))
    except can.CanInitializationError as error:
        raise can.CanInitializationError(
            f"{channel}: {error.__cause__ or error} (a multicast group needs a route)"
        ) from error


def _make_room(bus: can.BusABC) -> None:
    """Let frames wait in the bus's socket while this process does not get the processor; 256 fit in
    otherwise.
    """
    with (
        suppress(OSError, NotImplementedError),
        socket.fromfd(bus.fileno(), socket.AF_INET, socket.SOCK_DGRAM) as opened,
    ):
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        if sys.platform == "linux":  # beyond the system's limit where we may (root)
            opened.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER)


logging.getLogger("can").setLevel(logging.CRITICAL)  # counters and exceptions say it
