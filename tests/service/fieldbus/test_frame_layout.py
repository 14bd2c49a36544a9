import re

import cantools
import numpy as np
import pytest

from residuum.service.fieldbus.can.can_source import CanSource
from residuum.service.fieldbus.can.frame_layout import BadBusDescription, read_dbc
from residuum.service.fieldbus.settings import MAPS

MIXED = """VERSION ""
BS_:
BU_: A
BO_ 300 mixed: 8 A
 SG_ counter : 0|12@1+ (1,0) [0|4095] "" A
 SG_ little : 12|12@1- (0.25,-3) [0|0] "V" A
 SG_ big : 31|16@0- (0.01,0) [0|0] "A" A
 SG_ flag : 40|1@1+ (1,0) [0|1] "" A
 SG_ odd : 54|11@0+ (2,1) [0|0] "rpm" A
BA_DEF_ BO_ "SampleTime" FLOAT 0 1000;
BA_DEF_DEF_ "SampleTime" 0;
BA_ "SampleTime" BO_ 300 0.001;
"""


@pytest.fixture
def mixed(tmp_path):
    file = tmp_path / "mixed.dbc"
    file.write_text(MIXED)
    return file


def test_decoding_agrees_with_cantools_for_both_byte_orders(mixed):
    layout = read_dbc(mixed)["mixed"]
    reference = cantools.database.load_file(str(mixed)).get_message_by_name("mixed")
    frames = np.random.default_rng(0).integers(0, 256, (200, 8), dtype=np.uint8)
    counter, channels = layout.decode(frames)
    for k, frame in enumerate(frames):
        truth = reference.decode(frame.tobytes())
        assert counter[k] == truth["counter"]
        for name in ("little", "big", "flag", "odd"):
            assert channels[name][k] == pytest.approx(truth[name], abs=1e-12)


def test_encoding_agrees_with_cantools(mixed):
    layout = read_dbc(mixed)["mixed"]
    reference = cantools.database.load_file(str(mixed)).get_message_by_name("mixed")
    rng = np.random.default_rng(1)
    n = 50
    values = {
        "little": rng.uniform(-500, 500, n),
        "big": rng.uniform(-300, 300, n),
        "odd": 1.0 + 2 * rng.integers(0, 2047, n),
    }
    values["flag"] = rng.integers(0, 2, n).astype(float)
    frames = layout.encode(np.arange(n), values)
    for k, frame in enumerate(frames):
        truth = reference.decode(frame.tobytes())
        assert truth["counter"] == k
        assert truth["little"] == pytest.approx(values["little"][k], abs=0.126)
        assert truth["big"] == pytest.approx(values["big"][k], abs=0.0051)
        assert (truth["flag"], truth["odd"]) == (values["flag"][k], values["odd"][k])


@pytest.mark.parametrize("file", sorted(MAPS.glob("*.dbc")), ids=lambda file: file.name)
def test_the_bus_descriptions_that_come_with_it_agree_with_cantools(file):
    reference = cantools.database.load_file(str(file))
    for name, layout in read_dbc(file).items():
        if not layout.counter_bits:
            continue
        frames = np.random.default_rng(2).integers(0, 256, (5, layout.length), dtype=np.uint8)
        counter, channels = layout.decode(frames)
        for k, frame in enumerate(frames):
            truth = reference.get_message_by_name(name).decode(
                frame.tobytes(), decode_choices=False
            )
            assert counter[k] == truth["counter"]
            for channel, values in channels.items():
                index = f"_{0:02d}" if layout.samples > 1 else ""
                assert values[k * layout.samples] == pytest.approx(truth[channel + index])


def test_a_block_frame_holds_samples_in_their_order():
    layout = read_dbc(MAPS / "gripping_pliers.dbc")["vibration"]
    a = np.linspace(-80, 80, 31 * 4)
    sync = (np.arange(31 * 4) % 7 == 0).astype(float)
    counter, channels = layout.decode(
        layout.encode([65535, 0, 1, 2], {"acceleration": a, "sync": sync})
    )
    assert counter.tolist() == [65535, 0, 1, 2]
    assert np.abs(channels["acceleration"] - a).max() <= 0.0026
    assert np.array_equal(channels["sync"], sync)
    assert layout.sample_time == pytest.approx(1 / 12800)


def test_a_fault_command_carries_a_float():
    layout = read_dbc(MAPS / "gate_actuator.dbc")["FAULT_COMMAND"]
    _, values = layout.decode(layout.encode([0], {"fault": [2], "size": [-1.25]}))
    assert (values["fault"][0], values["size"][0]) == (2.0, -1.25)


