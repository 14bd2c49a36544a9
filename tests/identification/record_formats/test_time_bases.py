"""Channels with times of their own: what was not measured is missing, what is not read is named."""

import asammdf
import nptdms
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from residuum.identification.errors import BadRecord
from residuum.identification.record_formats import ReadOptions, read_record
from residuum.identification.record_formats.even_time import is_stepped, made_even
from residuum.identification.record_formats.time_bases import TimedChannel, on_one_base

FAST = 0.001 * np.arange(2000)
SLOW = FAST[::20] + 0.0003
RESAMPLE = ReadOptions(resample=True)
WAVE = np.sin(4.0 * FAST)


def mdf(path, *signals, version="4.10"):
    with asammdf.MDF(version=version) as file:
        for name, unit, time, values in signals:
            encoding = "latin-1" if np.asarray(values).dtype.kind == "S" else None
            file.append([asammdf.Signal(values, time, name=name, unit=unit, encoding=encoding)])
        file.save(path, overwrite=True)
    return path


def tdms(path, *channels):
    with nptdms.TdmsWriter(path) as file:
        written = [
            nptdms.ChannelObject("g", name, values, properties)
            for name, values, properties in channels
        ]
        file.write_segment([nptdms.RootObject(), nptdms.GroupObject("g"), *written])
    return path


def waveform(step, unit):
    return {"wf_increment": step, "wf_start_offset": 0.0, "unit_string": unit}


def test_a_channel_that_begins_late_or_ends_early_is_missing_before_and_after(tmp_path):
    late = SLOW[(SLOW > 0.5) & (SLOW < 1.5)]
    file = mdf(tmp_path / "r.mf4", ("force", "N", FAST, WAVE), ("speed", "m/s", late, np.cos(late)))
    record = read_record(file, RESAMPLE)
    known = ~record.missing("speed")
    assert record.n == 2000 and not record.missing("force").any()
    assert (
        record.time[known].min() >= late[0] - 1e-9 and record.time[known].max() <= late[-1] + 1e-9
    )
    np.testing.assert_allclose(record["speed"][known], np.cos(record.time[known]), atol=1e-4)
    assert any("speed" in note and "left missing" in note for note in record.notes)


def test_a_hole_in_one_channel_stays_missing(tmp_path):
    there = SLOW[(SLOW < 0.5) | (SLOW > 1.2)]
    record = read_record(
        mdf(tmp_path / "r.mf4", ("force", "N", FAST, WAVE), ("speed", "m/s", there, np.cos(there))),
        RESAMPLE,
    )
    hole = (record.time > there[there < 0.5][-1] + 1e-6) & (
        record.time < there[there > 1.2][0] - 1e-6
    )
    assert record.missing("speed")[hole].all() and hole.sum() > 600


@pytest.mark.parametrize("kind", ["u1", "f8"])
def test_a_gear_never_stands_between_two_gears(tmp_path, kind):
    gear = np.where(SLOW < 1.0, 1, 4).astype(kind)
    record = read_record(
        mdf(tmp_path / "r.mf4", ("force", "N", FAST, WAVE), ("gear", "", SLOW, gear)), RESAMPLE
    )
    assert set(record["gear"][~record.missing("gear")]) == {1.0, 4.0}
    assert any("held between its samples" in note for note in record.notes)


def test_a_signal_that_moves_at_every_sample_is_not_stepped():
    assert (
        not is_stepped(WAVE)
        and not is_stepped(np.arange(40.0))
        and is_stepped(np.repeat([0.5, 1.5, 0.7], 5))
    )


def test_several_bases_are_refused_with_each_channel_and_the_option(tmp_path):
    file = mdf(tmp_path / "r.mf4", ("force", "N", FAST, WAVE), ("speed", "m/s", SLOW, np.cos(SLOW)))
    with pytest.raises(
        BadRecord,
        match=r"force: 2000 samples of 0\.001 s .*; speed: 100 samples of 0\.02 s .*resample=True",
    ):
        read_record(file)


