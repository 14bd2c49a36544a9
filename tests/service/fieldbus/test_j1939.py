"""SAE J1939 on CAN: frames are of their parameter group whatever priority and source they have; two devices are never mixed."""

import time
import uuid

import can
import numpy as np
import pytest

from residuum.identification.errors import BadInput
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.can.can_bus import open_bus
from residuum.service.fieldbus.can.can_record import read_can_record
from residuum.service.fieldbus.can.frame_batch import EXTENDED
from residuum.service.fieldbus.can.frame_layout import group_of, read_dbc
from residuum.service.fieldbus.sequence import BREAK
from residuum.service.fieldbus.settings import SourceSettings

EEC1, CCVS, TSC1, HOURS = 0xF004, 0xFEF1, 0x0000, 0xFEE5
STEP = 0.02


def dbc(source=0xFE, attribute=None, more=""):
    """EEC1 (engine), TSC1 (of a group with a destination), and HOURS of more than 8 bytes."""
    eec1, tsc1, hours = (
        EXTENDED | 6 << 26 | group << 8 | source for group in (EEC1, TSC1 | 0xFE, HOURS)
    )
    text = 'VERSION ""\nBS_:\nBU_: A\n'
    text += f"BO_ {eec1} EEC1: 8 A\n"
    text += ' SG_ speed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" A\n'
    text += ' SG_ torque : 16|8@1+ (1,-125) [-125|125] "%" A\n'
    text += f'BO_ {tsc1} TSC1: 8 A\n SG_ wanted : 8|16@1+ (0.125,0) [0|8031.875] "rpm" A\n'
    text += f'BO_ {hours} HOURS: 20 A\n SG_ hours : 0|32@1+ (0.05,0) [0|210554060.75] "h" A\n'
    text += more
    text += 'BA_DEF_ BO_ "SampleTime" FLOAT 0 1000;\nBA_DEF_DEF_ "SampleTime" 0;\n'
    text += 'BA_DEF_ BO_ "SourceAddress" INT 0 255;\nBA_DEF_DEF_ "SourceAddress" 254;\n'
    text += 'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    text += 'BA_DEF_DEF_ "VFrameFormat" "J1939PG";\n'
    for identifier in (eec1, tsc1, hours):
        text += f'BA_ "SampleTime" BO_ {identifier} {STEP};\n'
    if attribute is not None:
        text += f'BA_ "SourceAddress" BO_ {eec1} {attribute};\n'
    return text


def identifier(group, source, priority=3, destination=0):
    destined = destination << 8 if group >> 8 & 0xFF < 240 else 0
    return EXTENDED | priority << 26 | group << 8 | destined | source


def eec1(speed, torque=0):
    """A frame of EEC1 with these raw numbers."""
    return b"\xff\xff" + bytes([torque]) + int(speed).to_bytes(2, "little") + b"\xff\xff\xff"


class Bench:
    """A source on a virtual bus, and the bus to send on."""

    def __init__(self, folder, text):
        (folder / "bus.dbc").write_text(text)
        channel = f"virtual:{uuid.uuid4()}"
        self.blocks = []
        settings = SourceSettings(kind="can", channel=channel, map=str(folder / "bus.dbc"))
        self.source = SOURCES["can"](settings, lambda block: self.blocks.append(block) or True)
        self.source._clock = lambda: 0.0  # a pause of this bench is a busy machine
        self.source.start()
        self.bus = open_bus(channel)
        assert self.wait(lambda: self.source._bus is not None)

    def wait(self, condition):
        end = time.monotonic() + 60
        while not (holds := condition()) and time.monotonic() < end:
            time.sleep(0.01)
        return holds

    def values(self, channel):
        return [v for b in self.blocks for v in b.channels.get(channel, np.empty(0)).tolist()]

    def counted(self):
        counters = self.source.health.snapshot()["counters"]
        return {name: times for name, times in counters.items() if times}

    def trouble(self):
        return self.source.health.snapshot()["last_trouble"]

    def stop(self):
        self.source.stop()
        self.source.join()
        self.bus.close()


