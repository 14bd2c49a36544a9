"""CanBus on python-can's udp_multicast, beside python-can itself."""

import random
import socket
import time

import can
import msgpack
import numpy as np
import pytest

from residuum.service.fieldbus.can.can_bus import CanBus, open_bus
from residuum.service.fieldbus.can.can_channel import multicast_address

GROUPS = ["239.77.1.9", "ff15::77:9"]


@pytest.fixture(params=GROUPS)
def buses(request):
    port = random.SystemRandom().randint(20_000, 32_000)
    group = request.param if "." in request.param else f"[{request.param}]"
    try:
        theirs = can.Bus(
            interface="udp_multicast", channel=request.param, port=port, hop_limit=0, fd=True
        )
    except (OSError, can.CanError) as error:
        pytest.skip(f"this computer has no group {request.param}: {error}")
    ours = open_bus(f"udp_multicast:{group}:{port}/0")
    yield ours, theirs
    ours.close()
    theirs.shutdown()


def collect(bus, frame_id, count):
    got, end = [], time.monotonic() + 60.0
    while sum(map(len, got)) < count and time.monotonic() < end:
        got += bus.read(0.1).frames.get(frame_id, [])
    return np.concatenate(got)


def test_frames_of_python_can_arrive_whole_and_in_order(buses):
    ours, theirs = buses
    sent = np.random.default_rng(0).integers(0, 256, (300, 8), dtype=np.uint8)
    for data in sent[:200]:
        theirs.send(can.Message(arbitration_id=0x123, data=data.tobytes(), is_extended_id=False))
    assert np.array_equal(collect(ours, 0x123, 200), sent[:200])
    for data in sent[200:]:
        theirs.send(can.Message(arbitration_id=0x123, data=data.tobytes(), is_extended_id=False))
    assert np.array_equal(collect(ours, 0x123, 100), sent[200:])


def test_python_can_understands_our_frames(buses):
    ours, theirs = buses
    sent = np.random.default_rng(1).integers(0, 256, (20, 64), dtype=np.uint8)
    ours.send_many(0x1ABCDEF, sent, is_fd=True)
    for data in sent:
        message = theirs.recv(60.0)
        assert (message.arbitration_id, message.is_extended_id, message.is_fd) == (
            0x1ABCDEF,
            True,
            True,
        )
        assert bytes(message.data) == data.tobytes()


def test_what_is_no_data_frame_is_told_apart(buses):
    ours, theirs = buses
    theirs.send(can.Message(arbitration_id=1, is_error_frame=True))
    theirs.send(can.Message(arbitration_id=2, is_remote_frame=True, dlc=8))
    for nonsense in (b"\xc1 no message pack", msgpack.packb([1, 2]), msgpack.packb({"no": 5}), b""):
        theirs._multicast.send(nonsense, None)
    theirs.send(can.Message(arbitration_id=3, is_extended_id=False, data=b"12345678"))
    errors = undecodable = 0
    data, end = [], time.monotonic() + 60.0
    while not data and time.monotonic() < end:
        batch = ours.read(0.1)
        errors, undecodable = errors + batch.errors, undecodable + batch.undecodable
        data += batch.frames.get(3, [])
        assert 2 not in batch.frames
    assert (errors, undecodable) == (1, 4)
    assert data[0].tobytes() == b"12345678"


def test_more_frames_than_the_system_keeps_by_itself_wait_for_a_reader_that_is_held_up(buses):
    ours, theirs = buses
    with socket.fromfd(ours._bus.fileno(), socket.AF_INET, socket.SOCK_DGRAM) as same:
        kept, by_itself = (
            each.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
            for each in (same, theirs._multicast._socket)
        )
    if kept < 8 * by_itself:
        pytest.skip("net.core.rmem_max of this computer does not allow it")
    sent = np.random.default_rng(0).integers(0, 256, (1500, 8), dtype=np.uint8)
    ours_too = np.repeat(sent[:1], 5, axis=0)
    for data in sent:
        theirs.send(can.Message(arbitration_id=0x123, data=data.tobytes(), is_extended_id=False))
    assert np.array_equal(collect(ours, 0x123, 1500), sent)
    ours.send_many(0x123, ours_too)
    assert np.array_equal(collect(ours, 0x123, 5), ours_too)  # what is sent comes back


class Failing:
    """A bus that gives some messages and then fails."""

    def __init__(self, *outcomes):
        self._outcomes = list(outcomes)

    def recv(self, _timeout):
        outcome = self._outcomes.pop(0)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def fileno(self):
        raise NotImplementedError


@pytest.mark.parametrize(
    "failure", [OSError("gone"), can.CanOperationError("the adapter was pulled out")]
)
def test_what_came_before_a_bus_failed_is_read_and_then_the_failure_is_told(failure):
    bus = CanBus(
        Failing(
            *(
                can.Message(arbitration_id=3, is_extended_id=False, data=each)
                for each in (b"12", b"34")
            ),
            failure,
        )
    )
    assert np.concatenate(bus.read(0.0).frames[3]).tobytes() == b"1234"
    with pytest.raises(type(failure), match=str(failure)):
        bus.read(0.0)


def test_addresses_of_groups():
    assert multicast_address("239.1.2.3") == ("239.1.2.3", 43113, 0)
    assert multicast_address("239.1.2.3:5000/1") == ("239.1.2.3", 5000, 1)
    assert multicast_address("ff15::1/2") == ("ff15::1", 43113, 2)
    assert multicast_address("[ff15::1]:5000/2") == ("ff15::1", 5000, 2)


def test_a_group_that_cannot_be_joined_is_named_with_its_cause():
    with pytest.raises(
        can.CanInitializationError,
        match=r"udp_multicast:127\.0\.0\.1:20000: .*Invalid argument.*route",
    ):
        open_bus("udp_multicast:127.0.0.1:20000")
