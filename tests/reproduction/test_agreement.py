"""The reproduction can say no: what agreed and no longer does is named, and what holds by construction is not counted."""

from dataclasses import replace

import pytest

from reproduction import uncertainty
from reproduction.agreement import lost, recorded, with_parts
from reproduction.item import Item
from reproduction.report import write_report

GOOD = Item("Fig. 1", "title", "source", "says", True)


def test_an_item_that_no_longer_agrees_or_is_gone_is_lost():
    before = {"part": ["Fig. 1", "Fig. 2"], "other": ["Fig. 9"]}
    assert lost(before, {"part": [GOOD, replace(GOOD, where="Fig. 2")]}) == []
    assert lost(before, {"part": [replace(GOOD, agrees=False)]}) == [("part", "Fig. 1"), ("part", "Fig. 2")]
    assert with_parts(before, {"part": [GOOD]}) == {"part": ["Fig. 1"], "other": ["Fig. 9"]}


def test_what_holds_by_construction_is_shown_and_not_counted(tmp_path):
    items = [GOOD, replace(GOOD, agrees=False), replace(GOOD, by_construction=True)]
    write_report(items, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "1 of 2 items agree" in page and "1 more hold by construction" in page
    assert replace(GOOD, agrees=False, by_construction=True).word == "differs"


@pytest.fixture(scope="module")
def models():
    return uncertainty.identified(uncertainty.benchmark_record())


def test_a_weight_made_too_small_turns_the_report_red(models):
    right = uncertainty.weights(models)
    assert lost(recorded(), {"uncertainty": [uncertainty._responses(models), uncertainty._weights(models, right)]}) == []
    small = {name: replace(made, weight=replace(made.weight, num=0.3 * made.weight.num)) for name, made in right.items()}
    found = {"uncertainty": [uncertainty._responses(models), uncertainty._weights(models, small)]}
    assert lost(recorded(), found) == [("uncertainty", "Fig. 44–45")]


def test_a_model_with_a_wrong_gain_turns_the_report_red(models):
    kernel = models["kernel"]
    wrong = models | {"kernel": replace(kernel, impulse_response=0.8 * kernel.impulse_response)}
    assert lost(recorded(), {"uncertainty": [uncertainty._responses(wrong)]})[0] == ("uncertainty", "Fig. 43")
