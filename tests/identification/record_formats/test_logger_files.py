"""Files as loggers write them: read right, or refused with the line and the remedy."""

import numpy as np
import pytest

from residuum.identification.errors import BadRecord
from residuum.identification.record_formats import ReadOptions, read_record
from residuum.identification.record_formats.loggers.logger_file import understand
from residuum.identification.record_formats.loggers.logger_mapping import (
    read_logger_file,
    read_mapping,
)

SPEED = np.array([1.5, 2.25, 3.0, 4.75])
DAY = 1704063600.0
"""2023-12-31 23:00 UTC."""


def read(folder, content, *, resample=False, **said):
    file = folder / "log.csv"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    found = understand(file.read_bytes(), "log.csv", **said)
    mapping = folder / "log.csv.mapping.yaml"
    mapping.write_text(found.mapping.to_yaml(), encoding="utf-8")
    return found, read_logger_file(file, read_mapping(mapping), ReadOptions(resample=resample))


GERMAN = (
    "Logger X\r\nNummer;42\r\n\r\nZeit;Drehzahl [rpm];Status\r\n"
    "2024-01-01T00:00:00.0+01:00;1,5;ok\r\n2024-01-01T00:00:00.1+01:00;2,25;ok\r\n"
    "2024-01-01T00:00:00.2+01:00;3;ok\r\n2024-01-01T00:00:00.3+01:00;4,75;ok\r\n"
)
FILES = {
    "semicolons, zones, header lines": (GERMAN, 0.1, DAY, "rpm"),
    "UTF-16": (GERMAN.encode("utf-16"), 0.1, DAY, "rpm"),
    "UTF-16 without a mark": (GERMAN.encode("utf-16-le"), 0.1, DAY, "rpm"),
    "UTF-32": (GERMAN.encode("utf-32"), 0.1, DAY, "rpm"),
    "byte-order mark": (GERMAN.encode("utf-8-sig"), 0.1, DAY, "rpm"),
    "tabs, milliseconds, parentheses": (
        "t (ms)\tv (m/s)\n0\t1.5\n5\t2.25\n10\t3\n15\t4.75\n",
        0.005,
        0.0,
        "m/s",
    ),
    "unit line": ("Time,v\ns,ticks\n0,1.5\n0.5,2.25\n1,3\n1.5,4.75\n", 0.5, 0.0, "ticks"),
    "epoch s": (
        "time,v [V]\n1704063600,1.5\n1704063601,2.25\n1704063602,3\n1704063603,4.75\n",
        1.0,
        DAY,
        "V",
    ),
    "epoch ms": (
        "time,v [V]\n1704063600000,1.5\n1704063600020,2.25\n1704063600040,3\n1704063600060,4.75\n",
        0.02,
        DAY,
        "V",
    ),
    "epoch ns, every digit kept": (
        "time,v [V]\n1704063600000000000,1.5\n1704063600000000100,2.25\n1704063600000000200,3\n1704063600000000300,4.75\n",
        1e-7,
        DAY,
        "V",
    ),
    "Excel dates": (
        "Date;v [V]\n45291,958333333336;1,5\n45291,958344907405;2,25\n45291,958356481482;3,0\n45291,958368055559;4,75\n",
        1.0,
        DAY,
        "V",
    ),
    "date and time in two columns, afternoon": (
        "Date,Time,v [V]\n12/31/2023,11:00:00 PM,1.5\n"
        "12/31/2023,11:00:01 PM,2.25\n12/31/2023,11:00:02 PM,3\n12/31/2023,11:00:03 PM,4.75\n",
        1.0,
        DAY,
        "V",
    ),
    "latin-1 degrees": (
        "time [s];T [°C]\n0;1,5\n1;2,25\n2;3\n3;4,75\n".encode("latin-1"),
        1.0,
        0.0,
        "°C",
    ),
    "quoted decimal commas": (
        '"time [s]","v [V]"\n"0,0","1,5"\n"0,1","2,25"\n"0,2","3,0"\n"0,3","4,75"\n',
        0.1,
        0.0,
        "V",
    ),
    "blanks": (
        "  time_s   v[mm]\n  0.0  1.5\n  0.1  2.25\n  0.2  3.0\n  0.3  4.75\n",
        0.1,
        0.0,
        "mm",
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_odd_file_is_read_right(tmp_path, name):
    content, step, start, unit = FILES[name]
    _, record = read(tmp_path, content)
    assert record.n == 4
    signal = record.names[0]
    np.testing.assert_allclose(record[signal], SPEED)
    assert record.units[signal] == unit
    assert record.sample_time == pytest.approx(step, rel=1e-5)
    assert record.t0 == pytest.approx(start, abs=1e-3)
    assert len(record.names) == 1


def test_thousands_signs_are_no_decimals(tmp_path):
    _, record = read(tmp_path, "t [s];p [Pa]\n0;1.234,5\n1;1.000,0\n2;987,25\n")
    np.testing.assert_allclose(record["p"], [1234.5, 1000.0, 987.25])


def test_holes_stay_missing_and_markers_are_known(tmp_path):
    found, record = read(tmp_path, "t [s],a [V],b [V]\n0,1,5\n1,,6\n2,3,---\n3,4,NaN\n")
    assert found.samples["missing"] == {"a": 1, "b": 2}
    assert np.isnan(record["a"]).tolist() == [False, True, False, False]


def test_reordered_and_equal_duplicate_stamps_are_told_and_mended(tmp_path):
    rows = "\n".join(f"2024-03-01 10:00:0{k},{k}" for k in (0, 2, 1, 3, 3, 4, 5))
    found, record = read(tmp_path, f"time,v [V]\n{rows}\n")
    assert found.samples["reordered"] == 1 and found.samples["duplicates"] == 1
    np.testing.assert_allclose(record["v"], [0, 1, 2, 3, 4, 5])
    assert any("sorted" in note for note in record.notes) and any(
        "twice" in note for note in record.notes
    )


def test_restart_of_the_clock_is_not_sorted(tmp_path):
    with pytest.raises(BadRecord, match="row 5: time goes back"):
        read(tmp_path, "t [s],v [V]\n0,1\n1,2\n2,3\n0,4\n1,5\n2,6\n")


def test_gap_needs_resample_which_tells_its_error_and_fills_no_gap(tmp_path):
    time = np.concatenate([np.arange(0, 5, 0.1), np.arange(8, 13, 0.1)])
    text = "t [s],v [V]\n" + "\n".join(f"{t:.1f},{np.sin(t):.9f}" for t in time)
    with pytest.raises(BadRecord, match="resample"):
        read(tmp_path, text)
    found, record = read(tmp_path, text, resample=True)
    assert found.samples["gap_count"] == 1 and found.samples["gaps"][0]["after_row"] == 51
    gone = np.isnan(record["v"])
    assert gone.sum() == 30 and gone[(record.time > 4.95) & (record.time < 7.95)].all()
    np.testing.assert_allclose(record["v"][~gone], np.sin(record.time[~gone]), atol=1e-6)
    assert any("error about" in note and "30 samples left missing" in note for note in record.notes)


def test_estimated_error_of_resampling_is_near_the_true_one(tmp_path):
    time = np.concatenate([np.arange(0, 5, 0.1), np.arange(5.05, 10, 0.1)])
    text = "t [s],v [V]\n" + "\n".join(f"{t:.2f},{np.sin(3 * t):.9f}" for t in time)
    _, record = read(tmp_path, text, resample=True)
    late = record.time > 5.1
    true = float(np.sqrt(np.mean((record["v"] - np.sin(3 * record.time))[late] ** 2)))
    told = float(record.notes[0].split("about ")[1].split()[0])
    assert true / 2 < told < 2 * true


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("t [s];v [V]\n0;1,234\n1;2,345\n", "say decimal=SIGN"),
        ("t [s];v [V]\n0;1,5\n1;2.25\n", "both decimal signs"),
        ("time;v [V]\n01/02/2024 10:00:00;1\n01/02/2024 10:00:01;2\n", "day first"),
        ("time;v [V]\n0;1\n1;2\n2;3\n", "time='excel' for dates"),
        ("a;b\n0;1\n1;2\n", "no time column"),
        ("t1 [s],time [s],a [V],time b [s],c [V]\n0,0,1,0,1\n1,1,2,1,2\n", "several time columns"),
        ("t [s];v [V]\n0;1\n1;oops\n2;3\n", "row 3, column 'v': 'oops'"),
        ("t [s];v [V]\n0;1\n1\n2;3\n3;4\n", "row 3: 1 cells"),
        ("", "empty"),
        ("just words\nand more\n", "no delimiter"),
        (b"t [s];v\x00\n0;1\n", "NUL.*save as UTF-8"),
    ],
)
def test_what_may_be_read_in_two_ways_or_none_is_refused(tmp_path, text, says):
    with pytest.raises(BadRecord, match=says) as refused:
        read(tmp_path, text)
    assert "\n" not in str(refused.value)


