"""Register maps as devices have them: every table, order and sentinel, holes, and what is wrong with a map."""

import importlib.util
import itertools
import json
import re
import struct
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from residuum.service.cli import run
from residuum.service.fieldbus.can.frame_layout import BadBusDescription
from residuum.service.fieldbus.modbus.channel_registers import explained
from residuum.service.fieldbus.modbus.modbus_source import ModbusSource
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.fieldbus.modbus.register_table import register_map_of

_spec = importlib.util.spec_from_file_location(
    "small_device", Path(__file__).with_name("small_device.py")
)
_module = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_module)
SmallDevice = _module.SmallDevice

ORDERS = [(word, byte) for word in ("big", "little") for byte in ("big", "little")]
VALUES = {"float32": ("f", 1500.25), "uint32": ("I", 123456), "int32": ("i", -98765), "float64": ("d", -2.5e-3),
          "uint64": ("Q", 2**63 + 2**40), "int64": ("q", -(2**40))}  # fmt: skip


def in_registers(kind, value, word_order, byte_order):
    """The registers that a device of this order would hold, by the standard library alone."""
    packed = struct.pack(f">{kind}", value)
    words = [packed[k : k + 2] for k in range(0, len(packed), 2)]
    if word_order == "little":
        words.reverse()
    return [int.from_bytes(word, byte_order) for word in words]


@pytest.fixture
def write_map(tmp_path):
    def write(channels, poll=None, **more):
        stream = {"sample_time": 0.05, "poll": {"address": 0, **(poll or {})}, "channels": channels}
        file = tmp_path / "device.yaml"
        file.write_text(yaml.safe_dump({"streams": {"meter": stream}, **more}, sort_keys=False))
        return file

    return write


def first_block(device, map_file, condition=bool):
    """The first block that a source gives of this device, and its health then."""
    blocks = []
    source = ModbusSource(
        "127.0.0.1",
        device.port,
        read_register_map(map_file),
        lambda block: blocks.append(block) or True,
        30.0,
    )
    source.start()
    end = time.monotonic() + 120
    while not (condition(source.health) and blocks) and time.monotonic() < end:
        time.sleep(0.01)
    source.stop()
    source.join()
    return {name: values[0] for name, values in blocks[0].channels.items()}, source.health


def test_every_type_in_every_order_of_words_and_bytes(write_map):
    channels, registers, expected = {}, {}, {}
    for (name, (kind, value)), (word, byte) in itertools.product(VALUES.items(), ORDERS):
        channel, first = f"{name}_{word}_{byte}", len(registers)
        words = in_registers(kind, value, word, byte)
        registers |= {first + k: each for k, each in enumerate(words)}
        channels[channel] = {
            "register": first,
            "type": name,
            "word_order": word,
            "byte_order": byte,
        }
        expected[channel] = value
    channels["int16"] = {"register": 200, "type": "int16", "scale": 0.1, "offset": -5}
    channels["uint16_swapped"] = {"register": 201, "byte_order": "little"}
    with SmallDevice(holding=registers | {200: 0xFFF6, 201: 0x0102}) as device:
        read, _ = first_block(device, write_map(channels))
    assert read == pytest.approx(expected | {"int16": -6.0, "uint16_swapped": 0x0201})


def test_what_means_that_there_is_no_value_is_missing(write_map):
    channels = {
        "temperature": {"register": 0, "type": "int16", "scale": 0.1, "missing": -32768},
        "as_bits": {"register": 1, "type": "int16", "missing": 0x8000},
        "spare": {"register": 2, "missing": [0xFFFF, 0xFFFE]},
        "there": {"register": 3, "missing": [0xFFFF, 0xFFFE]},
        "nan": {"register": 4, "type": "float32"},
        "far": {"register": 6, "type": "float32", "word_order": "little", "missing": -9999.0},
        "wide": {"register": 8, "type": "uint32", "missing": 0xFFFFFFFF},
        "state": {"register": 10, "type": "bit", "bit": 3, "missing": 0xFFFF},
    }
    far = in_registers("f", -9999.0, "little", "big")
    held = [0x8000, 0x8000, 0xFFFE, 0x7FFF, 0x7FC0, 0, *far, 0xFFFF, 0xFFFF, 0xFFFF]
    with SmallDevice(holding=dict(enumerate(held))) as device:
        read, health = first_block(device, write_map(channels))
    assert {name for name, value in read.items() if np.isnan(value)} == set(channels) - {"there"}
    assert read["there"] == 0x7FFF and health["modbus_exceptions"] == 0


