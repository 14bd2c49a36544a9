"""MulticastSocket: datagrams of a multicast group, many in one call.

A call to the system for every datagram costs more than all that is done with it. Linux takes a row of datagrams of one length
in one call, and hands such a row on in one call too (UDP segmentation offload); on the wire, and for whoever reads them one by
one, each is a datagram of its own. Elsewhere, and where a network card refuses it, a call carries one.
"""

from __future__ import annotations

import ctypes
import errno
import ipaddress
import select
import socket
import struct
import sys
from collections.abc import Sequence
from contextlib import suppress

import numpy as np
import numpy.typing as npt

Bytes = npt.NDArray[np.uint8]

_LINUX = sys.platform == "linux"
_RECEIVE_BUFFER = 16 << 20
_READ_BUFFER = 4 << 20
_LONGEST = 1 << 16
_LONGEST_SENT = 60_000
_MOST_SEGMENTS = 64
_SEND_TIMEOUT = 0.2
# Linux's names that Python does not have:
_SO_RCVBUFFORCE, _SO_ATTACH_FILTER = 33, 26
_UDP_SEGMENT, _UDP_GRO = 103, 104
_REFUSED = {errno.EIO, errno.EINVAL, errno.EOPNOTSUPP, errno.ENOPROTOOPT, errno.EMSGSIZE}
"""Errors of a system or card that does not cut a row into datagrams."""


