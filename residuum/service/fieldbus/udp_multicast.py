"""MulticastFrames: reads python-can's `udp_multicast` bus in batches.

python-can spends 15 µs and more on each frame it receives there; at 5 000 frames a second that alone is a good part of a
core. Here datagrams are taken from the socket in one go and decoded together: datagrams of one message differ in nothing but
the time stamp and the data bytes, so one of them is unpacked (msgpack) and serves as the pattern for the others. What does
not fit a pattern is unpacked by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import msgpack
import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.frames import FrameBatch, FrameBatchBuilder
from residuum.service.fieldbus.multicast_socket import MulticastSocket

_PATTERNS = 256


@dataclass
class _Pattern:
    """Bytes that every datagram of one message shares (`care`), and where its data lie."""

    fixed: npt.NDArray[np.uint8]
    care: npt.NDArray[np.bool_]
    frame_id: int
    data: slice
    same: npt.NDArray[np.uint8] = field(init=False)

    def __post_init__(self) -> None:
        self.same = self.fixed[self.care]

    def fits(self, rows: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
        """Which of these datagrams, shape (n, length), are of this message."""
        return np.asarray((rows[:, self.care] == self.same).all(axis=1))


class MulticastFrames:
    """A `udp_multicast` CAN bus, read in batches.

    Parameters
    ----------
    group : str
        Multicast address, IPv4 or IPv6.
    port : int
    hops : int
        How far frames that are sent may travel; 0 keeps them on this machine.

    Raises
    ------
    OSError
        The group cannot be joined.
    """

    gather = 0.04  # its socket keeps many thousand frames

    def __init__(self, group: str, port: int, hops: int = 0) -> None:
        self._socket = MulticastSocket(group, port, hops)
        self._patterns: dict[int, list[_Pattern]] = {}

    def read(self, timeout: float) -> FrameBatch:
        """Frames that came within `timeout` seconds, or at once those that wait; an empty batch when none came."""
        of_length: dict[int, list[npt.NDArray[np.uint8]]] = {}
        for rows in self._socket.receive(timeout):
            of_length.setdefault(rows.shape[1], []).append(rows)
        batch = FrameBatchBuilder()
        for length, runs in of_length.items():
            self._decode(length, np.concatenate(runs), batch)  # a copy: the socket's buffer is used again
        return batch.batch()

    def _decode(self, length: int, rows: npt.NDArray[np.uint8], batch: FrameBatchBuilder) -> None:
        for pattern in self._patterns.get(length, ()):
            if not len(rows):
                return
            fits = pattern.fits(rows)
            if fits.any():
                batch.add(pattern.frame_id, rows[fits, pattern.data])
                rows = rows[~fits]
        while len(rows):
            rows = self._learn(rows, batch)

    def _learn(self, rows: npt.NDArray[np.uint8], batch: FrameBatchBuilder) -> npt.NDArray[np.uint8]:
        """Unpack the first datagram, keep it as a pattern when it carries data, and return those that it does not fit."""
        datagram = rows[0].tobytes()
        try:
            message = msgpack.unpackb(datagram, raw=False)
            frame_id, data = int(message["arbitration_id"]), bytes(message["data"])
            error, remote = bool(message["is_error_frame"]), bool(message["is_remote_frame"])
        except (ValueError, TypeError, KeyError, msgpack.UnpackException):
            batch.undecodable += 1
            return rows[1:]
        if error:
            batch.errors += 1
            return rows[1:]
        if remote:
            return rows[1:]
        pattern = _pattern(datagram, rows[0], frame_id, data)
        if pattern is None:
            batch.add(frame_id, np.frombuffer(data, np.uint8)[None, :])
            return rows[1:]
        known = self._patterns.setdefault(len(datagram), [])
        if sum(map(len, self._patterns.values())) < _PATTERNS:
            known.append(pattern)
        fits = pattern.fits(rows)
        batch.add(frame_id, rows[fits, pattern.data])
        return rows[~fits]

    def send(self, frame_id: int, data: bytes, *, is_fd: bool = False) -> None:
        """Send one frame."""
        self.send_many(frame_id, np.frombuffer(data, np.uint8)[None, :], is_fd=is_fd)

    def send_many(self, frame_id: int, frames: npt.NDArray[np.uint8], *, is_fd: bool = False) -> None:
        """Send frames of one message, shape (n, length), in order; OSError when the network does not take them."""
        n, length = frames.shape
        head, tail = (np.frombuffer(part, np.uint8) for part in _around(frame_id, length, is_fd))
        datagrams = np.empty((n, len(head) + length + len(tail)), np.uint8)
        datagrams[:, : len(head)] = head
        datagrams[:, len(head) : len(head) + length] = frames
        datagrams[:, len(head) + length :] = tail
        self._socket.send(datagrams)

    def close(self) -> None:
        """Leave the bus."""
        self._socket.close()


def _pattern(datagram: bytes, row: npt.NDArray[np.uint8], frame_id: int, data: bytes) -> _Pattern | None:
    stamp, mark = datagram.find(b"\xa9timestamp\xcb"), datagram.find(b"\xa4data\xc4" + bytes([len(data)]))
    if stamp < 0 or mark < 0 or not data:
        return None
    care = np.ones(len(datagram), bool)
    care[stamp + 11 : stamp + 19] = False
    begin = mark + 7
    care[begin : begin + len(data)] = False
    return _Pattern(row.copy(), care, frame_id, slice(begin, begin + len(data)))


def _around(frame_id: int, length: int, is_fd: bool) -> tuple[bytes, bytes]:
    """What stands before and behind the data where python-can's `udp_multicast` bus puts a frame on the wire."""
    message = {
        "timestamp": 0.0,
        "arbitration_id": frame_id,
        "is_extended_id": frame_id > 0x7FF,
        "is_remote_frame": False,
        "is_error_frame": False,
        "channel": None,
        "dlc": length,
        "data": bytes(length),
        "is_fd": is_fd,
        "bitrate_switch": is_fd,
        "error_state_indicator": False,
    }
    packed = msgpack.packb(message, use_bin_type=True)
    begin = packed.find(b"\xa4data\xc4") + 7
    return packed[:begin], packed[begin + length :]
