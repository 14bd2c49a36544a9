"""Recorded buses as records: logs as python-can writes them, with losses and odd ends, read by a DBC file."""

import json
import re
from datetime import UTC, datetime

import can
import cantools
import numpy as np
import pytest

from residuum.identification.errors import BadInput
from residuum.identification.record_formats import CAN_LOGS, ReadOptions
from residuum.service.cli import run
from residuum.service.fieldbus.can.can_log import read_can_log
from residuum.service.fieldbus.can.can_record import read_can_record

DBC = """VERSION ""
BS_:
BU_: A
BO_ 416 drive: 8 A
 SG_ page M : 0|8@1+ (1,0) [0|3] "" A
 SG_ counter : 8|8@1+ (1,0) [0|255] "" A
 SG_ speed : 16|16@1- (0.25,0) [0|0] "rpm" A
 SG_ current m0 : 32|16@1- (0.01,0) [0|0] "A" A
 SG_ voltage m1 : 32|16@1+ (0.01,0) [0|0] "V" A
BO_ 417 slow: 2 A
 SG_ temperature : 0|16@1- (0.1,0) [0|0] "degC" A
BA_DEF_ BO_ "SampleTime" FLOAT 0 1000;
BA_ "SampleTime" BO_ 416 0.01;
"""
N = 1000
WRITERS = {
    ".blf": can.BLFWriter,
    ".asc": can.ASCWriter,
    ".log": can.CanutilsLogWriter,
    ".trc": can.TRCWriter,
}


def sent(number):
    values = {"page": number % 2, "counter": number % 256, "speed": 0.25 * (number % 900)}
    return values | ({"current": -0.01 * (number % 50)} if number % 2 == 0 else {"voltage": 48.0})


@pytest.fixture
def write_log(tmp_path):
    """Writes a log of the drive's frames (and those of `more`), and the DBC file beside it."""
    messages = cantools.database.load_string(DBC)

    def frame(name, time, values):
        message = messages.get_message_by_name(name)
        data = message.encode(values)
        return can.Message(
            timestamp=time,
            arbitration_id=message.frame_id,
            is_extended_id=False,
            data=data,
            channel=0,
        )

    def write(ending=".blf", numbers=range(N), slow=(), more=()):
        (tmp_path / "drive.dbc").write_text(DBC)
        logged = [frame("drive", 1000 + 0.01 * number, sent(number)) for number in numbers]
        logged += [frame("slow", time, {"temperature": 20 + value}) for time, value in slow]
        with WRITERS[ending](str(tmp_path / f"drive{ending}")) as writer:
            for message in sorted([*logged, *more], key=lambda message: message.timestamp):
                writer(message)
        return tmp_path / f"drive{ending}", tmp_path / "drive.dbc"

    return write


@pytest.mark.parametrize("ending", CAN_LOGS)
def test_every_kind_of_log_gives_the_signals_that_were_sent(write_log, ending):
    record = read_can_record(*write_log(ending))
    assert (
        record.sample_time == 0.01
        and record.n == N
        and set(record.names) == {"page", "speed", "current", "voltage"}
    )
    assert (record.units["speed"], record.units["current"]) == ("rpm", "A")
    for name in record.names:
        expected = [sent(number).get(name, np.nan) for number in range(N)]
        assert record[name] == pytest.approx(expected, nan_ok=True), name
    assert any("voltage: 500 of 1000 samples are missing" in note for note in record.notes)


def test_lost_frames_are_missing_samples_and_said_also_where_the_counter_went_round(write_log):
    lost = {100, 101, *range(300, 700)}
    record = read_can_record(
        *write_log(numbers=[number for number in range(N) if number not in lost])
    )
    assert record.n == N
    assert np.flatnonzero(np.isnan(record["speed"])).tolist() == sorted(lost)
    assert any(f"message drive: {len(lost)} frames lost" in note for note in record.notes)


def test_what_comes_twice_or_late_is_put_in_its_place(write_log):
    numbers = list(range(N))
    path, dbc = write_log(".log", numbers)
    lines = path.read_text().splitlines()
    lines[10], lines[11] = lines[11], lines[10]
    lines.insert(50, lines[50])
    path.write_text("\n".join(lines) + "\n")
    record = read_can_record(path, dbc)
    assert record["speed"] == pytest.approx([sent(number)["speed"] for number in numbers])
    assert any("1 frames came twice" in note for note in record.notes)


def test_a_slower_message_stands_on_the_clock_of_the_fastest_and_is_missing_between(write_log):
    slow = [(1000.052 + 0.1 * k, k) for k in range(90)]
    path, dbc = write_log(slow=slow)
    record = read_can_record(path, dbc)
    held = np.flatnonzero(~np.isnan(record["temperature"]))
    assert held.tolist() == [5 + 10 * k for k in range(90)]
    assert record["temperature"][held] == pytest.approx([20 + k for k in range(90)])
    notes = "; ".join(record.notes)
    assert (
        "message slow: no counter: losses cannot be seen" in notes
        and "2 messages on the clock of drive" in notes
    )
    smooth = read_can_record(path, dbc, ReadOptions(resample=True))
    assert smooth["temperature"][100] == pytest.approx(
        20 + 9 + 0.5, abs=0.11
    ) and "interpolated between" in "; ".join(smooth.notes)