def test_polled_values_that_look_wrong_are_doubtful_and_the_remark_says_what_to_write(write_map):
    held = [
        *in_registers("f", 1500.25, "little", "big"),
        0x8000,
        *in_registers("f", 230.1, "big", "big"),
        0xFFFF,
    ]
    channels = {
        "power": {"register": 0, "type": "float32"},
        "temperature": {"register": 2, "type": "int16", "scale": 0.1},
        "voltage": {"register": 3, "type": "float32"},
        "spare": {"register": 5, "missing": 0xFFFF},
    }
    with SmallDevice(holding=dict(enumerate(held))) as device:
        _, health = first_block(
            device, write_map(channels), lambda health: health.snapshot()["quality"] == "doubtful"
        )
        power, temperature = health.snapshot()["remarks"]
        assert (
            power.startswith("meter.power: CDAB looks more like")
            and "missing: -32768" in temperature
        )
        channels["power"]["word_order"] = "little"
        channels["temperature"]["missing"] = -32768
        _, health = first_block(
            device, write_map(channels), lambda health: health.snapshot()["samples"] > 25
        )
    # a busy machine polls late
    assert health.snapshot()["remarks"] == [] and health.snapshot()["quality"] in ("good", "losing")


def test_bit_fields_scale_registers_and_every_table(write_map):
    channels = {
        "flag": {"register": 0, "type": "bit", "bit": 15},
        "field": {"register": 0, "type": "bit", "bit": 4, "bits": 3, "scale": 10},
        "voltage": {"register": 1, "scale_register": 2, "unit": "V"},
        "none": {"register": 3, "scale_register": 4},
        "measured": {"register": 7, "type": "int16", "function": "input"},
        "running": {"register": 3, "type": "bit", "function": "coils"},
        "door": {"register": 12, "type": "bit", "function": "discrete"},
    }
    holding = {0: 0x8000 | 5 << 4, 1: 2300, 2: 0xFFFF, 3: 7, 4: 0x8000}
    with SmallDevice(holding=holding, input={7: 0xFFFF}, coils={3: 1}, discrete={12: 1}) as device:
        read, _ = first_block(device, write_map(channels))
        assert {table for table, _, _ in device.asked} == {"holding", "input", "coils", "discrete"}
    none = read.pop("none")
    assert np.isnan(none)
    assert read == pytest.approx(
        {"flag": 1, "field": 50, "voltage": 230.0, "measured": -1, "running": 1, "door": 1}
    )


def test_holes_are_never_read_unless_the_map_says_so(write_map):
    channels = {
        "a": {"register": 0},
        "b": {"register": 1, "type": "float32"},
        "c": {"register": 5},
        "far": {"register": 9000},
    }
    registers = {0: 1, 1: 0x3F80, 2: 0, 5: 3, 9000: 4}
    with SmallDevice(holding=registers) as device:
        read, health = first_block(device, write_map(channels))
        assert set(device.asked) == {("holding", 0, 3), ("holding", 5, 1), ("holding", 9000, 1)}
    assert read == {"a": 1, "b": 1.0, "c": 3, "far": 4} and health["modbus_exceptions"] == 0
    with SmallDevice(holding=registers | {3: 0, 4: 0}) as device:
        first_block(device, write_map(channels, {"gap": 2}))
        assert set(device.asked) == {("holding", 0, 6), ("holding", 9000, 1)}


def test_more_than_one_read_takes_is_read_in_several_and_no_value_is_parted(write_map):
    channels = {f"x{k}": {"register": 2 * k, "type": "uint32"} for k in range(100)}
    with SmallDevice(
        holding={2 * k + low: k * low for k in range(100) for low in (0, 1)}
    ) as device:
        read, _ = first_block(device, write_map(channels))
        assert set(device.asked) == {("holding", 0, 124), ("holding", 124, 76)}
    assert read == {f"x{k}": k for k in range(100)}


def test_the_base_of_addresses_is_said_and_a_unit_is_asked(write_map):
    with SmallDevice(unit=7, holding={0: 11, 1: 22}) as device:
        for base, address, expected in ((0, 0, 11), (1, 1, 11), (0, 1, 22)):
            file = write_map(
                {"x": {"register": 0}}, {"address": address}, address_base=base, unit_id=7
            )
            assert first_block(device, file)[0] == {"x": expected}


