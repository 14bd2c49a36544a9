"""What to measure next: a machine that was driven one way only is to be driven both ways."""

import numpy as np
import pytest

from residuum.identification.physics import load_model, match, read_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.advice import distinguishing


@pytest.mark.parametrize(("least", "both_ways"), [(30.0, True), (-30.0, False)])
def test_only_an_input_that_kept_one_sign_is_to_be_reversed(least, both_ways):
    force = np.linspace(least, 90.0, 200)
    record = Record(
        {"force": force, "velocity": np.zeros(200)}, {"force": "N", "velocity": "m/s"}, 0.01
    )
    model, experiments = match(load_model("linear-axis"), [record])
    lowest = {}

    def power(tried, _only):
        lowest[len(lowest)] = float(tried[0].U.min())
        return 0.5 - tried[0].U.min() / 1000.0  # most for what goes furthest back

    best = distinguishing(("a", "b"), model, experiments, power)[0]
    assert ("both ways" in best.do) is both_ways
    assert (min(lowest.values()) == pytest.approx(-90.0, rel=0.02)) is both_ways


def test_a_machine_without_inputs_cannot_be_driven_otherwise():
    text = (
        "name: pendulum\nstates: {phi: {unit: rad, rate: w}, w: {unit: rad/s}}\n"
        "parameters: {J: {value: 1, unit: kg*m**2}, G: {value: 2, unit: N*m}}\n"
        "balances: {pivot: {kind: torque, storage: J * der(w), terms: {weight: -G * sin(phi)}, position: phi, velocity: w}}\n"
        "outputs: {angle: {value: phi, unit: rad}, speed: {value: w, unit: rad/s}}\n"
    )
    angle = np.cos(1.4 * 0.05 * np.arange(200))
    model, experiments = match(read_model(text), [Record({"angle": angle}, {"angle": "rad"}, 0.05)])
    proposals = distinguishing(
        ("a", "b"), model, experiments, lambda _, only: 0.2 if only is None else 0.9
    )
    assert proposals[0].do == "also record speed [rad/s]"
    assert not any("drive" in proposal.do or "repeat" in proposal.do for proposal in proposals)
