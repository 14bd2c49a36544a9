"""DataFrames as notebooks have them: read as what they say, or refused with what a DataFrame has for it."""

import datetime as dt

import numpy as np
import pandas
import pytest
import xarray

import residuum as rs

N = 400
STEP = 0.01
SPEED = np.sin(np.arange(N) * 0.05)


def frame(index=None, **columns):
    return pandas.DataFrame(columns or {"speed": SPEED}, index=index)


def instants(start="2024-03-31 00:30", **how):
    return pandas.date_range(start, periods=N, freq="10ms", **how)


@pytest.mark.parametrize(
    "index",
    [
        instants(),
        instants(tz="UTC"),
        instants("2024-03-31 01:59:58", tz="Europe/Berlin"),  # over the change to summer time
        instants("2024-10-27 00:59:58", tz="UTC").tz_convert("Europe/Berlin"),  # and back
        pandas.to_timedelta(np.arange(N) * STEP, unit="s"),
        pandas.Index(np.arange(N) * STEP),
        pandas.Index(np.arange(N) * 10, name="t [ms]"),
        pandas.Index(
            [dt.datetime(2024, 1, 1) + dt.timedelta(milliseconds=10 * k) for k in range(N)],
            dtype=object,
        ),
    ],
)
def test_an_index_that_says_times_is_the_time(index):
    record = rs.from_pandas(frame(index))
    assert (
        record.sample_time == pytest.approx(STEP)
        and record.n == N
        and not record.missing("speed").any()
    )


@pytest.mark.parametrize(
    ("index", "says"),
    [
        (
            None,
            r"the index counts \(0, 1, …\).*not taken for seconds; say time='COLUMN', sample_time=",
        ),
        (
            pandas.Index(np.arange(N) * 10 + 1_700_000_000_000),
            r"not taken for seconds.*pandas\.to_datetime",
        ),
        (
            pandas.Index(np.arange(N) * 10.0 + 1.7e12),
            r"too large for seconds; make instants.*pandas\.to_datetime",
        ),
        (
            instants().astype(str),
            r"does not hold numbers or instants \('2024-.*pandas\.to_datetime",
        ),
        (pandas.Index(list("abcd") * 100), "does not hold numbers or instants"),
        (
            pandas.Index([dt.date(2024, 1, 1)] * N, dtype=object),
            "does not hold numbers or instants",
        ),
        (
            pandas.MultiIndex.from_product([["m1"], instants()]),
            r"2 levels; take one series, frame\.xs",
        ),
        (instants()[::-1], r"row 1: time does not increase; .*frame\.sort_index\(\)"),
        (
            instants()[[*range(100), 99, *range(101, N)]],
            r"row 100: .*stands twice: .*frame\.index\.duplicated\(\)",
        ),
    ],
)
def test_an_index_that_may_be_no_time_is_refused_with_the_way_on(index, says):
    with pytest.raises(rs.BadRecord, match=says) as refused:
        rs.from_pandas(frame(index))
    assert "\n" not in str(refused.value)


def test_a_table_as_read_from_a_file_is_not_counted_in_seconds():
    table = pandas.DataFrame({"time [s]": np.arange(N) * STEP, "speed": SPEED})
    with pytest.raises(rs.BadRecord, match=r"say time='time \[s\]'"):
        rs.from_pandas(table)
    assert rs.from_pandas(table, time="time [s]").sample_time == pytest.approx(STEP)
    milli = table.assign(**{"t (ms)": 10 * np.arange(N)}).drop(columns="time [s]")
    assert rs.from_pandas(milli, time="t (ms)").sample_time == pytest.approx(STEP)
    with pytest.raises(
        rs.BadRecord, match=r"no column 'when' for the time; there are time \[s\], speed"
    ):
        rs.from_pandas(table, time="when")


def test_a_told_step_that_contradicts_the_index_is_refused():
    with pytest.raises(rs.BadRecord, match=r"has sample time 0\.01 s, but 0\.02 s was given"):
        rs.from_pandas(frame(instants()), sample_time=0.02)


