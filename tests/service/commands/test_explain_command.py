"""What `residuum explain` prints of an answer that leaves much."""

from types import SimpleNamespace

import pytest

from residuum.service.commands.explain import explanation_text


def explanation(verdict, times):
    return SimpleNamespace(
        verdict=verdict,
        candidates=(),
        probability_none=0.0,
        probability_unknown=0.0,
        free=None,
        left={"angle": (0.014, "rad", times), "speed": (0.02, "rad/s", 1.1)},
        search=SimpleNamespace(drifting=False, timing=[]),
        next_experiment=(),
    )


@pytest.mark.parametrize(
    ("verdict", "says"), [("missing-effect", "what is named is not all"), ("unknown-effect", "something slow that no candidate")]
)
def test_what_remains_far_above_the_noise_is_said_whatever_the_verdict(verdict, says):
    text = explanation_text(explanation(verdict, 36.2))
    assert "angle: 0.014 rad RMS remain, 36 times what their own past cannot predict" in text and says in text
    assert "speed" not in text
    assert "RMS remain" not in explanation_text(explanation(verdict, 1.2))
