"""Stamps as loggers write them: read as what they are, or asked for; and numbers that mean no value."""

from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np
import pytest

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats import ReadOptions, read_record, write_record
from residuum.identification.record_formats.loggers.logger_file import understand
from residuum.identification.record_formats.loggers.logger_mapping import parse_logger
from residuum.identification.record_formats.loggers.no_value import without_overloads

N = 300
BASE = datetime(2024, 3, 11, 9, 58, 30)
VALUES = np.round(500 + 100 * np.sin(0.05 * np.arange(N)), 3)


def text(stamps, head="Time,p [bar]"):
    return (
        "\n".join(
            [head, *(f"{stamp},{value:.3f}" for stamp, value in zip(stamps, VALUES, strict=False))]
        ).encode()
        + b"\n"
    )


def read(content, duplicates="", **said):
    found = understand(content, "log.csv", **said)
    mapping = (
        found.mapping
        if not duplicates
        else type(found.mapping)(**{**vars(found.mapping), "duplicates": duplicates})
    )
    return found, parse_logger(content, "log.csv", mapping)


@pytest.mark.parametrize(
    "form", ["%d-%b-%Y %H:%M:%S", "%d %B %Y %H:%M:%S", "%b %d %Y %H:%M:%S", "%d. %B %Y %H:%M:%S"]
)
def test_months_by_name(form):
    _, record = read(text([f"{BASE + timedelta(seconds=k):{form}}" for k in range(N)]))
    assert record.n == N and record.sample_time == pytest.approx(1.0)
    assert record.t0 == pytest.approx(1710151110.0)


def test_days_of_matlab():
    _, record = read(
        text([f"{739322.4 + k / 86400:.10f}" for k in range(N)], head="datenum,p [bar]")
    )
    assert record.sample_time == pytest.approx(1.0, rel=1e-4)
    assert record.t0 == pytest.approx((739322.4 - 719529) * 86400)


def test_two_numbers_and_a_colon_are_asked_for():
    watch = text([f"{k // 60:02d}:{k % 60:02d}" for k in range(N)])
    with pytest.raises(
        BadRecord, match="may be hours:minutes or minutes:seconds; say time='hh:mm' or time='mm:ss'"
    ):
        read(watch)
    assert read(watch, time_form="mm:ss")[1].sample_time == 1.0
    assert read(watch, time_form="hh:mm")[1].sample_time == 60.0


def test_minutes_that_no_day_has_and_decimals_of_seconds_tell_a_stopwatch():
    long = text([f"{(1380 + k) // 60:02d}:{k % 60:02d}" for k in range(N)])
    assert read(long)[1].sample_time == 1.0
    parts = text([f"{k // 600:02d}:{k // 10 % 60:02d}.{k % 10}" for k in range(N)])
    assert read(parts)[1].sample_time == pytest.approx(0.1)


def test_a_clock_goes_on_after_midnight():
    begin = datetime(2024, 1, 1, 23, 58)
    found, record = read(text([f"{begin + timedelta(seconds=k):%H:%M:%S}" for k in range(N)]))
    assert record.n == N and record.sample_time == 1.0 and not record.missing("p").any()
    assert found.guesses["midnight"][0] == "1 passed"


def test_a_clock_that_is_set_back_is_not_sorted():
    stamps = [
        f"{BASE + timedelta(seconds=k - (3600 if k > 200 else 0)):%H:%M:%S}" for k in range(N)
    ]
    with pytest.raises(BadRecord, match=r"row 203: time goes back by an hour.*cut the file there$"):
        read(text(stamps))


