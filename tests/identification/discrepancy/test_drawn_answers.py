"""Questions about drawn machines and records end in an answer that holds together, or in a refusal; more in benchmarks."""

import pytest

from benchmarks.complete_models import FAULTS, judged
from benchmarks.drawn_answers import asked, broken, drawn


@pytest.mark.parametrize("seed", (3, 4))
def test_every_question_is_answered_or_refused(seed):
    case = drawn(seed, effects=1, samples=160, parts=1)
    answers, refused = asked(case)
    assert len(answers) + len(refused) == 4
    assert list(broken(case, answers)) == []


@pytest.mark.parametrize("seed", (7019, 7042, 7059, 9028, 9045, 9075))
def test_records_that_leave_nothing_or_stand_still_are_answered(seed):
    """A channel at rest has no fit in percent; a machine that is met exactly leaves errors of zero to choose among."""
    case = drawn(seed, effects=4, samples=400, parts=2)
    answers, _ = asked(case)
    assert list(broken(case, answers)) == []


@pytest.mark.parametrize("seed", (20, 30, 118, 301, 302, 303, 304, 307))
def test_what_recording_did_is_no_missing_physics(seed):
    """Jitter of the stamps, outliers, a held span, summer time, on a model that lacks nothing."""
    assert judged(seed, FAULTS[seed % len(FAULTS)], effects=5, samples=1000, parts=2) == "none"


def test_machines_of_every_kind_are_drawn():
    cases = [drawn(seed, effects=2) for seed in range(10)]
    inputs, parts = {len(c.model.inputs) for c in cases}, {c.text.count("kind: ") for c in cases}
    assert {0, 1, 2} <= inputs and {1, 2, 3} <= parts
    assert (
        {len(c.records) for c in cases} == {1, 2, 3}
        and any(c.inside for c in cases)
        and any(c.hidden for c in cases)
    )
    lengths = [record.n for c in cases for record in c.records]
    assert min(lengths) < 40 and max(lengths) > 1000
