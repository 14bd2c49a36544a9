"""The comparison of two trees' answers says no when an answer changed or is gone."""

import json
from pathlib import Path
from typing import Any

from benchmarks.golden import compare, differences, judged, on_purpose

CASE = "residuum effects --json"


def status(folder: Path, old: dict[str, Any], new: dict[str, Any], only: str | None = None) -> int:
    for name, answers, part in (("old", old, None), ("new", new, only)):
        (folder / name).write_text(json.dumps({"commit": name, "only": part, "answers": answers}))
    return compare(folder / "old", folder / "new", None, False)


def test_equal_answers_pass(tmp_path: Path) -> None:
    answers = {CASE: {"status": 0, "answer": {"fit": 97.0, "seconds": 1.0}}}
    other = {CASE: {"status": 0, "answer": {"fit": 97.0, "seconds": 2.0}}}
    assert status(tmp_path, answers, other) == 0


def test_a_case_that_is_not_answered_any_more_fails(tmp_path: Path) -> None:
    kept = {"residuum compare": {"status": 0}}
    assert status(tmp_path, kept | {CASE: {"status": 0}}, kept) == 1


def test_a_record_of_some_commands_is_held_against_these_alone(tmp_path: Path) -> None:
    old = {
        CASE: {"status": 0},
        "residuum compare": {"status": 0},
        "GET /api/v1/effects": {"status": 200},
    }
    assert status(tmp_path, old, {CASE: {"status": 0}}, "effects") == 0
    assert status(tmp_path, old, {}, "effects") == 1


def test_nothing_to_compare_fails(tmp_path: Path) -> None:
    assert status(tmp_path, {}, {}) == 1


def test_a_text_with_a_time_in_it_must_say_the_same_otherwise() -> None:
    said = "fit 97.2 % of the record, 12.5 s"
    assert not list(differences(said, "fit 97.2 % of the record, 13.1 s"))
    assert [kind for kind, _ in differences(said, "fit 12.0 % of the record, 13.1 s")] == ["other"]
    begun = "begun 2026-01-02T03:04:05.123Z by anna"
    assert not list(differences(begun, "begun 2027-05-06T07:08:09.456Z by anna"))
    assert [kind for kind, _ in differences(begun, "begun 2027-05-06T07:08:09.456Z by otto")] == [
        "other"
    ]


def test_a_number_of_seconds_that_is_an_answer_counts() -> None:
    assert [
        kind
        for kind, _ in differences(
            "overshoot 1 %, settling 12 s: kept", "overshoot 1 %, settling 90 s: kept"
        )
    ] == ["other"]
    assert not list(differences("kept (12 s)", "kept (13 s)"))
    assert [kind for kind, _ in differences({"falsified_at": [0.3]}, {"falsified_at": []})] == [
        "other"
    ]
    assert not list(differences({"created_at": "2026-01-01"}, {"created_at": "2026-01-02"}))


def test_true_is_not_one() -> None:
    assert [kind for kind, _ in differences({"passed": True}, {"passed": 1})] == ["other"]
    assert not list(differences({"passed": True}, {"passed": True}))


def test_what_is_gone_does_not_hide_behind_a_change_on_purpose() -> None:
    kind, places = judged({"fit": 1.0, "gain": 2.0}, {"fit": 3.0})
    assert (kind, sorted(places)) == ("other", [".fit", ".gain"])
    change = {"case": "identify", "place": r"^\.fit$", "why": "another search"}
    assert on_purpose("residuum identify", kind, [".fit"], [change]) == "another search"
    assert not on_purpose("residuum identify", kind, places, [change])