def test_stamps_of_whole_seconds_may_be_spread():
    stamps = [f"{BASE + timedelta(seconds=(k + 3) // 10):%Y-%m-%d %H:%M:%S}" for k in range(N)]
    with pytest.raises(BadRecord, match="stands twice; say duplicates='spread'"):
        read(text(stamps))
    record = read(text(stamps), duplicates="spread")[1]
    assert record.n == N and record.sample_time == pytest.approx(0.1)
    np.testing.assert_array_equal(record["p"], VALUES)
    with pytest.raises(
        BadRecord, match="a stamp stands 9 times, others 10 times; they cannot be spread evenly"
    ):
        read(text([*stamps[:103], *stamps[104:]]), duplicates="spread")


@pytest.mark.parametrize("rate", [12000, 13000, 16000])
def test_stamps_of_too_few_digits_may_be_spread_where_no_row_is_lost(rate):
    rows = [f"{k / rate:.4f},{value}" for k, value in enumerate(VALUES)]
    with pytest.raises(BadRecord, match="stands twice"):
        read("\n".join(["time [s],p [bar]", *rows]).encode())
    record = read("\n".join(["time [s],p [bar]", *rows]).encode(), duplicates="spread")[1]
    assert record.n == N and record.sample_time == pytest.approx(1 / rate, rel=1e-2)
    np.testing.assert_array_equal(record["p"], VALUES)
    with pytest.raises(BadRecord, match="cannot be spread evenly"):
        read(
            "\n".join(["time [s],p [bar]", *rows[:103], *rows[104:]]).encode(), duplicates="spread"
        )


def test_a_cell_that_means_no_value_is_said_by_an_option():
    content = b"Time (s),U (V)\n0,1\n1,OL\n2,3\n3,4\n"
    with pytest.raises(
        BadRecord, match=r"row 3, column 'U': 'OL' is not a number; say missing=\['OL'\]"
    ):
        read(content)
    found, record = read(content, missing=["OL"])
    assert (
        np.isnan(record["U"]).tolist() == [False, True, False, False]
        and "ol" in found.mapping.missing
    )


@pytest.mark.parametrize("said", ["-999.9", "-999.90", "-9.999e2"])
@pytest.mark.parametrize("head", ["time [s],T [°C]", "Zeit [s],T [°C]"])
def test_a_number_that_means_no_value_may_be_written_otherwise(tmp_path, head, said):
    (tmp_path / "r.csv").write_text(
        f"{head}\n" + "".join(f"{k},{-999.9 if k == 3 else 20 + k % 4:.2f}\n" for k in range(40))
    )
    assert "missing -999.9" in read_record(tmp_path / "r.csv").notes[-1]
    record = read_record(tmp_path / "r.csv", ReadOptions(missing=[said]))
    assert np.flatnonzero(np.isnan(record["T"])).tolist() == [3]
    assert record.notes[-1].startswith("read as a logger's file")


@pytest.mark.parametrize("ending", [".npz", ".mat", ".parquet"])
def test_a_number_that_means_no_value_may_be_said_of_any_format(tmp_path, ending):
    signal = np.where(np.arange(50) == 7, -999.9, np.sin(np.arange(50)))
    write_record(Record({"T": signal}, {"T": "°C"}, 1.0), tmp_path / f"r{ending}")
    record = read_record(tmp_path / f"r{ending}", ReadOptions(missing=["OL", "-999.90"]))
    assert np.flatnonzero(np.isnan(record["T"])).tolist() == [7]
    assert record.notes == ("no value: T: 1 samples of -999.9, as was said",)


def test_a_mark_is_named_with_all_its_digits():
    signal = np.where(np.arange(50) == 7, 2147483647.0, np.sin(np.arange(50)))
    record = without_overloads(Record({"n": signal}, {"n": "rpm"}, 1.0))
    assert "missing 2147483647" in record.notes[0]


def test_what_is_said_of_a_file_of_ours_is_not_ignored(tmp_path):
    (tmp_path / "r.csv").write_text(
        "time [s],clock [ms],u [V]\n" + "".join(f"{k},{k * 20},1\n" for k in range(9))
    )
    record = read_record(tmp_path / "r.csv", ReadOptions(time_column="clock"))
    assert record.sample_time == pytest.approx(0.02)