@pytest.mark.parametrize(
    ("address", "says"),
    [
        (
            40001,
            r"exception 2 for holding registers 40005 .*no such register.*a manual's 40005 is address 4 of this table",
        ),
        (
            1,
            r"exception 2 for holding registers 5 .*no such register.*one off\? .*say address_base: 1",
        ),
    ],
)
def test_exception_2_is_explained_and_costs_only_what_the_device_refuses(write_map, address, says):
    registers = {address + k: 9 for k in range(4)}
    with SmallDevice(holding=registers) as device:
        file = write_map({"there": {"register": 0}, "gone": {"register": 4}}, {"address": address})
        read, health = first_block(device, file, lambda health: health["modbus_exceptions"])
    assert read["there"] == 9 and np.isnan(read["gone"])
    assert re.search(says, health.snapshot()["last_trouble"])


@pytest.mark.parametrize(
    ("channels", "poll", "more", "says"),
    [
        (
            {"a": {"register": 0, "type": "float32"}, "b": {"register": 1}},
            {},
            {},
            "channels.b: register 1 belongs to a already",
        ),
        (
            {"a": {"register": 3}, "b": {"register": 3}},
            {},
            {},
            "channels.b: register 3 belongs to a already .*correct register",
        ),
        (
            {
                "a": {"register": 3, "type": "bit", "bits": 4},
                "b": {"register": 3, "type": "bit", "bit": 3},
            },
            {},
            {},
            "belongs to a",
        ),
        (
            {"a": {"register": 0, "type": "float32", "registers": 1}},
            {},
            {},
            "float32 takes 2 registers, registers says 1",
        ),
        ({"a": {"register": 65535, "type": "uint32"}}, {}, {}, "goes beyond register 65535"),
        (
            {"a": {"register": 0, "type": "bit", "bit": 14, "bits": 3}},
            {},
            {},
            "bits 14 to 16 do not lie in one register",
        ),
        (
            {"a": {"register": 0}},
            {"function": "coils"},
            {},
            "function coils gives single bits; type must be bit",
        ),
        (
            {"a": {"register": 0}},
            {"address": 0},
            {"address_base": 1},
            "streams.meter: address 0 lies before address_base 1",
        ),
        (
            {"a": {"register": 0}},
            {"address": 400001},
            {},
            "400001 on the wire; the last is 65535. Take off the digit",
        ),
        (
            {"a": {"register": 0, "wordorder": "little"}},
            {},
            {},
            "known are register, type, registers, word_order",
        ),
        ({"a": {"register": 0, "scale": 0}}, {}, {}, "scale is 0"),
    ],
)
def test_a_map_that_cannot_be_right_is_refused_in_one_line(write_map, channels, poll, more, says):
    with pytest.raises(BadBusDescription, match=says) as refusal:
        read_register_map(write_map(channels, poll, **more))
    assert str(refusal.value).startswith("device.yaml, ") and "\n" not in str(refusal.value)


def test_a_channel_that_is_named_twice_is_refused_with_its_line(tmp_path):
    lines = ["streams:", "  a:", "    sample_time: 1", "    poll: {address: 0}", "    channels:"]
    (tmp_path / "twice.yaml").write_text(
        "\n".join([*lines, "      x: {register: 0}", "      x: {register: 1}"])
    )
    with pytest.raises(
        BadBusDescription,
        match=r"twice\.yaml, line 7: 'x' is named twice in one place; rename or remove one",
    ):
        read_register_map(tmp_path / "twice.yaml")


