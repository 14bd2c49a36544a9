"""What a table of registers leaves out is said when it is read, not when a model is held against it."""

from residuum.service.machines.adding import bus_description


def test_signals_without_a_unit_are_named():
    with_one = "name;register;type;unit\nspeed;40001;uint16;rpm\n"
    assert not any(
        "unit" in line for line in bus_description("table", "a.csv", with_one, 0.1, 1).remarks
    )
    table = "name;register;type;unit\nspeed;40001;uint16;rpm\nload;40002;int16;\n"
    assert any(
        line.startswith("no unit is said for load:")
        for line in bus_description("table", "a.csv", table, 0.1, 1).remarks
    )
