import cantools
import numpy as np
import pytest

from residuum.service.fieldbus.frame_layout import BadBusDescription, read_dbc
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
    values = {"little": rng.uniform(-500, 500, n), "big": rng.uniform(-300, 300, n), "odd": 1.0 + 2 * rng.integers(0, 2047, n)}
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
            truth = reference.get_message_by_name(name).decode(frame.tobytes(), decode_choices=False)
            assert counter[k] == truth["counter"]
            for channel, values in channels.items():
                index = f"_{0:02d}" if layout.samples > 1 else ""
                assert values[k * layout.samples] == pytest.approx(truth[channel + index])


def test_a_block_frame_holds_samples_in_their_order():
    layout = read_dbc(MAPS / "gripping_pliers.dbc")["vibration"]
    a = np.linspace(-80, 80, 31 * 4)
    sync = (np.arange(31 * 4) % 7 == 0).astype(float)
    counter, channels = layout.decode(layout.encode([65535, 0, 1, 2], {"acceleration": a, "sync": sync}))
    assert counter.tolist() == [65535, 0, 1, 2]
    assert np.abs(channels["acceleration"] - a).max() <= 0.0026
    assert np.array_equal(channels["sync"], sync)
    assert layout.sample_time == pytest.approx(1 / 12800)


def test_a_fault_command_carries_a_float():
    layout = read_dbc(MAPS / "gate_actuator.dbc")["FAULT_COMMAND"]
    _, values = layout.decode(layout.encode([0], {"fault": [2], "size": [-1.25]}))
    assert (values["fault"][0], values["size"][0]) == (2.0, -1.25)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("SG_ counter : 0|12", "SG_ counter : 0|3"), "counter has 3 bits"),
        (('BA_ "SampleTime" BO_ 300 0.001;', ""), "no time between frames"),
        (("BO_ 300 mixed: 8 A", "BO_ 300 mixed 8 A"), "cannot be read as a DBC file"),
        (
            ("SG_ flag", 'SG_ little_00 : 41|1@1+ (1,0) [0|1] "" A\n SG_ little_01 : 42|1@1+ (1,0) [0|1] "" A\n SG_ flag'),
            "same number",
        ),
    ],
)
def test_a_description_that_cannot_be_used_is_refused(tmp_path, change, message):
    file = tmp_path / "bad.dbc"
    file.write_text(MIXED.replace(*change))
    with pytest.raises(BadBusDescription, match=message):
        read_dbc(file)