def test_inspect_shows_raw_words_beside_every_order_and_marks_the_plausible_one(write_map, capsys):
    channels = {
        "power": {"register": 0, "type": "float32", "unit": "W"},
        "energy": {"register": 2, "type": "uint32", "unit": "W*h"},
        "temperature": {"register": 4, "type": "int16", "scale": 0.1, "unit": "°C"},
        "off": {"register": 5, "missing": 0xFFFF},
        "gone": {"register": 30},
    }
    held = [
        *in_registers("f", 1500.25, "little", "big"),
        *in_registers("I", 123456, "little", "big"),
        0x8000,
        0xFFFF,
    ]
    file = write_map(channels)
    with SmallDevice(holding=dict(enumerate(held))) as device:
        where = f"modbus:127.0.0.1:{device.port}"
        assert run(["inspect", where, "--map", str(file), "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert run(["inspect", where, "--map", str(file)]) == 0
        text = capsys.readouterr().out
    by_name = {channel["channel"]: channel for channel in found["channels"]}
    power = by_name["power"]
    assert power["words"] == [f"{word:04X}" for word in held[:2]]
    assert power["orders"]["CDAB"] == 1500.25 and set(power["orders"]) == {
        "ABCD",
        "CDAB",
        "BADC",
        "DCBA",
    }
    assert (
        power["plausible"] == "CDAB"
        and by_name["energy"]["plausible"] == "CDAB"
        and by_name["energy"]["orders"]["CDAB"] == 123456
    )
    assert "say missing: -32768" in by_name["temperature"]["remark"]
    assert (by_name["off"]["value"], by_name["off"]["remark"]) == (None, "missing")
    assert "gone" not in by_name and "exception 2 for holding registers 30" in found["refused"][0]
    assert "CDAB 1500.25 *" in text and "* the plausible one" in text


def test_inspect_says_what_it_lacks(write_map, capsys, free_port):
    file = write_map({"a": {"register": 0}})
    assert run(["inspect", f"modbus:127.0.0.1:{free_port()}", "--map", str(file)]) == 2
    assert "cannot be read" in capsys.readouterr().err
    assert run(["inspect", "modbus:127.0.0.1:502"]) == 2
    assert "--map FILE" in capsys.readouterr().err
    with SmallDevice(unit=1, holding={0: 1}) as device:
        assert (
            run(
                [
                    "inspect",
                    f"modbus:127.0.0.1:{device.port}",
                    "--map",
                    str(write_map({"a": {"register": 0}}, unit_id=9)),
                ]
            )
            == 0
        )
        assert "no answer from behind the gateway; look at unit_id" in capsys.readouterr().out


def test_a_map_that_is_not_there_is_said_to_be_so(tmp_path):
    with pytest.raises(BadBusDescription, match=r"^none\.yaml: no such file$"):
        read_register_map(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    "number", ["0040", "010", "-007", "0100", "0089", "1:29", "12:30:00", "1:29.5"]
)
@pytest.mark.parametrize("place", ["address", "register", "unit_id", "scale"])
def test_a_number_that_yaml_reads_otherwise_is_refused_where_it_stands(tmp_path, number, place):
    at = {"address": "40", "register": "0", "unit_id": "1", "scale": "0.1"} | {place: number}
    file = tmp_path / "map.yaml"
    file.write_text(
        f"unit_id: {at['unit_id']}\nstreams:\n  m:\n    sample_time: 0.1\n    poll: {{address: {at['address']}}}\n"
        f"    channels:\n      flow: {{register: {at['register']}, type: int16, scale: {at['scale']}, unit: l/min}}\n"
    )
    with pytest.raises(BadBusDescription, match=r"line \d.*(leading zero|colon).*(write|quote)"):
        read_register_map(file)
    file.write_text(
        file.read_text().replace(f": {number}", ": 0x2" if place != "scale" else ": 0.2")
    )
    read_register_map(file)


@pytest.mark.parametrize("pad", ["", "0", "00"])
def test_a_table_of_registers_is_decimal_with_zeros_before_or_not(tmp_path, pad):
    rng = np.random.default_rng(len(pad))
    addresses = sorted(rng.choice(np.arange(8, 120), 5, replace=False).tolist())
    rows = "\n".join(f"s{a},{pad}{a},int16,l/min" for a in addresses)
    (tmp_path / "t.csv").write_text(f"name,register,type,unit\n{rows}\n")
    made = register_map_of((tmp_path / "t.csv").read_text(), 0.1)
    (stream,) = made["streams"].values()
    assert [
        stream["poll"]["address"] + c["register"] for c in stream["channels"].values()
    ] == addresses


@pytest.mark.parametrize("base", [0, 1])
@pytest.mark.parametrize("address", [40001, 40041, 400101])
def test_the_advice_counts_as_the_map_does(base, address):
    said = explained(2, "holding", address - base, 1, base)
    first = 400001 if address > 400000 else 40001
    meant = address - first + base
    assert f"a manual's {address} is address {meant} of this table: take {first - base} off" in said
    assert address - (first - base) == meant
