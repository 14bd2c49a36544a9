"""Messages of a Sparkplug node: in order, every gap noticed; bytes as another implementation makes them; values by change."""

from itertools import islice

import pytest

from residuum.service.fieldbus.health import SourceHealth
from residuum.service.fieldbus.source import StreamFormat
from residuum.service.fieldbus.stamped_samples import StampedSamples

pytest.importorskip(
    "google.protobuf", reason="the extra 'sparkplug' is not installed: Sparkplug was not tried"
)
from residuum.service.fieldbus.sparkplug.sparkplug_payload import (
    BadPayload,
    Metric,
    Payload,
    number_of,
    pack,
    unpack,
)
from residuum.service.fieldbus.sparkplug.sparkplug_source import NodeMessage, NodeSession
from residuum.service.fieldbus.stamped_samples import ReportedChanges

TAHU = bytes.fromhex(
    "08fbd095ffbc3112210a0b4d6f746f722f5370656564100318e4d095ffbc31200a69000000000022974012081004200250ffff03120e0a084d6f746f"
    "722f4f6e200b7001120c0a0454657874200c7a026f6b120a0a044e756c6c20093801120e0a034f6c64200928016500002040121f0a04506f6f722009"
    "4a100a075175616c6974791205080318f403650000204012110a0353657420108a0107080112016118031807"
)
"""Made by the classes that the Eclipse Tahu project generates from its own description of the format (mqtt-spb-wrapper 2.1.2)."""


class Node:
    """A session that is told messages as they come, a tenth of a second apart."""

    def __init__(self):
        self.health, self.now = SourceHealth(), 100.0
        self.session = NodeSession(self.health)

    def tell(self, kind, seq, stamp, *, number=0):
        metrics = [Metric("bdSeq", number)] if kind in ("NBIRTH", "NDEATH") else [Metric("x", seq)]
        self.session.arrived(
            NodeMessage(kind, "", Payload(metrics, stamp, None if kind == "NDEATH" else seq)),
            self.now,
        )
        self.now += 0.1
        return self.ready()

    def ready(self, wait=0.0):
        self.now += wait
        return [message.payload.seq for message in self.session.ready(self.now)]

    def gap(self, wait=0.0):
        self.now += wait
        return self.session.gap(self.now)

    def counted(self):
        return {name: n for name, n in self.health.snapshot()["counters"].items() if n}


@pytest.fixture
def node():
    node = Node()
    node.tell("NBIRTH", 0, 1000)
    assert node.ready(wait=1.0) == [0] and node.session.in_step
    return node


def all_of(node, *told):
    """What is believed of messages (kind, seq, stamp)."""
    return [seq for each in told for seq in node.tell(*each)] + node.ready(wait=1.0)


def test_what_comes_in_order_is_taken_across_the_turn_of_the_counter(node):
    numbers = [n % 256 for n in range(1, 600)]
    assert all_of(node, *(("DDATA", seq, 1001 + k) for k, seq in enumerate(numbers))) == numbers
    assert not node.gap(wait=60.0) and node.counted() == {}


def test_nothing_is_believed_before_a_birth():
    node = Node()
    assert all_of(node, ("DDATA", 7, 1000), ("DBIRTH", 8, 1001)) == []
    assert node.counted() == {"unborn": 2} and not node.session.in_step


@pytest.mark.parametrize("lost", [1, 5, 127, 128, 200, 255, 300])
def test_a_gap_is_noticed_and_nothing_after_it_is_believed_until_the_next_birth(node, lost):
    assert all_of(node, ("DDATA", 1, 1001)) == [1]
    assert all_of(node, ("DDATA", (2 + lost) % 256, 1002 + lost)) == []
    assert node.gap(wait=1.0) and not node.session.in_step
    assert all_of(node, ("DDATA", (3 + lost) % 256, 1003 + lost)) == []
    assert all_of(node, ("NBIRTH", 0, 2000), ("DDATA", 1, 2001)) == [0, 1]
    assert node.counted()["sequence_gaps"] == 1


def test_disorder_is_put_right_and_repetitions_are_dropped(node):
    told = [
        ("DDATA", 2, 1002),
        ("DDATA", 1, 1001),
        ("DDATA", 1, 1001),
        ("DDATA", 3, 1003),
        ("DDATA", 2, 1002),
    ]
    assert all_of(node, *told) == [1, 2, 3]
    assert not node.gap(wait=60.0) and node.counted()["duplicated"] == 2


def test_a_late_message_fills_its_place_within_the_patience(node):
    assert node.tell("DDATA", 2, 1002) == [] and node.ready(wait=0.5) == []
    node.tell("DDATA", 1, 1001)
    assert node.ready(wait=0.3) == [1, 2] and not node.gap(wait=60.0)