def described(tmp_path, text):
    file = tmp_path / "bus.dbc"
    file.write_text(text)
    return read_dbc(file)


def source_of(layouts):
    return CanSource("virtual:none", layouts, lambda _block: True)


def test_a_file_that_is_no_dbc_file_is_refused(tmp_path):
    with pytest.raises(BadBusDescription, match="cannot be read as a DBC file"):
        described(tmp_path, MIXED.replace("BO_ 300 mixed: 8 A", "BO_ 300 mixed 8 A"))


def test_a_file_with_nothing_to_stream_is_refused_with_the_reasons(tmp_path):
    layouts = described(tmp_path, MIXED.replace('BA_ "SampleTime" BO_ 300 0.001;', ""))
    with pytest.raises(
        BadBusDescription,
        match=r"bus\.dbc: has nothing to stream: message mixed .*no time between frames",
    ):
        source_of(layouts)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            ('SG_ flag : 40|1@1+ (1,0) [0|1] "" A', 'SG_ flag : 20|1@1+ (1,0) [0|1] "" A'),
            "overlapping.*Correct the file",
        ),
        (
            ("SG_ flag : 40|1@1+", "SG_ flag : 64|1@1+"),
            "flag does not fit in message mixed.*Correct the file",
        ),
        (
            ("SG_ flag :", "SG_ flag m0 :"),
            "'flag' is on a page, and no signal names the page: mark that one with M",
        ),
        (
            ('BA_ "SampleTime" BO_ 300 0.001;', 'BA_ "SamplesPerFrame" BO_ 300 2;'),
            "SamplesPerFrame is 2.*'little' has 1 signals",
        ),
    ],
)
def test_a_message_that_cannot_be_used_is_named_and_costs_nothing_but_itself(
    tmp_path, change, says
):
    text = MIXED.replace(*change).replace(
        "BA_DEF_ BO_", 'BA_DEF_ BO_ "SamplesPerFrame" INT 1 512;\nBA_DEF_ BO_', 1
    )
    other = 'BO_ 301 other: 8 A\n SG_ counter : 0|8@1+ (1,0) [0|255] "" A\n SG_ force : 16|16@1- (0.1,0) [0|0] "N" A\n'
    layouts = described(
        tmp_path, text.replace("BA_DEF_", other + "BA_DEF_", 1) + 'BA_ "SampleTime" BO_ 301 0.01;\n'
    )
    assert set(layouts) == {"other"} and list(layouts.unusable) == ["mixed"]
    (line,) = layouts.unusable.values()
    assert re.match(f"bus.dbc, message mixed: .*{says}", line) and "\n" not in line
    assert [stream.name for stream in source_of(layouts).streams] == ["other"]


def test_messages_without_signals_are_passed_over(tmp_path):
    wake_up = "BO_ 64 WAKE_UP: 0 A\nBO_ 65 HEARTBEAT: 8 A\n"
    loose = 'BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX\n SG_ Spare : 0|16@1- (0.1,0) [0|0] "" Vector__XXX\n'
    layouts = described(tmp_path, MIXED.replace("BO_ 300 mixed", wake_up + loose + "BO_ 300 mixed"))
    assert set(layouts) == {"mixed"}
    assert [stream.name for stream in source_of(layouts).streams] == ["mixed"]


PACK = """VERSION ""
BS_:
BU_: A
BO_ 513 cells: 8 A
 SG_ counter : 0|8@1+ (1,0) [0|255] "" A
 SG_ cell_01 : 8|12@1+ (0.001,0) [0|5] "V" A
 SG_ cell_02 : 20|12@1+ (0.001,0) [0|5] "V" A
 SG_ cell_03 : 32|12@1+ (0.001,0) [0|5] "V" A
 SG_ cell_04 : 44|12@1+ (0.001,0) [0|5] "V" A
BA_DEF_ BO_ "SampleTime" FLOAT 0 1000;
BA_DEF_ BO_ "SamplesPerFrame" INT 1 512;
BA_ "SampleTime" BO_ 513 0.1;
"""


def test_numbered_signals_are_channels_of_their_own(tmp_path):
    layout = described(tmp_path, PACK)["cells"]
    cells = {"cell_01": 3.6, "cell_02": 3.7, "cell_03": 3.2, "cell_04": 3.8}
    _, channels = layout.decode(
        layout.encode([0, 1], {name: [volt, volt] for name, volt in cells.items()})
    )
    assert {name: values.tolist() for name, values in channels.items()} == {
        name: pytest.approx([volt, volt]) for name, volt in cells.items()
    }
    assert layout.sample_time == 0.1


