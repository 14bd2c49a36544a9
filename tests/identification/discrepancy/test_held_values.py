"""A value that the model holds fixed, and that is wrong, is told as that, and not as physics that is missing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from residuum.identification.discrepancy.explain import answer_on_blocks, explain
from residuum.identification.discrepancy.improve import improve
from residuum.identification.errors import BadModel
from residuum.identification.physics import Key, read_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.record_search import searched
from residuum.identification.unseen_blocks.structure import HELD
from residuum.identification.unseen_blocks.tried import Wanted

DRIVE = Path(__file__).with_name("drive.yaml").read_text()
R, K, J, B = 1.7, 0.124, 0.00121, 0.00056
SAMPLE_TIME, STEPS = 0.005, 40
EFFECTS = (
    "quadratic-drag",
    "viscous-friction",
    "coulomb-friction",
    "constant-load",
    "inductance",
    "input-delay",
    "output-lag",
)


@njit
def driven(u, drag):
    """Speed and current of the drive with a drag that grows with the square of the speed; voltages are held over samples."""
    speed, current, w = np.empty(u.size), np.empty(u.size), 0.0
    for t in range(u.size):
        speed[t], current[t] = w, (u[t] - K * w) / R
        for _ in range(STEPS):
            w += SAMPLE_TIME / STEPS * (K * (u[t] - K * w) / R - B * w - drag * w * abs(w)) / J
    return speed, current


def record(drag=0.0, n=3000):
    rng = np.random.default_rng(2)
    u = np.repeat(9.0 * rng.standard_normal(n // 40), 40)
    speed, current = driven(u, drag)
    noisy = {
        "speed": speed + 0.2 * rng.standard_normal(n),
        "current": current + 0.02 * rng.standard_normal(n),
    }
    return Record({"u": u} | noisy, {"u": "V", "speed": "rad/s", "current": "A"}, SAMPLE_TIME)


def held_at(value, name="K"):
    """The model with its torque constant, or another parameter, fixed at a value."""
    model = read_model(DRIVE)
    known = replace(model.parameters[name], value=value, fixed=True)
    return replace(model, parameters={**model.parameters, name: known})


def test_a_wrong_torque_constant_is_told_and_nothing_is_missing():
    found = explain(held_at(0.135), [record()], effects=EFFECTS)
    (held,) = found.held
    assert (found.verdict, list(found.accepted)) == ("adequate", [])
    assert (held.name, held.held, held.unit, held.indistinguishable_from) == (
        "K",
        0.135,
        "V*s/rad",
        (),
    )
    assert abs(held.value - K) < 4.0 * held.std < 0.01 * K


def test_beside_a_wrong_value_the_effect_is_still_found_and_improve_mends_both():
    model = held_at(0.135)
    found = explain(model, [record(drag=4e-6)], effects=EFFECTS)
    assert ([held.name for held in found.held], list(found.accepted)) == (
        ["K"],
        [("quadratic-drag", "rotor")],
    )
    improved = improve(model, [record(drag=4e-6)], free=["K"], effects=EFFECTS)
    assert [step.added for step in improved.history] == [None, "K freed", "quadratic-drag"]
    assert abs(improved.model.values["K"] / K - 1.0) < 0.002


def test_fixed_means_fixed():
    improved = improve(held_at(0.135), [record(drag=4e-6)], effects=EFFECTS)
    assert improved.model.values["K"] == 0.135
    assert improved.model.parameters["K"].fixed
    assert improved.verdict != "adequate"
    with pytest.raises(BadModel, match=r"'J': is no parameter that .* holds fixed; there are K"):
        improve(held_at(0.135), [record()], free=["J"])


def test_a_right_value_stays_where_it_is_held():
    found = explain(held_at(K), [record(drag=4e-6)], effects=EFFECTS)
    assert (found.held, list(found.accepted)) == ((), [("quadratic-drag", "rotor")])


def test_where_an_effect_leads_the_value_that_does_as_much_is_told_before_it():
    wanted = Wanted(("viscous-friction", "coulomb-friction"))
    records = [record()]
    search = searched(held_at(0.00046, "b"), records, None, wanted)
    # Which of the two leads is chance: they are one equation.
    friction, value = Key("viscous-friction", "rotor"), Key(HELD, "b")
    search.best, search.group = search.every[(friction,)], [search.every[(value,)]]
    found = answer_on_blocks(search, wanted, records, None, 0.0)
    (held,) = found.held
    assert list(found.accepted) == [friction]
    assert (held.name, held.held, held.as_much_as) == ("b", 0.00046, ("viscous-friction@rotor",))
    assert abs(held.value - B) < 4.0 * held.std < 0.05 * B
