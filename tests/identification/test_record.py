"""Record: what it accepts, refuses and keeps."""

import numpy as np
import pytest

from residuum.identification.errors import BadRecord, BadUnit
from residuum.identification.record import Record


def test_channels_are_read_only_and_keep_float32():
    record = Record({"a": np.zeros(4, dtype=np.float32)}, {"a": "g"}, 0.1)
    assert record["a"].dtype == np.float32
    with pytest.raises(ValueError, match="read-only"):
        record["a"][0] = 1


def test_units_convert_by_name():
    record = Record({"n": [60.0], "T": [20.0]}, {"n": "rpm", "T": "°C"}, 1.0)
    assert record.in_unit("n", "rad/s")[0] == pytest.approx(2 * np.pi)
    assert record.in_unit("T", "K")[0] == pytest.approx(293.15)
    with pytest.raises(BadUnit, match="cannot be converted"):
        record.in_unit("n", "V")


@pytest.mark.parametrize("wanted", ["%", "deg", "rad", "V"])
def test_a_channel_without_a_unit_is_converted_to_none(wanted):
    record = Record({"duty": [60.0]}, {"duty": ""}, 1.0, source="r.csv")
    told = rf"record 'r.csv', channel 'duty': has no unit, and '{wanted}' is needed; say units={{'duty': '{wanted}'}}"
    with pytest.raises(BadUnit, match=told):
        record.in_unit("duty", wanted)
    assert record.in_unit("duty", "")[0] == record.in_unit("duty", "1")[0] == 60.0


def test_what_is_to_be_typed_is_said_as_python_takes_it():
    record = Record({"Motor voltage": [6.0]}, {"Motor voltage": ""}, 1.0)
    with pytest.raises(BadUnit, match=r"units={'Motor voltage': 'V'}"):
        record.in_unit("Motor voltage", "V")


def test_a_unit_of_another_kind_is_refused_with_its_record():
    record = Record({"n": [6.0]}, {"n": "bar"}, 1.0, source="r.csv")
    with pytest.raises(
        BadUnit,
        match=r"record 'r\.csv', channel 'n': unit 'bar' cannot be converted to 'rad/s'; say .* if .* all the same",
    ):
        record.in_unit("n", "rad/s")


def test_a_unit_that_nobody_knows_is_said_in_the_way_that_is_told():
    record = Record({"M": [6.0]}, {"M": "Nmeter"}, 1.0)
    with pytest.raises(
        BadUnit, match=r"nobody knows 'Nmeter'; say units={'M': 'N\*m'} if the column is in"
    ):
        record.in_unit("M", "N*m")


@pytest.mark.parametrize(
    ("channels", "units", "sample_time", "rule"),
    [
        ({}, {}, 1.0, "at least one"),
        ({"a": [1.0, np.inf]}, {"a": "V"}, 1.0, "sample 1: is infinite"),
        ({"a": [1.0], "b": [1.0, 2.0]}, {"a": "V", "b": "V"}, 1.0, "all must be equal"),
        ({"a": [1.0]}, {}, 1.0, "has no unit"),
        ({"a": [1.0]}, {"a": "V"}, 0.0, "positive"),
        ({"a": [[1.0]]}, {"a": "V"}, 1.0, "one-dimensional"),
        ({"a": ["x"]}, {"a": "V"}, 1.0, "not an array of numbers"),
    ],
)
def test_bad_records_are_refused(channels, units, sample_time, rule):
    with pytest.raises(BadRecord, match=rule):
        Record(channels, units, sample_time)


def test_what_is_no_unit_is_refused():
    with pytest.raises(BadUnit, match="m//s"):
        Record({"a": [1.0]}, {"a": "m//s("}, 1.0)


def test_window_keeps_the_clock_and_missing_samples():
    record = Record({"a": [0.0, np.nan, 2.0, 3.0]}, {"a": "V"}, 0.5, t0=10.0, notes=("split: 0.7",))
    part = record.window(1, 3)
    assert part.t0 == 10.5
    assert part.missing("a").tolist() == [True, False]
    assert record.split == 0.7