def test_numbered_signals_are_samples_of_one_channel_where_the_file_says_so(tmp_path):
    layout = described(tmp_path, PACK + 'BA_ "SamplesPerFrame" BO_ 513 4;\n')["cells"]
    assert (
        layout.units == {"cell": "V"}
        and layout.samples == 4
        and layout.sample_time == pytest.approx(0.025)
    )


DRIVE = """VERSION ""
BS_:
BU_: A
BO_ 416 drive: 8 A
 SG_ page M : 0|8@1+ (1,0) [0|3] "" A
 SG_ counter : 8|8@1+ (1,0) [0|255] "" A
 SG_ speed : 16|16@1- (0.25,0) [0|0] "rpm" A
 SG_ current m0 : 32|16@1- (0.01,0) [0|0] "A" A
 SG_ voltage m1 : 32|16@1+ (0.01,0) [0|0] "V" A
 SG_ temperature m1 : 48|16@1- (0.1,0) [0|0] "degC" A
 SG_ torque m0 : 48|16@1- (0.01,0) [0|0] "N*m" A
BA_DEF_ BO_ "SampleTime" FLOAT 0 1000;
BA_ "SampleTime" BO_ 416 0.01;
"""


def test_multiplexed_signals_have_values_on_their_page_only(tmp_path):
    layout = described(tmp_path, DRIVE)["drive"]
    cantools_message = cantools.database.load_string(DRIVE).get_message_by_name("drive")
    sent = [
        {"page": 0, "counter": 0, "speed": 100.0, "current": -10.3, "torque": -0.52},
        {"page": 1, "counter": 1, "speed": 101.0, "voltage": 48.0, "temperature": 35.0},
        {"page": 0, "counter": 2, "speed": 102.0, "current": -10.09, "torque": -0.5},
    ]
    frames = np.array([list(cantools_message.encode(values)) for values in sent], np.uint8)
    unknown_page = np.array([[3, 3, 0, 0, 255, 255, 255, 255]], np.uint8)
    counter, channels = layout.decode(np.concatenate([frames, unknown_page]))
    assert counter.tolist() == [0, 1, 2, 3]
    expected = {name: [values.get(name, np.nan) for values in sent] + [np.nan] for name in channels}
    expected["page"][3], expected["speed"][3] = 3, 0
    for name, values in channels.items():
        assert values == pytest.approx(expected[name], nan_ok=True), name
    back = {name: values[:3] for name, values in channels.items()}
    assert np.array_equal(layout.encode(counter[:3], back), frames)
    everything = {name: np.nan_to_num(values, nan=7.0) for name, values in back.items()}
    # what is on another page is not sent
    assert np.array_equal(layout.encode(counter[:3], everything), frames)


def test_unsigned_numbers_of_64_bits_are_never_negative(tmp_path):
    little = 'BO_ 256 energy: 8 A\n SG_ total : 0|64@1+ (1,0) [0|0] "J" A\n'
    big = 'BO_ 257 big: 8 A\n SG_ total : 7|64@0+ (0.5,0) [0|0] "J" A\n'
    layouts = described(tmp_path, f'VERSION ""\nBS_:\nBU_: A\n{little}{big}')
    ones = np.full((1, 8), 255, np.uint8)
    assert layouts["energy"].decode(ones)[1]["total"] == [2.0**64] and layouts["big"].decode(ones)[
        1
    ]["total"] == [2.0**63]
    assert layouts["energy"].encode([0], {"total": [2.0**63]}).tolist() == [[0] * 7 + [128]]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("counter :", "number :"), "no counter: losses cannot be seen"),
        (("SG_ counter : 0|12", "SG_ counter : 0|3"), "'counter' has 3 bits; 4 to 32 are needed"),
    ],
)
def test_a_message_without_a_usable_counter_is_streamed_and_said_to_be_uncounted(
    tmp_path, change, says
):
    source = source_of(described(tmp_path, MIXED.replace(*change)))
    assert [stream.name for stream in source.streams] == ["mixed"]
    source.health.received(1, 1)
    snapshot = source.health.snapshot()
    assert snapshot["quality"] == "uncounted" and says in snapshot["remarks"][0]


def test_short_identifiers_of_standard_and_extended_frames_are_told_apart(tmp_path):
    extended = described(tmp_path, MIXED.replace("BO_ 300", f"BO_ {300 | 1 << 31}"))
    plain = described(tmp_path, MIXED)["mixed"]
    assert (extended["mixed"].frame_id, plain.frame_id) == (300, 300) and extended[
        "mixed"
    ].bus_id != plain.bus_id