@pytest.mark.parametrize("head", ["time [s],U [V]", "Time (s),U (V)"])
def test_an_overload_is_missing_and_told_in_every_text_file(tmp_path, head):
    rows = [f"{k},{9.99999999e37 if k in (5, 6) else np.sin(k):.9g}" for k in range(40)]
    (tmp_path / "r.csv").write_text("\n".join([head, *rows]) + "\n")
    record = read_record(tmp_path / "r.csv")
    assert np.flatnonzero(record.missing("U")).tolist() == [5, 6]
    assert any("2 samples of 9.99999999e+37 are an overload" in note for note in record.notes)


@pytest.mark.parametrize("mark", [-999.9, -9999.0, 32767.0])
def test_a_number_that_may_mean_no_value_is_told(mark):
    values = np.where(np.arange(50) == 7, mark, 20 + np.sin(np.arange(50)))
    record = without_overloads(Record({"T": values}, {"T": "°C"}, 1.0))
    assert not record.missing("T").any()
    assert (
        f"1 samples of {mark:g}, far from all others" in record.notes[0]
        and f"missing {mark:g}" in record.notes[0]
    )


def test_numbers_in_their_place_are_not_remarked():
    record = Record(
        {"n": np.arange(990.0, 1000.0), "m": np.linspace(-999.0, 999.0, 10)},
        {"n": "", "m": ""},
        1.0,
    )
    assert without_overloads(record) is record


@pytest.mark.parametrize("blank", ["\u00a0", "\u202f", "'"])
def test_blanks_between_thousands_cut_no_cells(blank):
    rows = "\n".join(f"11.03.2024 08:00:{k:02d};20,{k:02d};1{blank}{500 + k},5" for k in range(40))
    _, record = read(f"Zeit;T [°C];P [W]\n{rows}\n".encode())
    np.testing.assert_allclose(record["P"], 1500.5 + np.arange(40))
    assert dict(record.units) == {"T": "°C", "P": "W"} and record.sample_time == 1.0


def test_names_that_stand_twice_are_told_apart_by_the_line_above():
    rows = "\n".join(f"{k * 2e-9:.9f},{k % 3},{k % 5}" for k in range(40))
    content = f'"Channel","CH 1","CH 2"\n"Scale = ",0.1,2\n"Time (s)","Voltage (V)","Voltage (V)"\n{rows}\n'.encode()
    assert dict(read(content)[1].units) == {"CH 1 Voltage": "V", "CH 2 Voltage": "V"}
    with pytest.raises(BadRecord, match="stands twice"):
        read(content.replace(b"CH 2", b"CH 1"))


def test_an_axis_without_a_unit_is_the_time_only_where_its_form_is_said():
    content = (
        "X,CH1 (V)\n" + "\n".join(f"{k * 1e-5:.5f},{k % 3}" for k in range(40)) + "\n"
    ).encode()
    with pytest.raises(BadRecord, match=r"no time column found among X, CH1; .*time='seconds'"):
        read(content)
    assert read(content, time_form="seconds")[1].sample_time == pytest.approx(1e-5)
    source = (
        "Source,CH1\nSecond,Volt\n" + "\n".join(f"{k * 1e-5:.5f},{k % 3}" for k in range(40)) + "\n"
    ).encode()
    assert dict(read(source)[1].units) == {"CH1": "V"}


def test_a_unit_behind_every_number_is_the_unit_of_the_column():
    rows = [f"11.03.2024 08:00:{k:02d};20,{k:02d} °C;{1500 + k},0 W" for k in range(40)]
    content = "\n".join(["Zeit;T;P", *rows]).encode()
    found, record = read(content)
    assert dict(record.units) == {"T": "°C", "P": "W"} and found.guesses["unit of 'P'"][0] == "W"
    np.testing.assert_allclose(record["P"], 1500.0 + np.arange(40))
    assert found.mapping.suffixes == {2: "°C", 3: "W"}
    with pytest.raises(BadRecord, match=r"row 22, column 'P': '1520,0 kW' is not a number"):
        read(content.replace(b"1520,0 W", b"1520,0 kW"))


