"""The report can say no: what agreed and no longer does is named, and what holds by construction is not counted."""

import re
from dataclasses import replace

import pytest

from reproduction import drawings, uncertainty
from reproduction.agreement import lost, recorded, with_parts
from reproduction.check import Check, at_least, at_most, near, same, within
from reproduction.item import Item
from reproduction.parts import PARTS, run
from reproduction.report import summary, write_report
from reproduction.tolerances import TOLERANCES

GOOD = Check("gain", "1", "1", True)
ITEM = Item("Fig. 1", "title", "source", [GOOD, replace(GOOD, name="peak")])


def test_a_check_that_no_longer_agrees_or_is_gone_is_lost():
    before = {"part": {"Fig. 1": ["gain", "peak"]}, "other": {"Fig. 9": ["gain"]}}
    assert lost(before, {"part": [ITEM]}) == []
    worse = replace(ITEM, checks=[GOOD, replace(GOOD, name="peak", holds=False)])
    assert lost(before, {"part": [worse]}) == [("part", "Fig. 1", "peak")]
    assert lost(before, {"part": []}) == [("part", "Fig. 1", "gain"), ("part", "Fig. 1", "peak")]
    assert with_parts(before, {"part": [worse]})["part"] == {"Fig. 1": ["gain"]}


def test_what_holds_by_construction_is_shown_and_not_counted(tmp_path):
    constructed = replace(GOOD, by_construction=True)
    items = [
        ITEM,
        replace(ITEM, checks=[replace(GOOD, holds=False)], reason="tried"),
        replace(ITEM, checks=[constructed]),
    ]
    assert [item.word for item in items] == ["agrees", "differs", "holds by construction"]
    assert not items[2].agrees and "1 of 3 figures" in summary(items)
    write_report(items, [("part", "Fig. 1", "gain")], tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "Agreed before, and not now: part, Fig. 1, gain" in page and "Reason: tried" in page


def test_checks_say_what_they_measured():
    assert (
        near("x", 2.0, 2.1, 0.1).holds
        and not near("x", 2.0, 2.3, 0.1).holds
        and not near("x", 2.0, float("nan"), 0.1).holds
    )
    assert (
        at_most("x", 1.0, 1.0).holds
        and not at_most("x", float("nan"), 1.0).holds
        and not at_least("x", 0.9, 1.0).holds
    )
    assert (
        within("x", 0.5, 0.0, 1.0).holds
        and not within("x", float("inf"), 0.0, 1.0).holds
        and not same("x", 2, 3).holds
    )
    assert (
        "+15 %" in near("x", 2.0, 2.3, 0.1, "s").sentence
        and "2.3 s" in near("x", 2.0, 2.3, 0.1, "s").sentence
    )


def test_every_figure_and_table_of_chapters_2_to_7_is_in_the_report():
    places = [where for items in recorded(short=True).values() for where in items]
    assert set(recorded(short=True)) == set(PARTS)
    covered = {number for where in places for number in _numbers(where, "Fig.")}
    assert set(range(38, 88)) <= covered
    assert {5, 6, 7} <= {number for where in places for number in _numbers(where, "Table")}


def test_every_place_that_is_measured_says_why_its_tolerances_are_what_they_are():
    measured = {
        where
        for short in (True, False)
        for items in recorded(short).values()
        for where, names in items.items()
        if names
    }
    assert measured <= set(TOLERANCES)
    places = {where for items in recorded(short=False).values() for where in items}
    assert set(TOLERANCES) <= places | {"Section 6.3"}  # real bearings, where their recordings are


def _numbers(where, kind):
    for found in re.finditer(rf"{re.escape(kind)} (\d+)(?:–(\d+))?", where):
        yield from range(int(found[1]), int(found[2] or found[1]) + 1)
    if kind == "Fig." and (two := re.match(r"Fig\. (\d+), ", where)):
        yield int(two[1])


@pytest.mark.parametrize(
    "part", ["drawings", "sample_size", "uncertainty", "oven", "gripping_pliers", "gate_actuator"]
)
def test_the_short_report_still_agrees_where_it_did(part):
    items = run(part, short=True)
    assert lost(recorded(short=True), {part: items}) == []
    assert all(item.reason for item in items if item.differs)
    assert not any(item.word == "holds by construction" for item in items)


def test_a_weight_made_too_small_turns_the_report_red(monkeypatch):
    right = uncertainty.weights()
    small = {
        name: replace(made, weight=replace(made.weight, num=0.3 * made.weight.num))
        for name, made in right.items()
    }
    monkeypatch.setattr(uncertainty, "weights", lambda: small)
    gone = lost(recorded(short=True), {"uncertainty": uncertainty.items(short=True)})
    assert {where for _, where, _ in gone} >= {"Fig. 45"}


def test_a_loop_with_the_wrong_sign_turns_the_report_red(monkeypatch):
    original = drawings.weighted_loop
    monkeypatch.setattr(
        drawings,
        "weighted_loop",
        lambda plant, *rest: original(replace(plant, num=-plant.num), *rest),
    )
    assert lost(recorded(short=True), {"drawings": drawings.items(short=True)})[0][1] == "Fig. 40"
