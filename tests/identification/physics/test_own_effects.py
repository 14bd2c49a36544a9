"""Effects that a user writes in a file: found, sized, carried by the model file, and refused where they are wrong."""

from contextvars import copy_context

import numpy as np
import pytest

from residuum.identification.discrepancy.explain import explain
from residuum.identification.errors import BadModel
from residuum.identification.physics import candidates, estimate, match, read_model, write_model
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.files.effect_file import read_effects
from residuum.identification.record import Record

AXIS = """
name: axis
inputs: {force: N}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters: {M: {value: 8, unit: kg, lower: 1, upper: 100}}
balances: {axis: {kind: force, storage: M * der(v), terms: {drive: force}, position: q, velocity: v}}
outputs: {velocity: {value: v, unit: m/s}}
"""
SINE = """
effects:
  - id: sine-drag
    title: Sine drag
    acts_on: [force]
    term: -c * sin(velocity / v_0)
    parameters:
      c: {value: 0, unit: N, size: true, meaning: largest drag}
      v_0: {value: 0.5, unit: m/s, lower: 0.01, meaning: velocity scale}
    reference: made up for a test
"""
DAHL = """
effects:
  - id: my-dahl
    acts_on: [force]
    term: -f * z
    parameters: {f: {value: 0, unit: N, lower: 0, size: true}, x_0: {value: 0.05, unit: m, lower: 1e-6}}
    states: {z: {unit: "1", rate: (velocity - abs(velocity) * z) / x_0}}
"""


def written(tmp_path, text):
    path = tmp_path / "own.yaml"
    path.write_text(text)
    return path


def slowed(n=4000, dt=0.01):
    """A mass of 9.3 kg with a drag of 7·sin(v/0.4) N."""
    rng, steps, v = np.random.default_rng(4), 20, 0.0
    force, seen = np.repeat(rng.uniform(-12.0, 12.0, n // 50), 50), np.empty(n)
    for k in range(n):
        seen[k] = v
        for _ in range(steps):
            v += dt / steps * (force[k] - 7.0 * np.sin(v / 0.4)) / 9.3
    return Record(
        {"force": force, "velocity": seen + 0.01 * rng.standard_normal(n)},
        {"force": "N", "velocity": "m/s"},
        dt,
    )


@pytest.fixture
def here():
    """Runs something where what it adds to the catalogue is gone afterwards."""
    return copy_context().run


def test_an_effect_of_ones_own_is_named_sized_and_carried_by_the_model_file(tmp_path, here):
    def story():
        (effect,) = read_effects(written(tmp_path, SINE))
        EFFECTS.use_here(effect)
        found = explain(
            read_model(AXIS),
            [slowed()],
            effects=["sine-drag", "viscous-friction", "coulomb-friction"],
        )
        assert found.candidates[0].effect == "sine-drag"
        return write_model(found.found.best.model)

    text = here(story)
    assert "sine-drag" not in EFFECTS
    model = copy_context().run(read_model, text)
    assert "sine-drag" not in EFFECTS
    assert abs(model.values["sine-drag@axis.c"] / 7.0 - 1.0) < 0.03
    assert abs(model.values["sine-drag@axis.v_0"] / 0.4 - 1.0) < 0.03
    assert write_model(model) == text


def test_states_of_its_own_are_integrated(tmp_path, here):
    """Dahl's friction written by hand is the catalogue's."""

    def story():
        EFFECTS.use_here(read_effects(written(tmp_path, DAHL))[0])
        record = slowed(n=1500)
        ours = read_model(AXIS).with_effect("my-dahl", "axis", {"f": 2.0, "x_0": 0.03})
        theirs = read_model(AXIS).with_effect("hysteresis", "axis", {"f_c": 2.0, "x_0": 0.03})
        return [estimate(m, match(m, [record])[1], free=()).residuals[0] for m in (ours, theirs)]

    ours, theirs = here(story)
    np.testing.assert_allclose(ours, theirs, atol=1e-6)


OVEN = """
name: oven
inputs: {heater: W}
states: {T: {unit: degC}}
parameters: {C: {value: 400, unit: J/K}}
balances: {room: {kind: heat, storage: C * der(T), terms: {heater: heater}}}
outputs: {temperature: {value: T, unit: degC}}
"""


def test_it_is_proposed_where_it_fits_and_nowhere_else(tmp_path, here):
    def story():
        EFFECTS.use_here(read_effects(written(tmp_path, SINE))[0])
        return candidates(read_model(AXIS)), candidates(read_model(OVEN))

    fits, of_an_oven = here(story)
    assert ("sine-drag", "axis") in fits
    assert not any(key.effect == "sine-drag" for key in of_an_oven)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "sine-drag",
            "Sine Drag",
            "line 3, column 9: effect 'Sine Drag': an id is of small letters",
        ),
        ("[force]", "[forces]", "acts_on is a list of torque, force"),
        ("-c * sin(velocity / v_0)", "-c * sin(speed / v_0)", "'speed' is not known here"),
        ("-c * sin(velocity / v_0)", "-c * velocity", "the term is in"),
        (
            "-c * sin(velocity / v_0)",
            "-c * sin(velocity / v_0) - 1 * c / v_0 * v_0 + v_0 - v_0 + 2",
            "does not vanish",
        ),
        ("-c * sin(velocity / v_0)", "__import__('os')", "line 6"),
        ("term:", "signal:", "a balance gets a 'term'"),
        (
            "value: 0.5, unit: m/s, lower: 0.01",
            "value: 0.5, unit: m/s, lower: 1",
            "value is outside its bounds",
        ),
    ],
)
def test_what_is_wrong_is_refused_in_one_line_with_its_place(tmp_path, old, new, says):
    with pytest.raises(BadModel) as refused:
        read_effects(written(tmp_path, SINE.replace(old, new, 1)))
    assert says in str(refused.value) and "\n" not in str(refused.value)


def test_an_id_of_the_catalogue_is_taken(tmp_path):
    (effect,) = read_effects(written(tmp_path, SINE.replace("sine-drag", "overflow")))
    with pytest.raises(BadModel, match="'overflow': the catalogue has one of this id"):
        EFFECTS.use_here(effect)
