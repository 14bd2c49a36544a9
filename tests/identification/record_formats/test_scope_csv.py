"""Oscilloscopes' files that say start and step in their head, or have their head beside the samples."""

import numpy as np
import pytest

from residuum.identification.errors import BadRecord
from residuum.identification.record_formats import read_record

N = 100
VALUES = np.round(np.sin(0.2 * np.arange(N)), 6)


def counted(increment="2.000000e-06", first=22):
    rows = [f"{first + k},{value:.6e},{-value:.6e}," for k, value in enumerate(VALUES)]
    return (
        "\n".join(
            ["X,CH1,CH2,Start,Increment,", f"Sequence,Volt,Volt,-1.400000e-03,{increment},", *rows]
        )
        + "\n"
    )


def beside(unit="V"):
    keys = [
        "Record Length,1e+02,Points",
        "Sample Interval,2e-05,s",
        "Vertical Units,V,",
        f"Horizontal Units,{unit.lower()},",
    ]
    keys = [*keys, "Source,CH1,"] + [",,"] * N
    return "\n".join(
        f"{key},{-0.002 + k * 2e-5:.9f},   {value:.5f}"
        for k, (key, value) in enumerate(zip(keys, VALUES, strict=False))
    )


def test_a_column_that_counts_samples_is_timed_by_start_and_increment(tmp_path):
    (tmp_path / "r.csv").write_text(counted())
    record = read_record(tmp_path / "r.csv")
    assert (
        record.n == N
        and record.sample_time == pytest.approx(2e-6)
        and dict(record.units) == {"CH1": "V", "CH2": "V"}
    )
    assert record.t0 == pytest.approx(-1.4e-3 + 22 * 2e-6)
    (tmp_path / "wide.csv").write_text(counted(), encoding="utf-16")
    assert read_record(tmp_path / "wide.csv").sample_time == pytest.approx(2e-6)
    np.testing.assert_allclose(record["CH2"], -VALUES)


def test_a_head_beside_the_samples_gives_name_and_units(tmp_path):
    (tmp_path / "r.csv").write_text(beside("s"))
    record = read_record(tmp_path / "r.csv")
    assert (
        record.n == N
        and record.sample_time == pytest.approx(2e-5)
        and record.t0 == pytest.approx(-0.002)
    )
    assert dict(record.units) == {"CH1": "V"}
    np.testing.assert_allclose(record["CH1"], VALUES, atol=1e-5)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (counted("0"), "row 2: increment 0 s; must be positive"),
        (counted().replace("24,", "24x,", 1), "row 5, column 1: '24x' is not a number"),
        (beside("div"), "its times are in 'div'; seconds are read"),
        ("X,CH1,Start,Increment\n", "row 2: holds no start and increment"),
    ],
)
def test_what_such_a_file_lacks_is_refused(tmp_path, content, says):
    (tmp_path / "r.csv").write_text(content)
    with pytest.raises(BadRecord, match=says):
        read_record(tmp_path / "r.csv")
