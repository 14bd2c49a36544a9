"""CSV records: round trip, missing cells, and every refusal names its place."""

import numpy as np
import pytest

from residuum.identification.errors import BadRecord, BadUnit
from residuum.identification.record import Record
from residuum.identification.record_formats import ReadOptions, parse_csv, read_record, write_record


def parse(text, **options):
    return parse_csv(text.encode(), "x.csv", ReadOptions(**options))


@pytest.mark.parametrize("ending", [".csv", ".npz"])
def test_round_trip(tmp_path, ending):
    rng = np.random.default_rng(1)
    record = Record(
        {
            "u": rng.normal(size=500),
            "y": np.where(rng.random(500) < 0.1, np.nan, rng.normal(size=500)),
        },
        {"u": "V", "y": "rad/s"},
        1 / 12800,
        t0=3.25,
        notes=("split: 0.7",),
    )
    write_record(record, tmp_path / f"r{ending}")
    back = read_record(tmp_path / f"r{ending}")
    assert back.sample_time == pytest.approx(record.sample_time, rel=1e-6)
    assert back.t0 == record.t0 and dict(back.units) == dict(record.units) and back.split == 0.7
    np.testing.assert_allclose(back["y"], record["y"], rtol=1e-9)


def test_empty_cells_are_missing():
    record = parse("# bench 3\ntime [s],a [V],b\n0,,1\n0.1,2,\n0.2,nan,3\n")
    assert record.missing("a").tolist() == [True, False, True]
    assert record.missing("b").tolist() == [False, True, False]
    assert record.notes == ("bench 3",)


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("", "is empty"),
        ("time [s],a [V]\n0,1\n", "at least 2"),
        ("time [s],a [V]\n0,1\n0.1,oops\n", r"row 3, column 2: 'oops' is not a number"),
        ("time [s],a [V]\n0,1\n0.1,2,3\n", r"row 3: 3 cells; the header has 2"),
        ("time [s],a [V]\n0,1\n0.1,inf\n0.2,1\n", r"row 3, column 'a': infinite"),
        ("t [s],a [V]\n0,1\n0.1,2\n", "must be 'time"),
        ("time [ms],a [V]\n0,1\n0.1,2\n", r"must be in \[s\]"),
        ("time [s],a [V],a [V]\n0,1,1\n1,2,2\n", "stands twice"),
        ("time [s],a [V]\n0,1\n1,2\n2,3\n3.5,4\n", "row 5: time step"),
        (
            "time [s],a [V]\n0,1\n0,2\n2,3\n",
            "row 3: time does not increase, 0 s stands twice; write times with more digits, or say duplicates='spread'",
        ),
        (
            "time [s],a [V]\n0,1\n2,2\n1,3\n",
            "row 4: time does not increase; rows must be in order of time",
        ),
        ("time [s]" + ",a" * 1_000_000 + "\n0,1\n", "header of"),
        ("time [s]," + ",".join(f"a{i}" for i in range(2000)) + "\n", "at most 1000"),
    ],
)
def test_bad_files_are_refused_with_their_place(text, rule):
    with pytest.raises(BadRecord, match=rule):
        parse(text)


def test_what_is_no_unit_is_refused():
    with pytest.raises(BadUnit, match=r"channel 'a': unit .* not a known unit"):
        parse("time [s],a [m//s(]\n0,1\n1,2\n")


def test_a_unit_that_cannot_be_read_is_said_in_another_spelling(tmp_path):
    (tmp_path / "r.csv").write_text("time [s],a [m^^2]\n0,1\n1,2\n")
    with pytest.raises(
        BadUnit,
        match=r"r\.csv', channel 'a': unit 'm\^\^2': not a known unit.*; say units={'a': 'UNIT'}",
    ):
        read_record(tmp_path / "r.csv")
    assert read_record(tmp_path / "r.csv", ReadOptions(units={"a": "m**2"})).units["a"] == "m**2"


def test_a_unit_that_nobody_knows_is_one_of_its_own():
    record = parse("time [s],a [ticks/s]\n0,1\n1,2\n")
    assert record.units["a"] == "ticks/s"
    np.testing.assert_allclose(record.in_unit("a", "ticks/min"), [60.0, 120.0])
    with pytest.raises(BadUnit, match="cannot be converted"):
        record.in_unit("a", "rad/s")


def test_uneven_time_is_accepted_on_request():
    record = parse("time [s],a [V]\n0,0\n1,1\n2,2\n3.5,3.5\n4,4\n", resample=True)
    assert record.sample_time == 1.0
    np.testing.assert_allclose(record["a"], [0, 1, 2, 3, 4])