@pytest.fixture
def make_bench(tmp_path):
    made = []

    def make(*given):
        made.append(Bench(tmp_path, *given))
        return made[-1]

    yield make
    for bench in made:
        bench.stop()


@pytest.mark.parametrize("source", [0xFE, 0x00, 0x21])
def test_frames_of_any_priority_and_source_address_are_of_their_group(make_bench, source):
    bench = make_bench(dbc(source))
    for k in range(8):
        bench.bus.send(identifier(EEC1, 0x21, priority=k), eec1(8 * k))
        bench.bus.send(identifier(CCVS, 0x21), eec1(999))
        assert bench.wait(lambda k=k: len(bench.values("speed")) == k + 1)
    bench.bus.send(identifier(TSC1, 0x03, destination=0x00), b"\x01\x50\x01" + b"\xff" * 5)
    assert bench.wait(lambda: bench.values("wanted"))
    assert bench.values("speed") == list(range(8)) and bench.values("wanted") == [42.0]


def test_what_is_not_available_or_an_error_is_missing_and_counted(make_bench):
    bench = make_bench(dbc())
    for k, speed in enumerate([0xFAFF, 0xFB00, 0xFE00, 0xFF00, 0xFFFF]):
        bench.bus.send(identifier(EEC1, 0x00), eec1(speed, torque=[250, 0xFE, 0xFF, 0, 0][k]))
        assert bench.wait(lambda k=k: len(bench.values("speed")) == k + 1)
    assert bench.values("speed")[0] == 8031.875 and np.isnan(bench.values("speed")[1:]).all()
    assert np.isnan(bench.values("torque")).tolist() == [False, True, True, False, False]
    assert bench.counted() == {"no_value": 6}


def test_two_devices_are_not_mixed_and_that_is_said(make_bench):
    bench = make_bench(dbc())
    bench.bus.send(identifier(EEC1, 0x17), eec1(8))
    assert bench.wait(lambda: bench.values("speed") == [1])
    for _ in range(3):
        bench.bus.send(identifier(EEC1, 0x03), eec1(800))
        bench.bus.send(identifier(EEC1, 0x17), eec1(8))
    assert bench.wait(lambda: bench.counted().get("undecodable") == 6)
    assert bench.values("speed") == [1]
    assert "source addresses 0x03, 0x17" in bench.trouble() and "SourceAddress" in bench.trouble()


def test_the_device_that_the_attribute_names_is_read_alone(make_bench):
    bench = make_bench(dbc(attribute=0x17))
    for k in range(4):
        bench.bus.send(identifier(EEC1, 0x03), eec1(800))
        bench.bus.send(identifier(EEC1, 0x17), eec1(8 * k))
    assert bench.wait(lambda: len(bench.values("speed")) == 4)
    assert bench.values("speed") == [0, 1, 2, 3] and bench.counted() == {}


def test_the_device_of_the_identifier_is_meant_where_it_is_there(make_bench):
    bench = make_bench(dbc(0x00))
    bench.bus.send(identifier(EEC1, 0x17), eec1(800))
    assert bench.wait(lambda: bench.values("speed") == [100])
    for k in range(3):
        bench.bus.send(identifier(EEC1, 0x00), eec1(8 * k))
        bench.bus.send(identifier(EEC1, 0x17), eec1(800))
    assert bench.wait(lambda: len(bench.values("speed")) == 4)
    assert bench.values("speed")[1:] == [0, 1, 2]
    number = np.concatenate([b.number for b in bench.blocks if b.stream == "EEC1"])
    assert number[1] - number[0] > BREAK // 2 and np.array_equal(np.diff(number[1:]), [1, 1])