def test_a_channel_of_text_is_named_and_older_files_are_read(tmp_path):
    names = np.array([b"on", b"off"] * 1000)
    file = mdf(tmp_path / "r.mf4", ("force", "N", FAST, WAVE), ("state", "", FAST, names))
    assert read_record(file).notes == ("not read: state (no numbers)",)
    older = read_record(mdf(tmp_path / "r.mdf", ("force", "N", FAST, WAVE), version="3.30"))
    assert older.units["force"] == "N" and older.sample_time == pytest.approx(0.001)


def test_a_slower_channel_keeps_its_samples_at_their_instants(tmp_path):
    file = tdms(
        tmp_path / "r.tdms",
        ("force", WAVE, waveform(0.001, "N")),
        ("speed", WAVE[::10], waveform(0.01, "m/s")),
    )
    record = read_record(file)
    np.testing.assert_array_equal(np.flatnonzero(~record.missing("speed")), np.arange(0, 2000, 10))
    np.testing.assert_array_equal(record["speed"][::10], WAVE[::10])


def test_a_shorter_channel_is_missing_at_its_end(tmp_path):
    file = tdms(
        tmp_path / "r.tdms",
        ("force", WAVE, waveform(0.001, "N")),
        ("speed", WAVE[:-3], waveform(0.001, "m/s")),
    )
    assert np.flatnonzero(read_record(file).missing("speed")).tolist() == [1997, 1998, 1999]


@pytest.mark.parametrize(
    "clock", [FAST, np.datetime64("2024-01-01") + (FAST * 1e6).round().astype("timedelta64[us]")]
)
def test_a_channel_of_times_is_the_time_and_its_units_are_read_where_they_stand(tmp_path, clock):
    file = tdms(
        tmp_path / "r.tdms", ("Time", clock, {}), ("force", WAVE, {"NI_UnitDescription": "N"})
    )
    record = read_record(file)
    assert (
        record.names == ("force",)
        and record.units["force"] == "N"
        and record.sample_time == pytest.approx(0.001)
    )


def test_times_that_nothing_says_are_asked_for(tmp_path):
    file = tdms(tmp_path / "r.tdms", ("force", WAVE, {}))
    with pytest.raises(BadRecord, match=r"channel 'force'.*say sample_time=SECONDS"):
        read_record(file)
    assert read_record(file, ReadOptions(sample_time=0.5)).sample_time == 0.5


def test_a_clock_that_counts_rows_is_not_taken_for_seconds(tmp_path):
    file = tdms(tmp_path / "r.tdms", ("Time", np.arange(2000.0), {}), ("force", WAVE, {}))
    with pytest.raises(BadRecord, match="nothing says the unit of channel 'Time'"):
        read_record(file)


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_rows_that_are_taken_out_are_missing_and_no_other(data):
    n = data.draw(st.integers(20, 200))
    step = data.draw(st.sampled_from([1e-4, 0.01, 0.5, 60.0]))
    gone = data.draw(st.sets(st.integers(1, n - 2), max_size=n // 10))
    kept = np.array([k for k in range(n) if k not in gone])
    values = np.sin(np.arange(n) * 0.3)
    found_step, signals, _ = made_even(step * kept, values[None, kept], "r.csv")
    assert found_step == pytest.approx(step)
    np.testing.assert_array_equal(np.isnan(signals[0]), np.isin(np.arange(n), sorted(gone)))
    np.testing.assert_array_equal(signals[0, kept], values[kept])
    channels = [
        TimedChannel("a", "V", step * np.arange(n), values),
        TimedChannel("b", "V", step * kept, values[kept]),
    ]
    record = on_one_base(channels, "r.mf4", ReadOptions())
    assert set(np.flatnonzero(record.missing("b"))) == gone and not record.missing("a").any()