def test_milliseconds_behind_a_colon_are_a_number():
    stamps = [f"09:58:{30 + k // 20:02d}:{50 * (k % 20)}" for k in range(N)]
    assert read(text(stamps))[1].sample_time == pytest.approx(0.05)


def test_times_with_too_few_digits_are_refused_with_the_way_on():
    with pytest.raises(
        BadRecord,
        match=r"all rows have one time stamp, '1\.71015E\+09'; export the times with more digits",
    ):
        read(text([f"{1710151110 + k:.5E}" for k in range(N)], head="time,p [bar]"))


@pytest.mark.parametrize("head", ["Time (s),p [bar]", "time,p [bar]"])
@pytest.mark.parametrize("step", [0.1, 1.0])
def test_seconds_since_1904_are_told_from_those_since_1970(head, step):
    """LabVIEW counts from 1904-01-01 UTC; the number of such a day lies 2 082 844 800 s above that since 1970."""
    found, record = read(
        text([f"{1710151110 + 2082844800 + k * step:.3f}" for k in range(N)], head=head)
    )
    assert "2024-03-11 09:58 as seconds since 1904" in str(found.guesses)
    assert record.t0 == pytest.approx(1710151110.0) and record.sample_time == pytest.approx(step)


def test_the_step_of_rounded_stamps_is_that_of_all_of_them():
    """Hours to six decimals are 3.6 ms apart: the middle of single steps would be 0.08 % off."""
    found, record = read(text([f"{k / 3600:.6f}" for k in range(N)], head="t [h],p [bar]"))
    assert found.samples["even"] and found.samples[
        "sample_time"
    ] == record.sample_time == pytest.approx(1.0, rel=1e-4)


def test_what_means_no_value_is_told_where_the_file_is_understood():
    rows = [
        f"{k},{v:.3f},{t:.1f}"
        for k, (v, t) in enumerate(zip(VALUES, 20 + VALUES / 1000, strict=True))
    ]
    rows[7], rows[9] = "7,9.99999999e+37,20.5", "9,500.000,-999.9"
    samples = understand("\n".join(["time [s],U [V],T [K]", *rows]).encode(), "log.csv").samples
    assert samples["missing"] == {"U": 1, "T": 0}
    assert [
        "U: 1 samples of 9.99999999e+37" in samples["notes"][0],
        "T: 1 samples of -999.9" in samples["notes"][1],
    ] == [True] * 2


def _logged(tmp_path, seconds, step):
    """A file of rows in the order in which they came, with these local stamps; the channel counts them."""
    begin = datetime(2024, 10, 27, 0, 0)
    rows = [f"{begin + timedelta(seconds=round(float(s), 3))!s},{k}" for k, s in enumerate(seconds)]
    file = tmp_path / "log.csv"
    file.write_text("time,count [1]\n" + "\n".join(rows) + "\n")
    return file


