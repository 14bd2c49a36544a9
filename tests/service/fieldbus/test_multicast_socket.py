"""Many datagrams go and come in one call, and are to everybody what single ones are."""

import errno
import random
import socket
import struct
import sys
import time

import numpy as np
import pytest

from residuum.service.fieldbus.multicast_socket import MulticastSocket

GROUPS = ["239.77.1.10", "ff15::77:10"]
linux_only = pytest.mark.skipif(sys.platform != "linux", reason="the system has no such rows of datagrams")


@pytest.fixture(params=GROUPS)
def pair(request):
    port = random.SystemRandom().randint(20_000, 32_000)
    try:
        both = [MulticastSocket(request.param, port) for _ in range(2)]
    except OSError as error:
        pytest.skip(f"this computer has no group {request.param}: {error}")
    yield both
    for each in both:
        each.close()


def rows(n, length, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (n, length), dtype=np.uint8)


def datagrams(reader, count):
    """So many datagrams as bytes, in their order."""
    found, end = [], time.monotonic() + 60.0
    while len(found) < count and time.monotonic() < end:
        for run in reader.receive(0.1):
            found += [each.tobytes() for each in run]
    return found


def as_bytes(array):
    return [each.tobytes() for each in array]


def test_rows_of_datagrams_arrive_whole_and_in_order_beside_single_ones_of_other_lengths(pair):
    sender, reader = pair
    first, second, third = rows(500, 170), rows(1, 60, seed=1), rows(130, 170, seed=2)
    for each in (first, second, third):
        sender.send(each)
    assert datagrams(reader, 631) == as_bytes(first) + as_bytes(second) + as_bytes(third)


@linux_only
def test_a_row_whose_last_datagram_is_shorter_is_cut_where_its_sender_cut_it(pair):
    sender, reader = pair
    sender._out.sendmsg([bytes(range(250))], [(socket.IPPROTO_UDP, 103, struct.pack("=H", 100))], 0, sender._to)
    sender.send(rows(3, 50))
    content = bytes(range(250))
    assert datagrams(reader, 6) == [content[:100], content[100:200], content[200:], *as_bytes(rows(3, 50))]


def test_a_datagram_without_content_is_one_datagram(pair):
    sender, reader = pair
    sender._out.sendto(b"", sender._to)
    sender.send(rows(2, 9))
    assert datagrams(reader, 3) == [b"", *as_bytes(rows(2, 9))]


@linux_only
def test_whoever_reads_one_by_one_gets_each_datagram_by_itself():
    group, port = GROUPS[0], random.SystemRandom().randint(20_000, 32_000)
    sender, reader = MulticastSocket(group, port), MulticastSocket(group, port)
    reader._in.setsockopt(socket.IPPROTO_UDP, 104, 0)  # a reader who has not asked for rows
    try:
        sent = rows(100, 33)
        sender.send(sent)
        got = []
        reader._in.settimeout(60.0)
        while len(got) < 100:
            got.append(reader._in.recv(2000))
        assert got == as_bytes(sent)
    finally:
        sender.close()
        reader.close()


@linux_only
def test_what_is_sent_is_not_read_back(pair):
    first, second = pair
    first.send(rows(10, 20))
    second.send(rows(5, 20, seed=1))
    assert datagrams(first, 5) == as_bytes(rows(5, 20, seed=1))
    assert datagrams(second, 10) == as_bytes(rows(10, 20))
    assert not first.receive(0.0)


def test_where_a_row_is_refused_each_datagram_goes_by_itself(pair):
    sender, reader = pair
    sender._out = _Refusing(sender._out)
    sender.send(rows(100, 40))
    assert datagrams(reader, 100) == as_bytes(rows(100, 40))
    assert sender._out.refused == 1


def test_a_network_that_takes_nothing_is_told(pair):
    sender, _ = pair
    sender._out = _Refusing(sender._out, always=True)
    with pytest.raises(OSError, match="no way"):
        sender.send(rows(3, 40))


class _Refusing:
    """A card that does not cut rows, or takes nothing at all."""

    def __init__(self, real, always=False):
        self._real, self._always, self.refused = real, always, 0

    def sendmsg(self, buffers, ancillary, *rest):
        if ancillary or self._always:
            self.refused += 1
            raise OSError(errno.EIO, "no way")
        return self._real.sendmsg(buffers, ancillary, *rest)

    def close(self):
        self._real.close()
