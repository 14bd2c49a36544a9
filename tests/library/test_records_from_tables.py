"""Records from arrays, DataFrames and Datasets."""

import numpy as np
import pandas
import pytest
import xarray

import residuum as rs

TIME = 0.02 * np.arange(50)
SPEED = np.sin(3.0 * TIME)


def test_a_frame_with_instants_gives_the_record_that_its_arrays_give():
    index = pandas.Timestamp("2024-05-01 10:00") + pandas.to_timedelta(TIME, unit="s")
    frame = pandas.DataFrame({"speed [rad/s]": SPEED, "u": np.ones(50)}, index=index)
    record = rs.from_pandas(frame, units={"u": "V"})
    assert record.units == {"speed": "rad/s", "u": "V"}
    assert record.sample_time == pytest.approx(0.02)
    np.testing.assert_array_equal(record["speed"], SPEED)


def test_a_frame_and_back_is_the_same_record():
    record = rs.from_arrays({"speed": SPEED}, units={"speed": "rad/s"}, sample_time=0.02, t0=4.0)
    again = rs.from_pandas(record.to_pandas())
    assert again.units == record.units and again.t0 == 4.0
    assert again.sample_time == pytest.approx(record.sample_time)
    np.testing.assert_array_equal(again["speed"], record["speed"])


def test_a_column_may_be_the_time_and_a_step_may_be_told():
    frame = pandas.DataFrame({"t": TIME, "speed": SPEED})
    assert rs.from_pandas(frame, time="t").names == ("speed",)
    assert rs.from_pandas(frame[["speed"]], sample_time=0.5).sample_time == 0.5


def test_a_missing_value_stays_missing_and_a_hole_in_time_is_refused():
    values = np.where(np.arange(50) == 7, np.nan, SPEED)
    assert np.flatnonzero(
        rs.from_pandas(pandas.DataFrame({"y": values}, index=TIME)).missing("y")
    ).tolist() == [7]
    holed = pandas.DataFrame({"y": SPEED}, index=TIME).drop(index=TIME[20])
    with pytest.raises(rs.BadRecord, match=r"time step 0\.04 s differs from 0\.02 s"):
        rs.from_pandas(holed)


def test_a_dataset_gives_its_units():
    data = xarray.Dataset(
        {"speed": ("time", SPEED, {"units": "rad/s"}), "u": ("time", np.ones(50))},
        coords={"time": TIME},
    )
    record = rs.from_xarray(data)
    assert record.units == {"speed": "rad/s", "u": ""} and record.sample_time == pytest.approx(0.02)
    with pytest.raises(rs.BadRecord, match="has no coordinate 'when'"):
        rs.from_xarray(data, dim="when")


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (
            pandas.DataFrame({"y": [1.0, 2.0]}),
            r"is a pandas object; make a record of it with rs\.from_pandas",
        ),
        (
            xarray.DataArray([1.0, 2.0], dims="time"),
            r"is an xarray object; make a record of it with rs\.from_xarray",
        ),
        (np.zeros(5), r"is an array; make a record of it with rs\.from_arrays"),
        ([], "is list; must be a Record"),
        (3, "is int; must be a Record"),
    ],
)
def test_what_is_no_record_is_refused_with_the_way_out(given, says):
    with pytest.raises(rs.BadRecord, match=says):
        rs.model("linear-axis").compare(given)


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (
            lambda: rs.from_arrays({"y": SPEED}, units={"z": "V"}, sample_time=1.0),
            "there is no channel 'z'; there are y",
        ),
        (
            lambda: rs.from_pandas(pandas.DataFrame({"y": ["a", "b"]}, index=[0.0, 1.0])),
            "column 'y': does not hold numbers",
        ),
        (
            lambda: rs.from_pandas(pandas.DataFrame({"y": SPEED}), units={"z": "V"}),
            "there is no channel 'z'",
        ),
    ],
)
def test_bad_tables_are_refused(build, says):
    with pytest.raises(rs.BadRecord, match=says):
        build()


def test_parts_of_a_record_keep_their_faces():
    record = rs.from_arrays({"speed": SPEED, "u": np.ones(50)}, sample_time=0.02)
    part = record.window(10, 20).select(["speed"])
    assert isinstance(part, rs.Record) and "10 samples" in str(part)
    assert len(repr(record)) < 200
    figure = record.plot()
    np.testing.assert_allclose(figure.data[0].y, SPEED)
    assert "<svg" in record._repr_html_() and "<td>speed</td>" in record._repr_html_()


def test_a_record_written_and_read_is_the_same(tmp_path):
    record = rs.from_arrays({"speed": SPEED}, units={"speed": "rad/s"}, sample_time=0.02)
    record.save(tmp_path / "a.npz")
    np.testing.assert_array_equal(rs.read(tmp_path / "a.npz")["speed"], SPEED)


def test_a_table_handed_to_read_is_refused_with_the_way_out():
    with pytest.raises(rs.BadRecord, match=r"make a record of it with rs\.from_pandas"):
        rs.read(pandas.DataFrame({"y": [1.0, 2.0]}))


def test_an_output_that_is_mapped_to_no_column_is_refused():
    record = rs.simulate("linear-axis", duration=2.0, seed=1)
    with pytest.raises(
        rs.BadRecord,
        match="output 'position' is mapped to 'nothing', which is not there; the columns are",
    ):
        rs.model("linear-axis").compare(record, map={"position": "nothing"})


@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_arrays_take_the_times_at_which_they_were_sampled(start):
    t = start + np.arange(50) * 0.02
    record = rs.from_arrays({"speed": SPEED}, units={"speed": "rad/s"}, time=t)
    assert (
        record.sample_time == pytest.approx(0.02, rel=1e-6)
        and record.t0 == start
        and record.units["speed"] == "rad/s"
    )
    np.testing.assert_array_equal(record["speed"], SPEED)
    stamps = np.datetime64("2026-05-01T12:00") + np.arange(50) * np.timedelta64(20, "ms")
    assert rs.from_arrays({"speed": SPEED}, time=stamps).sample_time == pytest.approx(0.02)


def test_uneven_times_of_arrays_are_refused_with_index_and_step_and_taken_when_resampled():
    t = np.delete(np.arange(51) * 0.02, 20)
    with pytest.raises(
        rs.BadRecord, match=r"arrays, row 20: time step 0\.04 s differs from 0\.02 s .*resample"
    ):
        rs.from_arrays({"speed": SPEED}, time=t)
    record = rs.from_arrays({"speed": SPEED}, time=t, resample=True)
    assert record.n == 51 and np.isnan(record["speed"][20]) and record["speed"][21] == SPEED[20]


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({}, r"has no time; say sample_time=.* or time=t"),
        ({"time": np.arange(49) * 0.1}, r"channel 'speed': has shape \(50,\), time has \(49,\)"),
        ({"time": np.arange(50)[::-1] * 0.1}, "row 1: time does not increase"),
        (
            {"time": np.arange(50) * 0.1, "sample_time": 0.2},
            "has sample time 0.1 s, but 0.2 s was given",
        ),
        ({"time": np.arange(50) * 0.1, "t0": 3.0}, "t0: the times begin at 0 s; leave it out"),
    ],
)
def test_times_of_arrays_that_say_nothing_or_contradict_are_refused(more, says):
    with pytest.raises(rs.BadRecord, match=says):
        rs.from_arrays({"speed": SPEED}, **more)
