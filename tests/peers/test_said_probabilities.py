"""Statements of a campaign are told from what was hidden, and drawn where they lie."""

from benchmarks.said_probabilities import NAMED, NONE, UNKNOWN, lines_of, statements, told
from residuum.service.results.report_page import reliability_svg

OUTCOME = {
    "verdict": "missing-effect",
    "first": "brush-drop",
    "group": ["brush-drop", "coulomb-friction"],
    "probability": 0.9,
    "unknown": 0.06,
    "none": 0.04,
    "chi_square": 300.0,
}


def true_of(hidden, **changed):
    return {s.what: s.true for s in statements(hidden, OUTCOME | changed)}


def test_a_statement_is_true_where_it_agrees_with_what_was_hidden():
    assert true_of(["coulomb-friction"]) == {NAMED: True, UNKNOWN: False, NONE: False}
    assert true_of(["inductance"]) == {NAMED: False, UNKNOWN: False, NONE: False}
    assert true_of(["inductance"], chi_square=0.3) == {NAMED: False, UNKNOWN: False, NONE: True}
    assert true_of(["x-speed-resonance"], chi_square=None) == {
        NAMED: False,
        UNKNOWN: True,
        NONE: False,
    }
    assert true_of([], first=None, chi_square=None) == {UNKNOWN: False, NONE: True}


def test_the_tables_and_the_picture_tell_every_statement():
    made = [
        *statements(["coulomb-friction"], OUTCOME),
        *statements(["inductance"], OUTCOME | {"probability": 0.35}),
    ]
    text = told(made)
    assert "| 0.3–0.4 | 1 | 0.350 | 0.000 |" in text and "| 0.9–1.0 | 1 | 0.900 | 1.000 |" in text
    assert "Verdicts that name an effect: 2, wrong 1, with a mean probability of 0.35" in text
    picture = reliability_svg(
        {NAMED: lines_of([s for s in made if s.what == NAMED])}, [(0.5, False)]
    )
    assert picture.count("<title>") == 2 and "said 0.35, true 0.00 of 1" in picture
