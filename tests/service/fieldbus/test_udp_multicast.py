import random
import time

import can
import msgpack
import numpy as np
import pytest

from residuum.service.fieldbus.udp_multicast import MulticastFrames

GROUP = "239.77.1.9"


@pytest.fixture
def buses():
    port = random.SystemRandom().randint(20_000, 32_000)
    ours = MulticastFrames(GROUP, port)
    theirs = can.Bus(interface="udp_multicast", channel=GROUP, port=port, hop_limit=0, fd=True)
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
    for data in sent:
        theirs.send(can.Message(arbitration_id=0x123, data=data.tobytes(), is_extended_id=False))
    assert np.array_equal(collect(ours, 0x123, 300), sent)


def test_python_can_understands_our_frames(buses):
    ours, theirs = buses
    sent = np.random.default_rng(1).integers(0, 256, (20, 64), dtype=np.uint8)
    ours.send_many(0x1ABCDEF, sent, is_fd=True)
    for data in sent:
        message = theirs.recv(60.0)
        assert (message.arbitration_id, message.is_extended_id, message.is_fd) == (0x1ABCDEF, True, True)
        assert bytes(message.data) == data.tobytes()


def test_what_is_no_data_frame_is_told_apart(buses):
    ours, theirs = buses
    theirs.send(can.Message(arbitration_id=1, is_error_frame=True))
    theirs.send(can.Message(arbitration_id=2, is_remote_frame=True, dlc=8))
    theirs._multicast.send(b"\xc1 no message pack", None)
    theirs._multicast.send(msgpack.packb({"arbitration_id": 5}), None)
    theirs.send(can.Message(arbitration_id=3, data=b"12345678"))
    errors = undecodable = 0
    data, end = [], time.monotonic() + 60.0
    while not data and time.monotonic() < end:
        batch = ours.read(0.1)
        errors, undecodable = errors + batch.errors, undecodable + batch.undecodable
        data += batch.frames.get(3, [])
        assert 2 not in batch.frames
    assert (errors, undecodable) == (1, 2)
    assert data[0].tobytes() == b"12345678"
