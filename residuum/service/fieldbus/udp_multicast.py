"""MulticastFrames: reads python-can's `udp_multicast` bus in batches.

python-can spends 15 µs and more on each frame it receives there; at 5 000 frames a second that alone is a good part of a
core. Here datagrams are taken from the socket in one go and decoded together: datagrams of one message differ in nothing but
the time stamp and the data bytes, so one of them is unpacked (msgpack) and serves as the pattern for the others. What does
not fit a pattern is unpacked by itself.
"""

from __future__ import annotations

import ipaddress
import select
import socket
import struct
import sys
from contextlib import suppress
from dataclasses import dataclass, field

import msgpack
import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.frames import FrameBatch, FrameBatchBuilder

_MOST = 2048
_LONGEST = 512
_RECEIVE_BUFFER = 4 << 20
_FORCED = 33
"""Linux's SO_RCVBUFFORCE, which Python has no name for."""
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

    def __init__(self, group: str, port: int, hops: int = 0) -> None:
        self._to = (group, port)
        self._socket = open_group(group, port, hops)
        self._datagrams = np.zeros((_MOST, _LONGEST), np.uint8)
        self._slots = [memoryview(row) for row in self._datagrams]  # type: ignore[arg-type]
        self._lengths = np.zeros(_MOST, np.intp)
        self._patterns: dict[int, list[_Pattern]] = {}

    def read(self, timeout: float) -> FrameBatch:
        """Frames that came within `timeout` seconds, or at once those that wait; an empty batch when none came."""
        if not select.select([self._socket], [], [], timeout)[0]:
            return FrameBatchBuilder().batch()
        count, receive, slots, lengths = 0, self._socket.recv_into, self._slots, self._lengths
        try:
            while count < _MOST:
                lengths[count] = receive(slots[count])
                count += 1
        except BlockingIOError:
            pass
        return self._decode(count)

    def _decode(self, count: int) -> FrameBatch:
        batch = FrameBatchBuilder()
        for length in np.unique(self._lengths[:count]):
            rows = self._datagrams[np.flatnonzero(self._lengths[:count] == length), :length]
            for pattern in self._patterns.get(int(length), ()):
                fits = (rows[:, pattern.care] == pattern.same).all(axis=1)
                if fits.any():
                    batch.add(pattern.frame_id, rows[fits, pattern.data])
                    rows = rows[~fits]
            while len(rows):
                rows = self._learn(rows, batch)
        return batch.batch()

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
        fits = (rows[:, pattern.care] == pattern.same).all(axis=1)
        batch.add(frame_id, rows[fits, pattern.data])
        return rows[~fits]

    def send(self, frame_id: int, data: bytes, *, is_fd: bool = False) -> None:
        """Send one frame."""
        self._socket.sendto(pack(frame_id, data, is_fd=is_fd), self._to)

    def send_many(self, frame_id: int, frames: npt.NDArray[np.uint8], *, is_fd: bool = False) -> None:
        """Send frames of one message, shape (n, length), one after the other."""
        send, to = self._socket.sendto, self._to
        head, tail = _around(frame_id, frames.shape[1], is_fd)
        for data in frames:
            send(head + data.tobytes() + tail, to)

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


def pack(frame_id: int, data: bytes, *, is_fd: bool) -> bytes:
    """One frame as python-can's `udp_multicast` bus puts it on the wire."""
    head, tail = _around(frame_id, len(data), is_fd)
    return head + data + tail


def _around(frame_id: int, length: int, is_fd: bool) -> tuple[bytes, bytes]:
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


def open_group(group: str, port: int, hops: int) -> socket.socket:
    """A non-blocking socket that has joined a multicast group; on a machine without a network, through the loopback interface."""
    version = ipaddress.ip_address(group).version
    family = socket.AF_INET if version == 4 else socket.AF_INET6
    opened = socket.socket(family, socket.SOCK_DGRAM)
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "SO_REUSEPORT"):
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        _make_room(opened)
        opened.bind(("", port))
        (_join_ipv4 if version == 4 else _join_ipv6)(opened, group, hops)
        opened.setblocking(False)
    except OSError:
        opened.close()
        raise
    return opened


def _make_room(opened: socket.socket) -> None:
    """Let frames wait while this process does not get the processor: beyond the system's limit where we may (root)."""
    with suppress(OSError):
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        if sys.platform == "linux":
            opened.setsockopt(socket.SOL_SOCKET, _FORCED, _RECEIVE_BUFFER)


def _join_ipv4(opened: socket.socket, group: str, hops: int) -> None:
    opened.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, hops)
    member = socket.inet_aton(group)
    try:
        opened.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member + socket.inet_aton("0.0.0.0"))
    except OSError:
        loopback = socket.inet_aton("127.0.0.1")
        opened.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
        opened.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member + loopback)


def _join_ipv6(opened: socket.socket, group: str, hops: int) -> None:
    opened.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, hops)
    member = socket.inet_pton(socket.AF_INET6, group)
    opened.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, member + struct.pack("@I", 0))