def test_rows_without_times_are_as_far_apart_as_is_said(tmp_path):
    content = b"y u\n" + b"".join(b"%d.5 %d\n" % (k, k % 3) for k in range(20))
    with pytest.raises(BadRecord, match="sample_time=SECONDS where none is a time"):
        understand(content, "log.txt")
    found = understand(content, "log.txt", sample_time=0.025)
    assert found.guesses["time"] == (
        "rows of 0.025 s",
        "said with sample_time; no column is a time",
    )
    (tmp_path / "log.txt").write_bytes(content)
    (tmp_path / "log.mapping.yaml").write_text(found.mapping.to_yaml(), encoding="utf-8")
    by_mapping = read_logger_file(tmp_path / "log.txt", read_mapping(tmp_path / "log.mapping.yaml"))
    for record in (by_mapping, read_record(tmp_path / "log.txt", ReadOptions(sample_time=0.025))):
        assert (record.names, record.n, record.sample_time) == (
            ("y", "u"),
            20,
            pytest.approx(0.025),
        )
        np.testing.assert_array_equal(record["y"], np.arange(20) + 0.5)


def test_a_sample_time_does_not_stand_in_for_a_time_that_the_file_has():
    with pytest.raises(
        BadRecord, match=r"time column 'time' has no unit; .*say units={'time': 's'}"
    ):
        understand(b"time;v [V]\n0;1\n1;2\n2;3\n", "log.csv", sample_time=0.1)