@pytest.mark.parametrize("seed", range(20))
def test_a_clock_that_was_set_back_is_neither_sorted_nor_merged(tmp_path, seed):
    rng = np.random.default_rng(seed)
    step = float(rng.choice([0.5, 1.0, 15.0, 60.0]))
    n, back = 400, float(rng.choice([2 * step, 7.3 * step, 30.0 * step, 3600.0]))
    at = int(rng.integers(20, n - 20))
    seconds = step * np.arange(n)
    seconds[at:] -= back
    if back > seconds[at - 1]:
        seconds += back
    file = _logged(tmp_path, seconds, step)
    with pytest.raises(
        BadRecord,
        match=rf"row {at + 2}: time goes back by .*cut the file there, or say reordered='bridge'",
    ):
        read_record(file)
    found = understand(file.read_bytes(), str(file))
    assert found.mapping.reordered == found.mapping.duplicates == "refuse"
    assert "clock was set back" in found.guesses["reordered"][1]
    with pytest.raises(BadRecord, match="time goes back"):
        parse_logger(
            file.read_bytes(),
            "log.csv",
            replace(found.mapping, reordered="sort", duplicates="first"),
        )
    bridged = parse_logger(file.read_bytes(), "log.csv", replace(found.mapping, reordered="bridge"))
    assert bridged.sample_time == pytest.approx(step) and bridged["count"].tolist() == list(
        range(n)
    )
    assert any("clock was set 1 time" in note for note in bridged.notes)


@pytest.mark.parametrize("step", [0.01, 15.0, 60.0])
def test_the_hour_that_summer_time_takes_away_is_named_and_bridged_where_asked(tmp_path, step):
    n, at = 400, 130
    seconds = step * np.arange(n)
    seconds[at:] += 3600.0
    file = _logged(tmp_path, seconds, step)
    with pytest.raises(
        BadRecord,
        match=rf"row {at + 2}: .*as at the beginning of summer time; .*reordered='bridge'",
    ):
        read_record(file)
    mapping = understand(file.read_bytes(), str(file)).mapping
    bridged = parse_logger(file.read_bytes(), "log.csv", replace(mapping, reordered="bridge"))
    assert bridged.sample_time == pytest.approx(step) and bridged["count"].tolist() == list(
        range(n)
    )
    assert any("clock was set 1 time, first at row 132" in note for note in bridged.notes)


@pytest.mark.parametrize("seed", range(10))
def test_rows_that_are_shuffled_are_still_sorted(tmp_path, seed):
    rng = np.random.default_rng(seed)
    seconds = 60.0 * np.arange(300)
    for k in rng.choice(np.arange(5, 290, 9), 6, replace=False):
        seconds[k : k + 3] = rng.permutation(seconds[k : k + 3])
    file = _logged(tmp_path, seconds, 60.0)
    if (np.diff(seconds) < 0).any():
        assert understand(file.read_bytes(), str(file)).mapping.reordered == "sort"
    record = read_record(file)
    assert record.n == 300 and np.all(np.sort(record["count"]) == np.arange(300))


@pytest.mark.parametrize(
    ("form", "said"), [("%d.%m.%y %H:%M:%S", {}), ("%d/%m/%y %H:%M:%S", {"time_form": "day first"})]
)
def test_years_of_two_digits(form, said):
    _, record = read(text([f"{BASE + timedelta(seconds=k):{form}}" for k in range(N)]), **said)
    assert record.sample_time == pytest.approx(1.0)
    assert record.t0 == pytest.approx(1710151110.0)


def test_years_of_two_digits_that_may_be_days_are_asked_for():
    with pytest.raises(
        BadRecord, match=r"'11/03/24 09:58:30' may be day/month/year, .*say time='day first' or"
    ):
        read(text([f"{BASE + timedelta(seconds=k):%d/%m/%y %H:%M:%S}" for k in range(N)]))


def test_a_file_without_heads_is_read_by_names_that_are_said():
    bare = text([f"{0.1 * k:.1f}" for k in range(N)]).split(b"\n", 1)[1]
    with pytest.raises(BadRecord, match=r"names=\['time \[s\]', 'name2'\]"):
        read(bare)
    _, record = read(bare, heads=["time [s]", "p [bar]"])
    assert (list(record.names), record.units["p"], record.sample_time) == (
        ["p"],
        "bar",
        pytest.approx(0.1),
    )
    np.testing.assert_allclose(record["p"], VALUES)
    with pytest.raises(BadRecord, match=r"names of 3 columns: log\.csv has 2"):
        read(bare, heads=["time [s]", "p", "q"])
