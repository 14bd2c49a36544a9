"""The simulators of the source's benches: what is printed of them they have, and each difference says what it comes from."""

from dataclasses import replace

from reproduction.check import Check
from reproduction.item import Item
from reproduction.rig import CONSTANTS, FILE, Constant, table

AGREED = Check("speed", "4100 rpm", "4091 rpm", True)


def test_every_printed_constant_is_the_simulators_own_or_says_why_not():
    assert [one.name for one in CONSTANTS if one.differs and not one.cause] == []
    assert {one.name for one in CONSTANTS if not one.differs} >= {
        "R",
        "K = k_t = k_e",
        "J_M",
        "m",
        "rounds an hour",
    }


def test_a_constant_that_drifts_away_or_a_check_that_does_not_hold_gets_a_line():
    drifted = Constant("7.5.1", "R", 0.7473, 0.8, "Ω", "warm")
    lost = replace(AGREED, name="delay", ours="0 ms", holds=False)
    page = table(
        [Item("Fig. 85", "Axial speed", "", [AGREED, lost], "no delay was set")],
        [drifted, replace(drifted, simulated=0.7473)],
    )
    lines = [line for line in page.splitlines() if line.startswith("| ")][1:]
    assert lines == [
        "| 7.5.1 | R | 0.7473 Ω | 0.8 Ω | warm |",
        "| Fig. 85 | delay | 4100 rpm | 0 ms | no delay was set |",
    ]
    assert (
        "Of 2 printed constants of the two benches 1 are" in page
        and "chapters 6 and 7 1 agree" in page
    )


def test_the_page_names_every_constant_that_differs_and_leaves_no_cause_open():
    lines = [
        line for line in FILE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")
    ][1:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert all(len(row) == 5 and row[4] for row in cells)
    assert {one.name for one in CONSTANTS if one.differs} <= {row[1] for row in cells}
