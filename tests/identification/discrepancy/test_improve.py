"""What improve keeps in the user's model."""

from residuum.identification.discrepancy.improve import Step, _vanished
from residuum.identification.physics import load_model


def test_an_effect_without_size_is_no_part_of_the_model():
    """A shift in time that made up for the wrong input timing ends at zero once the timing is right."""
    model = load_model("gate-drive").with_effect("input-delay", "voltage", {"delay": 0.0})
    model = model.with_effect("viscous-friction", "shaft", {"d": 1e-4}).with_effect("input-offset", "voltage", {"u_0": 0.0})
    history = [Step(None, 1.0), Step("input-delay", 0.9), Step("viscous-friction", 0.5)]
    assert [use.id for use in _vanished(model, history)] == ["input-delay"]  # the offset was the user's own
