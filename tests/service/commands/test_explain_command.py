"""What `residuum explain` prints of an answer that leaves much."""

from types import SimpleNamespace

import pytest

from residuum.identification.unseen_blocks.structure import HeldValue
from residuum.identification.unseen_blocks.verdict import Quantity
from residuum.identification.work import Work
from residuum.library.answers.explanation import explanation_text
from residuum.library.answers.plain import sizes_text


def explanation(verdict, times, held=()):
    return SimpleNamespace(
        verdict=verdict,
        candidates=(),
        probability_none=0.0,
        probability_unknown=0.0,
        free=None,
        left={"angle": (0.014, "rad", times), "speed": (0.02, "rad/s", 1.1)},
        drifting=False,
        timing=(),
        next_experiment=(),
        values=(),
        held=held,
        work=Work(),
    )


@pytest.mark.parametrize(
    ("verdict", "says"),
    [
        ("missing-effect", "what is named is not all"),
        ("unknown-effect", "something slow that no candidate"),
    ],
)
def test_what_remains_far_above_the_noise_is_said_whatever_the_verdict(verdict, says):
    text = explanation_text(explanation(verdict, 36.2))
    assert (
        "angle: 0.014 rad RMS remain, 36 times what their own past cannot predict" in text
        and says in text
    )
    assert "speed" not in text
    assert "RMS remain" not in explanation_text(explanation(verdict, 1.2))


def test_a_model_that_is_called_adequate_though_much_is_left_is_told_with_what_that_may_be():
    assert "6 times what their own past cannot predict: noise that is slow, or" in explanation_text(
        explanation("adequate", 6.0)
    )


def test_a_value_that_was_freed_is_said_with_those_that_would_do_as_well():
    held = HeldValue("m", 6195.0, 5894.3, 0.2, "kg", ("S",))
    text = explanation_text(explanation("adequate", 1.0, (held,)))
    assert (
        "m is fixed at 6195 kg; the records ask for 5894.3 ± 0.2 kg" in text
        and "(S would do as well)" in text
    )


def test_a_value_that_does_as_much_as_an_effect_is_said_with_it():
    held = HeldValue("m", 608.0, 638.0, 0.5, "kg", as_much_as=("cubic-spring@shaft",))
    text = explanation_text(explanation("missing-effect", 1.0, (held,)))
    assert "638 ± 0.5 kg, which explains as much as cubic-spring@shaft: improve with" in text


@pytest.mark.parametrize(
    ("value", "std", "says"),
    [
        (79970.4, 30.0, "k = 79970 ± 30 N/m"),
        (0.103984, 1e-5, "k = 0.10398 ± 1e-05 N/m"),
        (-0.3, 5.0, "k = 0 ± 5 N/m"),
        (12.34567, 0.0, "k = 12.35 N/m (held)"),
        (12.34567, float("inf"), "k = 12.35 N/m (not determined)"),
    ],
)
def test_a_size_is_shown_to_the_digit_in_which_its_doubt_begins(value, std, says):
    assert sizes_text({"k": Quantity(value, std, "N/m")}) == says