def test_messages_of_one_group_are_told_by_their_source_addresses(make_bench):
    second = EXTENDED | 6 << 26 | EEC1 << 8 | 0x01
    more = f'BO_ {second} EEC1_2: 8 A\n SG_ other : 24|16@1+ (0.125,0) [0|8031.875] "rpm" A\n'
    text = dbc(0x00, more=more) + f'BA_ "SampleTime" BO_ {second} {STEP};\n'
    bench = make_bench(text)
    for k in range(3):
        bench.bus.send(identifier(EEC1, 0x00, priority=k), eec1(8 * k))
        bench.bus.send(identifier(EEC1, 0x01, priority=k), eec1(80 * k))
        bench.bus.send(identifier(EEC1, 0x02), eec1(999))
    assert bench.wait(lambda: len(bench.values("speed")) == len(bench.values("other")) == 3)
    assert bench.values("speed") == [0, 1, 2] and bench.values("other") == [0, 10, 20]


def in_packets(group, payload, source=0x03, destination=0xFF):
    """The frames that send a message of more than eight bytes: to all, or to one device, which asks for packet 2 again."""
    count = -(-len(payload) // 7)
    kind = 32 if destination == 0xFF else 16
    announced = bytes(
        [kind, *len(payload).to_bytes(2, "little"), count, 0xFF, *group.to_bytes(3, "little")]
    )
    packets = [bytes([k + 1]) + payload[7 * k : 7 * k + 7].ljust(7, b"\xff") for k in range(count)]
    frames = [(identifier(0xEC00, source, 7, destination), announced)]
    frames += [(identifier(0xEB00, source, 7, destination), packet) for packet in packets]
    return frames if destination == 0xFF else [*frames[:-1], frames[2], frames[-1]]


def hours(value, length=20):
    return int(value).to_bytes(4, "little") + bytes(range(length - 4))


def test_a_message_of_several_packets_is_put_together(make_bench):
    bench = make_bench(dbc())
    for k in range(5):
        # packets of two messages, and of a group that the file does not have, among each other
        ours, others = in_packets(HOURS, hours(20 * k)), in_packets(0xFECA, bytes(30), source=0x55)
        for pair in zip(ours, others, strict=False):
            for frame in pair:
                bench.bus.send(*frame)
    for frame in in_packets(HOURS, hours(100), destination=0x21):
        bench.bus.send(*frame)
    assert bench.wait(lambda: len(bench.values("hours")) == 6)
    assert bench.values("hours") == [0, 1, 2, 3, 4, 5] and not bench.counted()


@pytest.mark.parametrize("lost", [0, 1, 2, 3])
def test_a_lost_packet_costs_its_message_and_mixes_no_two(make_bench, lost):
    bench = make_bench(dbc())
    sent = [in_packets(HOURS, int(20 * k).to_bytes(4, "little") * 5) for k in range(4)]
    for k, frames in enumerate(sent):
        for place, frame in enumerate(frames):
            if (k, place) not in ((1, lost), (2, 0 if lost == 3 else -1)):
                bench.bus.send(*frame)
    kept = [0, 3] if lost == 3 else [0, 2, 3]
    assert bench.wait(lambda: len(bench.values("hours")) == len(kept))
    assert bench.values("hours") == kept
    if lost:
        assert bench.counted() == {"lost": 1} and "HOURS" in bench.trouble()


def test_what_an_older_device_does_not_send_is_not_available_and_what_a_newer_one_adds_is_left(
    make_bench,
):
    after = EXTENDED | 6 << 26 | 0xFEE6 << 8 | 0xFE
    more = f'BO_ {after} TRIP: 12 A\n SG_ first : 0|16@1+ (1,0) [0|64255] "h" A\n SG_ last : 80|16@1+ (1,0) [0|64255] "h" A\n'
    bench = make_bench(dbc(more=more) + f'BA_ "SampleTime" BO_ {after} {STEP};\n')
    for payload in (bytes([1, 0] * 5), bytes([2, 0] * 6), bytes([3, 0] * 9)):
        for frame in in_packets(0xFEE6, payload):
            bench.bus.send(*frame)
    assert bench.wait(lambda: len(bench.values("first")) == 3)
    assert bench.values("first") == [1, 2, 3] and np.array_equal(
        bench.values("last"), [np.nan, 2, 3], equal_nan=True
    )


def test_a_source_address_that_is_none_costs_its_message(tmp_path):
    (tmp_path / "bus.dbc").write_text(dbc(attribute=255))
    messages = read_dbc(tmp_path / "bus.dbc")
    assert "SourceAddress is 255; must be 0 to 253" in messages.unusable["EEC1"]
    assert "TSC1" in messages


def log_of(path, frames):
    """A log of (time, identifier, bytes)."""
    with can.Logger(str(path)) as logger:
        for at, frame_id, data in frames:
            message = can.Message(
                timestamp=1_790_000_000 + at,
                arbitration_id=frame_id & ~EXTENDED,
                is_extended_id=bool(frame_id & EXTENDED),
                data=data,
                channel="can0",
            )
            logger(message)


@pytest.mark.parametrize(
    ("text", "kept"),
    [(dbc(0xFE), None), (dbc(0xFE, attribute=0x17), 0x17), (dbc(0x03), 0x03), (dbc(0x42), None)],
)
@pytest.mark.parametrize("ending", ["log", "asc", "blf"])
def test_a_log_is_read_as_the_bus_is(tmp_path, text, kept, ending):
    (tmp_path / "bus.dbc").write_text(text)
    frames = []
    for k in range(100):
        for source, factor in ((0x03, 8), (0x17, 16)):
            speed = 0xFFFF if k == 50 else factor * k
            frames.append((STEP * k, identifier(EEC1, source, priority=k % 8), eec1(speed)))
        packets = in_packets(HOURS, hours(20 * k))
        frames += [
            (STEP * k + 1e-4 * place, *frame)
            for place, frame in enumerate(packets)
            if k != 30 or place != 2
        ]
        frames.append(
            (STEP * k, identifier(TSC1, 0x03, destination=k % 4), b"\1\x50\1" + b"\xff" * 5)
        )
    log = tmp_path / f"drive.{ending}"
    log_of(log, frames)
    record = read_can_record(log, tmp_path / "bus.dbc")
    notes = " | ".join(record.notes)
    expected = np.where(np.arange(100) == 30, np.nan, np.arange(100.0))
    assert np.allclose(record.channels["hours"], expected, equal_nan=True)
    assert "message HOURS: 1 of it left out, of which a packet is not in the log" in notes
    assert "ECFF" not in notes
    assert "can0" not in record.names and np.all(record.channels["wanted"] == 42.0)
    if kept is None:
        assert "speed" not in record.names
        assert "source addresses 0x03, 0x17, and which is meant is not guessed" in notes
        return
    expected = np.arange(100.0) * (1 if kept == 0x03 else 2)
    expected[50] = np.nan
    assert np.allclose(record.channels["speed"], expected, equal_nan=True)
    assert "speed: 1 frame says that there is no value" in notes


def test_a_log_of_two_devices_alone_is_refused_with_the_way_on(tmp_path):
    (tmp_path / "bus.dbc").write_text(dbc())
    log = tmp_path / "drive.log"
    log_of(log, [(STEP * k, identifier(EEC1, k % 2), eec1(k)) for k in range(50)])
    with pytest.raises(BadInput, match=r"source addresses 0x00, 0x01.*SourceAddress"):
        read_can_record(log, tmp_path / "bus.dbc")


def test_groups_of_identifiers():
    assert group_of(identifier(EEC1, 0x17, 7)) == EEC1
    assert group_of(identifier(TSC1, 0x17, 7, destination=0x33)) == TSC1
    assert group_of(identifier(0x1EF00, 0x17, destination=0x33)) == 0x1EF00  # data page 1