def test_what_is_said_settles_the_doubt(tmp_path):
    _, record = read(
        tmp_path, "time;v [V]\n0;1,234\n1;2,345\n", decimal=",", time_form="milliseconds"
    )
    np.testing.assert_allclose(record["v"], [1.234, 2.345])
    assert record.sample_time == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("width: 2", "there is no column"),
        ("decimal: x", "decimal"),
        ("colour: red", "colour"),
        ("names: [1", "not YAML"),
    ],
)
def test_bad_mapping_is_refused(tmp_path, change, says):
    lines = understand(b"t [s],a [V],b [V]\n0,1,5\n1,2,6\n", "log").mapping.to_yaml().splitlines()
    key = change.split(":")[0]
    file = tmp_path / "m.yaml"
    file.write_text(
        "\n".join([*(line for line in lines if not line.startswith(f"{key}:")), change]),
        encoding="utf-8",
    )
    with pytest.raises(BadRecord, match=says):
        read_mapping(file)


def test_a_unit_line_counts_where_most_columns_have_no_unit(tmp_path):
    rows = "\n".join(f"{k},{k}.5,{k}.25,10:00:{k:02d}" for k in range(30))
    found, record = read(tmp_path, f"p1,p2,state,Time\n(bar),,,\n{rows}\n")
    assert dict(record.units) == {"p1": "bar", "p2": "", "state": ""}
    assert found.guesses["unit line"][0] == "row 2"


def test_quoted_cells_below_a_plain_head_are_read(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("time [s],U [V]\n" + "\n".join(f'"{k}","{k}.5"' for k in range(9)) + "\n")
    np.testing.assert_array_equal(read_record(file)["U"], np.arange(9) + 0.5)


def test_the_unit_of_times_may_be_said_like_any_other(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("t;speed\n0;1\n10;2\n20;3\n")
    assert read_record(
        file, ReadOptions(units={"t": "ms", "speed": "rpm"})
    ).sample_time == pytest.approx(0.01)


@pytest.mark.parametrize("word", ["unavailable", "unknown", "Offline", "#DIV/0!", "kaputt"])
@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_a_few_words_for_no_value_make_no_delimiter(word, delimiter):
    rng = np.random.default_rng(len(word))
    rows = [delimiter.join(["time", "a [kW]", "b [degC]"])]
    gone = rng.choice(100, 7, replace=False)
    for k in range(100):
        cells = [
            f"2024-02-05 {k // 60:02d}:{k % 60:02d}:00",
            f"{rng.normal():.3f}",
            f"{rng.normal():.2f}",
        ]
        rows.append(delimiter.join([cells[0], word, word] if k in gone else cells))
    said = {"missing": [word]} if word == "kaputt" else {}
    found = understand("\n".join(rows).encode(), "hub.csv", **said)
    assert found.mapping.delimiter == delimiter
    assert set(found.samples["missing"].values()) == {7}


def test_the_long_form_is_refused_with_its_signals():
    rows = [f"sensor.{'abc'[k % 3]},{k},2024-02-05T00:{k:02d}:00Z" for k in range(30)]
    with pytest.raises(
        BadRecord,
        match=r"'entity_id' names the signal of each row \(3: sensor.a, .*long form.*pivot",
    ):
        understand("\n".join(["entity_id,state,last_changed", *rows]).encode(), "history.csv")