class MulticastSocket:
    """A multicast group: what others send there, and a way to send.

    What is sent here is not read here, where the system can tell (Linux).

    Parameters
    ----------
    group : str
        Multicast address, IPv4 or IPv6.
    port : int
    hops : int
        How far datagrams that are sent may travel; 0 keeps them on this machine.

    Raises
    ------
    OSError
        The group cannot be joined.
    """

    def __init__(self, group: str, port: int, hops: int = 0) -> None:
        version = ipaddress.ip_address(group).version
        family = socket.AF_INET if version == 4 else socket.AF_INET6
        self._in, self._out = (socket.socket(family, socket.SOCK_DGRAM) for _ in range(2))
        self._to = (group, port)
        self._most = _MOST_SEGMENTS if _LINUX else 1
        self._buffer = np.empty(_READ_BUFFER, np.uint8)
        self._room = memoryview(self._buffer)  # type: ignore[arg-type]
        try:
            _make_room(self._in)
            _bind(self._in, port)
            for each in (self._in, self._out):
                (_set_up_ipv4 if version == 4 else _set_up_ipv6)(each, hops)
            if _join(self._in, group):
                _use_loopback(self._out)
            self._out.settimeout(_SEND_TIMEOUT)
            self._out.bind(("", 0))
            if _LINUX:
                _take_rows(self._in)
                _leave_out(self._in, _address_towards(self._to, self._out), self._out.getsockname()[1])
            self._in.setblocking(False)
        except OSError:
            self.close()
            raise

    def receive(self, timeout: float) -> Sequence[Bytes]:
        """Datagrams that came within `timeout` seconds, or at once those that wait: arrays of shape (n, length).

        They are in their order and stay what they are until the next call; more than four mebibytes are left for that one.
        """
        if not select.select([self._in], [], [], timeout)[0]:
            return []
        runs, at = _Runs(), 0
        try:
            while at + _LONGEST <= _READ_BUFFER:
                count, said, _, _ = self._in.recvmsg_into([self._room[at:]], 64)
                runs.add(at, count, _segment(said) or count)
                at += count
        except BlockingIOError:
            pass
        return [self._buffer[begin : begin + n * length].reshape(n, length) for begin, n, length in runs.found]

    def send(self, datagrams: Bytes) -> None:
        """Send datagrams of one length, shape (n, length), in order; OSError when the network takes no more for 0.2 s."""
        datagrams = np.ascontiguousarray(datagrams)
        length, at = datagrams.shape[1], 0
        while at < len(datagrams):
            row = datagrams[at : at + max(1, min(self._most, _LONGEST_SENT // length))]
            try:
                self._out.sendmsg([row], _as_segments(length) if len(row) > 1 else [], 0, self._to)  # type: ignore[list-item]
            except OSError as error:
                if len(row) == 1 or error.errno not in _REFUSED:
                    raise
                self._most = 1
                continue
            at += len(row)

    def close(self) -> None:
        """Leave the group."""
        self._in.close()
        self._out.close()


class _Runs:
    """Where datagrams of one length stand behind each other: (begin, number, length)."""

    def __init__(self) -> None:
        self.found: list[tuple[int, int, int]] = []

    def add(self, begin: int, count: int, length: int) -> None:
        """`count` bytes at `begin`, cut every `length` bytes; the last piece may be shorter."""
        whole = count // length if length else 1
        last = self.found[-1] if self.found else (0, 0, -1)
        if last[2] == length:
            self.found[-1] = (last[0], last[1] + whole, length)
        else:
            self.found.append((begin, whole, length))
        if rest := count - whole * length:
            self.found.append((begin + whole * length, 1, rest))


def _segment(said: Sequence[tuple[int, int, bytes]]) -> int:
    """The length of each datagram of a row, 0 when the system says none: then it is one datagram."""
    for level, kind, data in said:
        if (level, kind) == (socket.IPPROTO_UDP, _UDP_GRO):
            return int.from_bytes(data[:4], sys.byteorder)
    return 0


def _as_segments(length: int) -> list[tuple[int, int, bytes]]:
    return [(socket.IPPROTO_UDP, _UDP_SEGMENT, struct.pack("=H", length))]


def _take_rows(opened: socket.socket) -> None:
    with suppress(OSError):
        opened.setsockopt(socket.IPPROTO_UDP, _UDP_GRO, 1)


def _address_towards(to: tuple[str, int], sender: socket.socket) -> bytes:
    """The address of this computer that a sender's datagrams will bear; empty while there is no way to the group."""
    with socket.socket(sender.family, socket.SOCK_DGRAM) as probe, suppress(OSError):
        if sender.family == socket.AF_INET:
            chosen = sender.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, 4)
            probe.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, chosen)
        probe.connect(to)
        return ipaddress.ip_address(probe.getsockname()[0].partition("%")[0]).packed
    return b""


def _leave_out(opened: socket.socket, address: bytes, port: int) -> None:
    """Let the system drop what came from this address and port before it is queued: a classic packet filter."""
    load_half, load_word, jump_if_equal, return_ = 0x28, 0x20, 0x15, 0x06
    from_network_header = 0xFFF00000
    if not address:
        return
    place = from_network_header + (12 if len(address) == 4 else 8)
    words = struct.unpack(f"!{len(address) // 4}I", address)
    tests = [(load_half, 0, port)] + [(load_word, place + 4 * k, word) for k, word in enumerate(words)]
    steps = []
    for after, (load, offset, value) in zip(range(len(tests) - 1, -1, -1), tests, strict=True):
        steps += [(load, 0, 0, offset), (jump_if_equal, 0, 2 * after + 1, value)]
    steps += [(return_, 0, 0, 0), (return_, 0, 0, 0xFFFFFFFF)]
    program = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *step) for step in steps))
    with suppress(OSError):
        opened.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HP", len(steps), ctypes.addressof(program)))


def _bind(opened: socket.socket, port: int) -> None:
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    if hasattr(socket, "SO_REUSEPORT"):
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
    opened.bind(("", port))


def _make_room(opened: socket.socket) -> None:
    """Let frames wait while this process does not get the processor: beyond the system's limit where we may (root)."""
    with suppress(OSError):
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        if _LINUX:
            opened.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER)


def _set_up_ipv4(opened: socket.socket, hops: int) -> None:
    opened.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, hops)


def _set_up_ipv6(opened: socket.socket, hops: int) -> None:
    opened.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, hops)


def _join(opened: socket.socket, group: str) -> bool:
    """Join the group; whether only the loopback interface could, as on a machine without a network."""
    if opened.family == socket.AF_INET6:
        member = socket.inet_pton(socket.AF_INET6, group)
        opened.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, member + struct.pack("@I", 0))
        return False
    member = socket.inet_aton(group)
    try:
        opened.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member + socket.inet_aton("0.0.0.0"))
    except OSError:
        opened.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member + socket.inet_aton("127.0.0.1"))
        return True
    return False


def _use_loopback(opened: socket.socket) -> None:
    opened.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