def test_uneven_frames_without_a_counter_are_refused_with_the_way_on(write_log):
    rng = np.random.default_rng(2)
    slow = [(1000 + 0.1 * (k + 0.8 * rng.random()), k) for k in range(90)]
    path, dbc = write_log(slow=slow)
    with pytest.raises(BadInput, match=r"drive.blf, message slow: has no counter, .*resample=True"):
        read_can_record(path, dbc)
    assert read_can_record(path, dbc, ReadOptions(resample=True)).n > 900


@pytest.mark.parametrize("ending", CAN_LOGS)
def test_of_a_log_that_is_cut_in_the_middle_of_a_frame_what_came_before_stays(write_log, ending):
    path, dbc = write_log(ending, numbers=range(400))
    whole = path.read_bytes()
    for cut in range(len(whole) * 3 // 4, len(whole) * 3 // 4 + 40, 3):
        path.write_bytes(whole[:cut])
        if whole[cut - 1 : cut] in (b"\n", b"\r") and ending != ".blf":
            continue
        log = read_can_log(path)
        record = read_can_record(path, dbc)
        assert record["speed"] == pytest.approx(
            [sent(number)["speed"] for number in range(record.n)]
        )
        assert record.n >= 200
        assert sum("is cut or damaged after frame" in remark for remark in log.remarks) == 1
        assert "export the log anew" in log.remarks[0] and "\n" not in log.remarks[0]


@pytest.mark.parametrize("ending", CAN_LOGS)
@pytest.mark.parametrize("content", [b"", b"nonsense\xff\x00" * 50, b"hello world\n" * 9])
def test_what_is_no_log_is_refused_in_one_line(tmp_path, ending, content):
    (tmp_path / f"no{ending}").write_bytes(content)
    with pytest.raises(
        BadInput, match=rf"no\{ending}: (cannot be read as a CAN log|holds no data frame)"
    ) as refusal:
        read_can_log(tmp_path / f"no{ending}")
    assert "\n" not in str(refusal.value)


def test_a_message_on_two_buses_of_the_log_is_not_guessed(write_log):
    other = can.Message(
        timestamp=1000.005, arbitration_id=416, is_extended_id=False, data=bytes(8), channel=1
    )
    with pytest.raises(
        BadInput, match="message drive: is on the buses 0, 1 of the log; export one bus alone"
    ):
        read_can_record(*write_log(more=[other]))


def test_a_dbc_file_of_another_bus_is_told(write_log, tmp_path):
    path, dbc = write_log()
    dbc.write_text(DBC.replace("416", "99").replace("417", "98"))
    with pytest.raises(
        BadInput,
        match=r"drive.blf: no message of drive.dbc is in it; it holds 0x1A0 \(1000 frames\)",
    ):
        read_can_record(path, dbc)


def test_commands_read_logs_by_a_dbc_file(write_log, capsys, tmp_path):
    path, dbc = write_log(".asc")
    assert run(["compare", "gate-drive", str(path)]) == 2
    assert "name the DBC file of its bus with --dbc FILE" in capsys.readouterr().err
    assert run(["compare", "gate-drive", str(path), "--dbc", str(dbc), "--resample", "--json"]) == 0
    said = capsys.readouterr()
    assert (
        set(json.loads(said.out)["outputs"]) == {"speed", "current"} and "drive.asc: " in said.err
    )
    (tmp_path / "r.csv").write_text("time [s],y [V]\n0,1\n1,2\n2,3\n")
    assert run(["compare", "gate-drive", str(tmp_path / "r.csv"), "--dbc", str(dbc)]) == 2
    assert "no record is a CAN log" in capsys.readouterr().err


def test_inspect_shows_what_is_in_a_log_beside_what_the_dbc_file_makes_of_it(write_log, capsys):
    unknown = can.Message(
        timestamp=1000.005, arbitration_id=0x77, is_extended_id=False, data=bytes(8), channel=0
    )
    path, dbc = write_log(
        numbers=[number for number in range(N) if number != 5],
        slow=[(1000, 1), (1001, 2)],
        more=[unknown],
    )
    assert run(["inspect", str(path), "--dbc", str(dbc), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    drive, slow = found["messages"]
    assert (drive["message"], drive["frames"], drive["lost"], drive["counter"]) == (
        "drive",
        N - 1,
        1,
        "counted",
    )
    assert (slow["lost"], slow["counter"]) == (None, "no counter: losses cannot be seen")
    voltage = next(channel for channel in drive["channels"] if channel["channel"] == "voltage")
    assert (voltage["first"], voltage["lowest"], voltage["highest"]) == (None, 48.0, 48.0)
    assert found["unknown"] == {"0x77": 1}
    assert run(["inspect", str(path), "--dbc", str(dbc)]) == 0
    text = capsys.readouterr().out
    assert (
        "drive 0x1A0: 999 frames, one every 0.01 s, 1 lost" in text
        and "voltage [V]: not in it there; 48 … 48" in text
    )


def candump(stamps, form, rng):
    """The drive's frames as candump writes them, `stamps` seconds each."""
    layout = cantools.database.load_string(DBC).get_message_by_name("drive")
    lines = []
    for number, stamp in enumerate(stamps):
        data = layout.encode(sent(number))
        screen = f"can0  1A0   [{len(data)}]  {data.hex(' ').upper()}"
        date = datetime.fromtimestamp(stamp, UTC).strftime("%Y-%m-%d %H:%M:%S.%f")
        if rng.random() < 0.05:
            lines.append({"log": f"({stamp:.6f}) can0 20000004#0000000000000000"}.get(form, ""))
        lines.append(
            {
                "log": f"({stamp:.6f}) can0 1A0#{data.hex().upper()}",
                "direction": f"({stamp:.6f}) can0 1A0#{data.hex().upper()} {'RT'[number % 2]}",
                "fd": f"({stamp:.6f}) can0 1A0##1{data.hex().upper()}",
                "screen": f" ({stamp:.6f})  {screen}",
                "date": f" ({date})  {screen}",
                "ascii": f" ({stamp:.6f})  {screen}   '..{number % 10}.....'",
                "printed direction": f" ({stamp:.6f})  can0  RX - -  1A0   [{len(data)}]  {data.hex(' ').upper()}",
            }[form]
        )
    return "\n".join(line for line in lines if line) + "\n"


def even(n=N):
    return 1e9 + 0.01 * np.arange(n)


@pytest.mark.parametrize(
    "form", ["log", "direction", "fd", "screen", "date", "ascii", "printed direction"]
)
@pytest.mark.parametrize("differences", [False, True])
def test_candump_is_read_in_every_form_that_it_prints(tmp_path, form, differences):
    if differences and form == "date":
        pytest.skip("differences are no dates")
    rng = np.random.default_rng(3)
    stamps = even() + rng.uniform(0, 3e-4, N)
    (tmp_path / "drive.dbc").write_text(DBC)
    written = np.diff(stamps, prepend=stamps[0]) if differences else stamps
    (tmp_path / "drive.log").write_text(
        candump(
            written,
            form,
            np.random.default_rng(4) if form == "log" and not differences else Never(),
        )
    )
    record = read_can_record(tmp_path / "drive.log", tmp_path / "drive.dbc")
    assert record["speed"] == pytest.approx([sent(number)["speed"] for number in range(N)])
    notes = "; ".join(record.notes)
    assert ("summed up" in notes) == differences
    assert ("error frames" in notes) == (form == "log" and not differences)
    assert "not used" not in notes and "twice" not in notes


class Never:
    def random(self):
        return 1.0


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("counted", [True, False])
def test_a_clock_that_was_set_is_said_and_bridged(tmp_path, seed, counted):
    rng = np.random.default_rng(seed)
    at, by = (
        int(rng.integers(100, 900)),
        float(rng.choice([-1, 1]) * rng.choice([0.04, 0.5, 2.0, 30.0, 3600.0])),
    )
    if by > 0 and (not counted or by < 1 or by > 100):
        by = -by  # a step forward is a pause without a counter, or where it is long; a short one is a few frames lost
    stamps = even() + rng.uniform(0, 3e-4, N)
    stamps[at:] += by
    text = DBC if counted else DBC.replace("SG_ counter", "SG_ whatever")
    (tmp_path / "drive.dbc").write_text(text)
    (tmp_path / "drive.log").write_text(candump(stamps, "log", Never()))
    record = read_can_record(tmp_path / "drive.log", tmp_path / "drive.dbc")
    assert record["speed"] == pytest.approx([sent(number)["speed"] for number in range(N)])
    notes = "; ".join(record.notes)
    way, size, place = re.search(
        r"the clock was set (\w+) by ([\d.e+]+) s after frame (\d+)", notes
    ).groups()
    assert (way, int(place)) == ("forward" if by > 0 else "back", at)
    assert float(size) == pytest.approx(abs(by), rel=0.01, abs=1e-3)
    assert "lost," not in notes


@pytest.mark.parametrize("together", [2, 5, 7])
def test_frames_that_share_a_stamp_keep_their_order_and_their_number(tmp_path, together):
    text = DBC.replace("SG_ counter", "SG_ whatever")
    (tmp_path / "drive.dbc").write_text(text)
    stamps = 1e9 + 0.01 * together * np.ceil(np.arange(1, N + 1) / together)
    (tmp_path / "drive.log").write_text(candump(stamps, "log", Never()))
    record = read_can_record(tmp_path / "drive.log", tmp_path / "drive.dbc")
    assert record["speed"] == pytest.approx([sent(number)["speed"] for number in range(N)])
    assert any("several frames share a stamp" in note for note in record.notes)
    assert not any("twice" in note for note in record.notes)