def test_impossible_identifiers_and_values_of_no_signal_do_not_spoil_a_file(tmp_path):
    late = 'BO_ 99999 late: 8 A\n SG_ x : 0|8@1+ (1,0) [0|0] "" A\n\nBO_ 300 mixed'
    tables = 'VAL_ 99999 x 0 "off; or so" 1 "on" ;\nVAL_ 300 gone 0 "off" ;\nVAL_ 300 flag 0 "no" 1 "yes" ;\n'
    layouts = described(tmp_path, MIXED.replace("BO_ 300 mixed", late) + tables)
    assert set(layouts) == {"mixed"} and layouts["mixed"].choices["flag"] == {0: "no", 1: "yes"}
    assert (
        "identifier 99999 is longer than 11 bits and is not marked as extended: add 2147483648"
        in layouts.unusable["late"]
    )
    (tmp_path / "late.dbc").write_text('BO_ 99999 late: 8 A\n SG_ x : 0|8@1+ (1,0) [0|0] "" A\n')
    with pytest.raises(
        BadBusDescription, match=r"late\.dbc: has nothing to stream: .*identifier 99999"
    ):
        source_of(read_dbc(tmp_path / "late.dbc"))


TWO = """VERSION ""

NS_ :
\tCM_
\tBA_DEF_

BS_:

BU_: A B

BO_ 256 one: 8 A
 SG_ x : 0|16@1+ (0.1,0) [0|100] "V" B
 SG_ y : 16|8@1+ (1,-40) [-40|210] "degC" B

BO_ 257 two: 8 A
 SG_ z : 0|8@1+ (1,0) [0|0] "" B

"""
FINE = 'CM_ SG_ 256 y "fine";\nBA_DEF_ BO_ "GenMsgCycleTime" INT 0 1000;\nBA_DEF_DEF_ "GenMsgCycleTime" 10;\n'
ALL = {"one": ["x", "y"], "two": ["z"]}
BAD_LINES = {
    "unclosed comment": (TWO + 'CM_ SG_ 256 x "never closed;\n' + FINE, ALL, ["line 18"]),
    "quotes in a comment": (TWO + 'CM_ SG_ 256 x "a 5" pipe";\n' + FINE, ALL, ["line 18"]),
    "no semicolon": (TWO + 'CM_ SG_ 256 x "fine"\n' + FINE, ALL, ["line 18"]),
    "a line of nothing": (TWO + "hello world\n" + FINE, ALL, ["line 18"]),
    "two of them": (
        TWO + "hello world\n" + FINE + 'VAL_ 256 y 0 "off" 1 "on;\n',
        ALL,
        ["line 18", "line 22"],
    ),
    "attribute of no definition": (TWO + 'BA_ "Nope" BO_ 256 10;\n' + FINE, ALL, ["line 18"]),
    "a signal": (
        TWO.replace("(0.1,0)", "(0,1,0)") + FINE,
        {"one": ["y"], "two": ["z"]},
        ["line 12"],
    ),
    "a message": (TWO.replace("257 two:", "257 two") + FINE, {"one": ["x", "y"]}, ["line 15"]),
    "a message's keyword": (
        TWO.replace("BO_ 257", "B0_ 257") + FINE,
        {"one": ["x", "y"]},
        ["line 15"],
    ),
    "how values are read": (
        TWO + "SIG_VALTYPE_ 256 x 1;\n" + FINE,
        {"two": ["z"]},
        ["line 18", "one"],
    ),
    "how often it comes": (
        TWO + FINE + 'BA_ "GenMsgCycleTime" BO_ 257 "soon;\n',
        {"one": ["x", "y"]},
        ["line 21", "two"],
    ),
}


@pytest.mark.parametrize("kind", BAD_LINES)
def test_a_line_that_cannot_be_read_costs_that_line_and_is_named(tmp_path, kind):
    """What it would have said of values costs its message too: no signal is read as something else."""
    text, usable, unusable = BAD_LINES[kind]
    (tmp_path / "bus.dbc").write_text(text)
    found = read_dbc(tmp_path / "bus.dbc")
    assert {name: list(layout.units) for name, layout in found.items()} == usable
    assert sorted(found.unusable) == sorted(unusable)
    for place in unusable:
        line = int(place.removeprefix("line ")) if " " in place else 0
        shown = text.splitlines()[line - 1].strip()[:15]
        assert not line or (
            shown in found.unusable[place] and f"bus.dbc, {place}: " in found.unusable[place]
        )


