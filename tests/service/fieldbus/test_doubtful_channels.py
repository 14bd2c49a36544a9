"""What is said of polled values that look wrong: the likeliest order of words, and for as long as a channel cannot be trusted."""

import struct

import numpy as np
import pytest

from residuum.service.fieldbus.modbus.channel_registers import ChannelRegisters
from residuum.service.fieldbus.modbus.device_reading import ChannelReading, reading_of
from residuum.service.fieldbus.modbus.modbus_source import DoubtfulChannels


@pytest.mark.parametrize("value", [1352.6334, 1736.1733, 1200.5, 230.25])
def test_an_order_that_turns_bytes_is_named_only_where_no_exchange_of_words_explains_the_value(
    value,
):
    high, low = struct.unpack(">HH", struct.pack(">f", value))
    reading = reading_of(
        "meter",
        "power",
        ChannelRegisters(register=0, type="float32"),
        ("holding", 0),
        (low, high),
        1e-27,
    )
    assert reading.plausible == "CDAB" and reading.remark.startswith(
        "CDAB looks more like a measured value than ABCD"
    )


def test_turned_bytes_are_named_where_nothing_else_fits():
    words = struct.unpack("<HH", struct.pack(">f", 1500.25))
    reading = reading_of(
        "meter", "power", ChannelRegisters(register=0, type="float32"), ("holding", 0), words, 1e-27
    )
    assert reading.plausible == "BADC"


def test_words_that_make_a_signalling_nan_are_missing_without_a_word_on_the_terminal():
    words = np.array([[0x7F80, 0x0001]], np.uint16)
    assert np.isnan(ChannelRegisters(register=0, type="float32").values(words)[0])


def read(remark):
    return [
        ChannelReading(
            "meter", "temperature", "°C", "holding", 4, (0x8000,), -3276.8, remark=remark
        )
    ]


def test_a_sensor_that_is_there_now_and_then_stays_doubtful_in_between():
    channels = DoubtfulChannels()
    for remark in ["say missing: -32768"] * 4 + [""] * 6 + [""] * 90:
        channels.look(read(remark))
    assert channels.sentences == ["meter.temperature: say missing: -32768"]
    for _ in range(20):
        channels.look(read(""))
    assert channels.sentences == []


def test_what_is_said_most_often_is_said():
    channels = DoubtfulChannels()
    for k in range(10):
        channels.look(read("CDAB looks likelier" if k < 9 else "DCBA looks likelier"))
    assert channels.sentences == ["meter.temperature: CDAB looks likelier"]


@pytest.mark.parametrize("celsius", [-4.5, -0.1, -40.0, -150.0])
def test_an_unsigned_register_that_is_a_negative_number_is_told(celsius):
    raw = round(celsius * 10) % 65536
    where = ChannelRegisters(register=0, type="uint16", scale=0.1, unit="°C")
    reading = reading_of("meter", "temperature", where, ("holding", 0), (raw,), raw * 0.1)
    if raw == 0xFFFF:
        assert "no value" in reading.remark
    else:
        assert (
            f"looks more like {celsius:g} than" in reading.remark
            and "say type: int16" in reading.remark
        )
    assert not reading_of("meter", "temperature", where, ("holding", 0), (30_000,), 3000.0).remark