def test_a_hole_stays_missing_and_is_told():
    index = instants().to_series().to_numpy().copy()
    index[200:] += np.timedelta64(5, "s")
    record = rs.from_pandas(frame(pandas.DatetimeIndex(index)), resample=True)
    assert record.n == N + 500 and record.missing("speed").sum() == 500
    assert record.notes == (
        "speed resampled to 0.01 s: error about 0, each sample kept at its instant, 500 samples left missing",
    )


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        (
            {"y": SPEED, "status": ["ok"] * N},
            r"column 'status': does not hold numbers; .*frame\.drop",
        ),
        (
            {"y": SPEED, "at": instants()},
            r"column 'at': holds instants, not numbers; take the time from it with time=",
        ),
        ({"y": SPEED + 1j}, "column 'y': holds complex numbers"),
        ({"y [V]": SPEED, "y (A)": SPEED}, "columns share the name 'y'"),
    ],
)
def test_a_column_that_holds_no_numbers_is_refused_with_the_way_on(columns, says):
    with pytest.raises(rs.BadRecord, match=says):
        rs.from_pandas(pandas.DataFrame(columns, index=np.arange(N) * STEP))


def test_missing_values_of_every_kind_stay_missing():
    at = np.arange(N) % 7 == 3
    objects = pandas.Series(SPEED, dtype=object).where(~at, None)
    nullable = pandas.Series(SPEED, dtype="Float64").mask(at)
    table = pandas.DataFrame(
        {"a": objects, "b": nullable, "c": np.where(at, np.nan, SPEED)}
    ).set_index(np.arange(N) * STEP)
    record = rs.from_pandas(table)
    for name in record.names:
        np.testing.assert_array_equal(record.missing(name), at)


def test_heads_in_two_rows_give_names_and_units():
    table = pandas.DataFrame(
        {("speed", "rad/s"): SPEED, ("u", "V"): SPEED}, index=np.arange(N) * STEP
    )
    assert dict(rs.from_pandas(table).units) == {"speed": "rad/s", "u": "V"}
    table.columns = pandas.MultiIndex.from_tuples([("motor", "speed"), ("load", "u")])
    assert rs.from_pandas(table).names == ("motor.speed", "load.u")


def test_columns_may_be_numbered_have_units_in_parentheses_or_be_one_series():
    table = pandas.DataFrame({0: SPEED, 1: SPEED}, index=np.arange(N) * STEP)
    assert dict(rs.from_pandas(table, units={0: "V"}).units) == {"0": "V", "1": ""}
    named = table.set_axis(["u (V)", "speed (left)"], axis=1)
    assert dict(rs.from_pandas(named).units) == {"u": "V", "speed (left)": ""}
    assert rs.from_pandas(named["u (V)"]).units["u"] == "V"


def test_columns_of_one_name_a_nameless_series_and_no_table_are_refused():
    table = frame(np.arange(N) * STEP)
    with pytest.raises(rs.BadRecord, match=r"'speed' stands twice; .*frame\.columns\.duplicated"):
        rs.from_pandas(pandas.concat([table, table], axis=1))
    with pytest.raises(rs.BadRecord, match=r"Series without a name; .*series\.rename"):
        rs.from_pandas(pandas.Series(SPEED))
    with pytest.raises(rs.BadRecord, match="is list; must be a DataFrame"):
        rs.from_pandas([1.0, 2.0])


def test_the_coordinate_of_a_dataset_is_no_count_of_rows():
    values = ("time", SPEED)
    with pytest.raises(rs.BadRecord, match="not taken for seconds"):
        rs.from_xarray(xarray.Dataset({"speed": values}, coords={"time": np.arange(N)}))
    told = xarray.Dataset(
        {"speed": values}, coords={"time": ("time", 10 * np.arange(N), {"units": "ms"})}
    )
    assert rs.from_xarray(told).sample_time == pytest.approx(STEP)


@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Berlin"])
def test_a_column_of_instants_is_the_time_in_any_zone(zone):
    record = rs.from_pandas(frame(at=instants(tz="UTC").tz_convert(zone), speed=SPEED), time="at")
    assert list(record.names) == ["speed"]
    assert record.sample_time == pytest.approx(STEP) and record.n == N