def test_a_file_of_nothing_but_such_lines_is_none(tmp_path):
    (tmp_path / "bus.dbc").write_text("".join(f"BO_ {k} a{k} 8 A\n" for k in range(60)))
    with pytest.raises(BadBusDescription, match="cannot be read as a DBC file"):
        read_dbc(tmp_path / "bus.dbc")


CODES = """VERSION ""
BS_:
BU_: A
BO_ 2566834942 engine: 8 A
 SG_ speed : 0|16@1+ (0.125,0) [0|8031.875] "rpm" A
 SG_ oil : 16|8@1+ (1,-40) [-40|210] "degC" A
 SG_ gas : 24|16@1+ (0.03125,-273) [-273|1734.96875] "degC" A
 SG_ switch : 40|2@1+ (1,0) [0|3] "" A
 SG_ load : 42|6@1+ (1,0) [0|0] "%" A
 SG_ raw : 48|8@1+ (1,0) [0|255] "" A
 SG_ bare : 56|8@1+ (0.4,0) [0|0] "%" A
BO_ 300 plain: 8 A
 SG_ turned : 7|16@0- (-0.1,5) [-3000|3000] "A" A
 SG_ level : 16|12@1+ (0.5,0) [0|2000] "%" A
 SG_ mode : 28|4@1+ (1,0) [0|15] "" A
 SG_ any : 32|8@1+ (1,0) [0|0] "" A
 SG_ far : 40|24@1+ (1,0) [0|16000000] "m" A
VAL_ 300 mode 0 "off" 1 "error" 7 "SNA" 15 "signal_not_available" ;
"""
J1939 = 'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
J1939 += 'BA_DEF_DEF_ "VFrameFormat" "J1939PG";\n'


def frames_of(layout, **raw):
    """Frames with these raw numbers, one after the other, and 1 in all other signals."""
    n = max(map(len, raw.values()))
    numbers = np.ones((n, len(layout._names)), np.uint64)
    for name, values in raw.items():
        numbers[: len(values), layout._names.index(name)] = np.array(values, np.uint64)
    return layout._bits.frames(numbers, layout.length)


@pytest.mark.parametrize("j1939", [False, True])
def test_codes_for_no_value_are_told_by_their_bits_whatever_the_scaling(tmp_path, j1939):
    (tmp_path / "bus.dbc").write_text(CODES + J1939 * j1939)
    layout = read_dbc(tmp_path / "bus.dbc")["engine"]
    two = [0xFAFF, 0xFB00, 0xFE00, 0xFEFF, 0xFF00, 0xFFFF]
    one = [0xFA, 0xFB, 0xFE, 0xFE, 0xFF, 0xFF]
    frames = frames_of(
        layout,
        speed=two,
        gas=two,
        oil=one,
        raw=one,
        bare=one,
        switch=[0, 1, 2, 2, 3, 3],
        load=[63] * 6,
    )
    _, values = layout.decode(frames)
    for name in ("speed", "gas", "oil"):
        assert np.isnan(values[name]).tolist() == [False, True, True, True, True, True], name
    assert values["speed"][0] == 8031.875 and values["oil"][0] == 210.0
    # of J1939 0xFE and 0xFF are no values although the file's range is all that the bits hold
    assert np.isnan(values["raw"]).tolist() == [False, False, *[j1939] * 4]
    assert np.isnan(values["bare"][1:]).all() == j1939 and not np.isnan(values["switch"]).any()
    of_j1939 = {"bare": 5, "raw": 4} if j1939 else {}
    assert layout.codes(frames) == {"speed": 5, "oil": 5, "gas": 5} | of_j1939


def test_codes_of_another_bus_are_all_ones_ends_of_a_sign_and_what_a_value_table_names(tmp_path):
    (tmp_path / "bus.dbc").write_text(CODES)
    layout = read_dbc(tmp_path / "bus.dbc")["plain"]
    frames = frames_of(
        layout,
        turned=[0x8000, 0x7FFF, 0x8001, 0],
        level=[0xFFF, 4000, 0, 1],
        mode=[7, 15, 1, 0],
        any=[0xFF] * 4,
        far=[0xFFFFFF, 16000000, 1, 2],
    )
    _, values = layout.decode(frames)
    lacks = {name: np.flatnonzero(np.isnan(each)).tolist() for name, each in values.items()}
    assert lacks == {"turned": [0, 1], "level": [0], "mode": [0, 1], "any": [], "far": [0]}
    _, values = layout.decode(frames_of(layout, level=[0xFFE], far=[0xFFFFFE]))
    assert np.isfinite(values["level"]).all() and np.isfinite(values["far"]).all(), (
        "only J1939 keeps more"
    )