def test_a_birth_stands_before_its_data_although_it_comes_after_them(node):
    all_of(node, *(("DDATA", k, 1000 + k) for k in range(1, 101)))
    assert all_of(node, ("DDATA", 1, 2001), ("NBIRTH", 0, 2000), ("DDATA", 2, 2002)) == [0, 1, 2]


def test_births_that_come_twice_or_late_begin_nothing(node):
    assert all_of(
        node,
        (
            "NBIRTH",
            0,
            5000,
        ),
        ("DDATA", 1, 5001),
    ) == [0, 1]
    assert all_of(
        node, ("NBIRTH", 0, 1000), ("NBIRTH", 0, 4000), ("NBIRTH", 0, 5000), ("DDATA", 2, 5002)
    ) == [2]
    assert node.session.in_step


def test_a_death_of_an_earlier_session_says_nothing_of_this_one(node):
    node.tell("NDEATH", 0, 10, number=255)
    node.ready(wait=1.0)
    assert node.session.in_step
    node.tell("NDEATH", 0, 10, number=0)
    node.ready(wait=1.0)
    assert not node.session.in_step


@pytest.mark.parametrize("back", [500, 15_000, 3_600_000])
def test_a_clock_that_is_set_back_does_not_silence_a_node(node, back):
    begun = 10_000_000
    all_of(node, ("NBIRTH", 0, begun), *(("DDATA", k, begun + 20 * k) for k in range(1, 150)))
    after = all_of(node, *(("DDATA", k, begun + 20 * k - back) for k in range(150, 160)))
    if not after:
        assert node.gap(wait=1.0)
        assert all_of(
            node, ("NBIRTH", 0, begun + 20 * 160 - back), ("DDATA", 1, begun + 20 * 161 - back)
        ) == [0, 1]
    assert node.session.in_step


def test_bytes_of_another_implementation_are_read():
    read = unpack(TAHU)
    assert (read.seq, read.stamp, len(read.metrics)) == (7, 1700000000123, 8)
    speed, small, on, text, null, old, poor, table = read.metrics
    assert (speed.name, speed.alias, speed.stamp, speed.value) == (
        "Motor/Speed",
        3,
        1700000000100,
        1480.5,
    )
    assert (small.name, small.alias, number_of(small)) == ("", 4, -1.0)
    assert (on.value, text.value, null.value, table.value) == (True, "ok", None, None)
    assert old.historical and old.value == 2.5 and not poor.good and speed.good
    assert unpack(pack(Payload(read.metrics[:1], 5, 0))) == Payload(read.metrics[:1], 5, 0)
    with pytest.raises(BadPayload):
        unpack(b"\xff\xff not a payload")


def test_what_was_not_reported_has_not_changed_and_a_birth_is_no_sample():
    changes = ReportedChanges(["u", "y"], 0.5)
    changes.stated([(0.0, "u", 1.0), (0.0, "y", 2.0)])
    assert list(changes.samples([(10.0, "u", 3.0)])) == []
    given = list(changes.samples([(11.0, "y", 4.0), (12.5, "u", 5.0)]))
    expected = [
        (10.0, 3.0, 2.0),
        (10.5, 3.0, 2.0),
        (11.0, 3.0, 4.0),
        (11.5, 3.0, 4.0),
        (12.0, 3.0, 4.0),
    ]
    assert given == [told for at, u, y in expected for told in ((at, "u", u), (at, "y", y))]
    changes.forget()
    assert list(changes.samples([(13.0, "u", 6.0)])) == []
    assert list(changes.samples([(13.5, "u", 7.0)])) == [(13.0, "u", 6.0)]


def test_a_long_rest_of_a_fast_stream_is_a_hole_that_is_counted():
    channels = [f"c{k}" for k in range(10)]
    health = SourceHealth()
    changes, samples = (
        ReportedChanges(channels, 1e-3),
        StampedSamples(StreamFormat("s", 1e-3, dict.fromkeys(channels, "")), health),
    )
    changes.stated((0.0, channel, 0.0) for channel in channels)

    def change(stamp, value):
        given = list(islice(changes.samples([(stamp, "c0", value)]), 600_000))
        for at, channel, held in given:
            samples.add(channel, at, held, now=stamp)
        return len(given), samples.take(now=stamp)

    assert change(1000.0, 1.0) == (0, None)
    assert change(1000.5, 2.0)[1].n == 500
    assert change(1040.5, 3.0)[1].n == 40_000, "a rest that is held"
    assert change(4540.5, 4.0) == (0, None)
    given, block = change(4540.6, 5.0)
    assert given == 1000 and set(block.channels["c0"]) == {4.0}
    assert health["lost"] == 3_500_000


def test_a_silence_of_many_channels_is_bounded_by_its_values():
    changes = ReportedChanges([f"c{k}" for k in range(500)], 0.01)
    changes.stated((0.0, f"c{k}", 0.0) for k in range(500))
    assert list(changes.samples([(10.0, "c0", 1.0)])) == []
    assert next(changes.samples([(31.0, "c0", 1.0)]), None) is None
