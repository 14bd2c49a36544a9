"""Bad model files are refused with line and column; good ones survive the way to a file and back."""

import re

import pytest

from residuum.identification.errors import BadModel
from residuum.identification.physics import (
    BUILT_IN,
    candidates,
    load_model,
    read_model,
    write_model,
)
from residuum.identification.physics.effects import EFFECTS

AXIS = """name: my axis
inputs:      {force: N}
states:      {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters:  {M: {value: 95, unit: kg, lower: 1, upper: 1000}}
balances:
  axis:      {kind: force, storage: M * der(v), terms: {drive: force}, position: q, velocity: v}
outputs:     {position: {value: q, unit: m}}
effects:
  - {id: coulomb-friction, balance: axis, parameters: {tau_c: {value: 20.4, unit: N}}}
"""

DRIVE = """name: my drive
inputs:      {voltage: V}
states:      {theta: {unit: rad, rate: omega}, omega: {unit: rad/s}}
parameters:  {K: {value: 0.07, unit: V*s/rad, lower: 0}, R: {value: 0.75, unit: ohm, lower: 0}, J: {value: 2.5e-4, unit: kg*m**2}}
balances:
  shaft:     {kind: torque, storage: J * der(omega), terms: {motor: K * i}, position: theta, velocity: omega}
  winding:   {kind: voltage, storage: 0, terms: {supply: voltage, resistance: -R * i, back_emf: -K * omega}, current: i}
outputs:     {speed: {value: omega, unit: rad/s}, current: {value: i, unit: A}}
"""


@pytest.mark.parametrize("text", [AXIS, DRIVE])
def test_contract_examples_are_read_and_written(text):
    model = read_model(text)
    assert read_model(write_model(model)) == model


@pytest.mark.parametrize(
    ("text", "old", "new", "says"),
    [
        (AXIS, "drive: force", "drive: push", r"line 6, column 64: name 'push' is not declared"),
        (AXIS, "drive: force", "drive: force + v", r"line 6, column 70: unit clash"),
        (AXIS, "drive: force", "drive: M * v", r"line 6, column \d+: unit clash: term 'drive'"),
        (AXIS, "M * der(v)", "M", r"line 6, column 37: balance 'axis': storage has no der\(\)"),
        (AXIS, "rate: v", "rate: w", r"line 3, column 15: state 'q': rate 'w' is not a state"),
        (AXIS, "{unit: m, rate: v}", "{unit: m}", r"line 3, column 15: state without a balance"),
        (
            AXIS,
            "lower: 1, upper: 1000",
            "lower: 100, upper: 10",
            r"line 4, column 18: parameter 'M': lower is 100",
        ),
        (
            AXIS,
            "value: 95",
            "value: 0.5",
            r"line 4, column 26: parameter 'M': value is 0.5; must be within 1 to 1000",
        ),
        (
            AXIS,
            "velocity: v}",
            "velocity: v, colour: q}",
            r"line 6, column \d+: balance 'axis': key 'colour' is not known",
        ),
        (
            AXIS,
            "velocity: v}",
            "velocity: v, from the plate}",
            r"key 'from the plate'.*a text with a comma stands in quotation marks",
        ),
        (AXIS, "drive: force", "drive: force / (M - 95)", r"line 6, column 70: division by zero"),
        (
            AXIS,
            "drive: force",
            "drive: __import__(force)",
            r"column 64: function '__import__' is not known",
        ),
        (AXIS, "drive: force", "drive: force.real", r"column 69: character '\.' is not allowed"),
        (AXIS, "unit: kg", "unit: parsec", r"unit clash"),
        (AXIS, "unit: kg", "unit: wibble", r"line 6, column \d+: unit clash: term 'drive'"),
        (
            AXIS,
            "id: coulomb-friction",
            "id: stickiness",
            r"line 9, column 5: effect 'stickiness' is not in the catalogue",
        ),
        (AXIS, "balance: axis", "balance: motor", r"line 9, column 5: .*'motor' is no balance"),
        (AXIS, "value: 20.4", "value: -1", r"line 9, column 5: .*within 0 to inf"),
        (AXIS, "kind: force", "kind: magic", r"line 6, column 21: balance 'axis': kind 'magic'"),
        (AXIS, "name: my axis", "name: &a my axis", r"line 1, column 7: anchors and aliases"),
        (
            DRIVE,
            "-R * i,",
            "-R * max(i, 0),",
            r"line 7, column \d+: algebraic loop: balance 'winding'",
        ),
        (DRIVE, "R: {value: 0.75", "R: {value: 0", r"line 7, column 39: division by zero"),
        (
            DRIVE,
            "supply: voltage, resistance: -R * i",
            "supply: voltage",
            r"line 7, column 3: .*no term contains 'i'",
        ),
        (DRIVE, "value: 2.5e-4", "value: 0", r"line 6, column \d+: .*storage .*is 0"),
        (
            DRIVE,
            "back_emf: -K * omega",
            "back_emf: -K * der(omega)",
            r"line 7, column \d+: der\(\) may only stand in a storage",
        ),
    ],
)
def test_refusals_say_where(text, old, new, says):
    assert old in text
    with pytest.raises(BadModel, match=says):
        read_model(text.replace(old, new, 1), "m.yaml")


@pytest.mark.parametrize(
    "text",
    [
        "[" * 1_000_000,
        "[" * 100_000,
        "name: " + "(" * 50_000,
        "a: " * 3,
        "",
        "- 1",
        "name: x\n\tb: 1",
    ],
)
def test_hostile_texts_are_refused_with_a_place(text):
    with pytest.raises(BadModel, match=r"m\.yaml, line \d+, column \d+: "):
        read_model(text, "m.yaml")


def test_deep_brackets_in_an_expression_are_refused():
    with pytest.raises(
        BadModel, match=r"line 6, column \d+: brackets and signs are nested more than 60 deep"
    ):
        read_model(AXIS.replace("drive: force", "drive: " + "(" * 300 + "force" + ")" * 300))


def test_the_catalogue_has_every_id_and_the_built_in_models_offer_them():
    listed = {id for name in BUILT_IN for id, _ in candidates(load_model(name))}
    assert set(EFFECTS) == listed
    for name in BUILT_IN:
        assert read_model(write_model(load_model(name))) == load_model(name)
    assert not any(re.search(r"[^a-z-]", id) for id in EFFECTS)


def test_a_comma_inside_an_expression_in_braces_is_understood():
    model = read_model(AXIS.replace("drive: force", "drive: max(force, 0), push: min(force, 0)"))
    assert [term.text for term in model.balances["axis"].terms.values()] == [
        "max(force, 0)",
        "min(force, 0)",
    ]


def test_balances_may_be_kept_in_other_units_when_all_terms_agree():
    tank = """name: tank
inputs: {u: V}
states: {h: {unit: cm}}
parameters: {A: {value: 154, unit: cm**2}, k: {value: 3, unit: cm**3/s/V}}
balances: {tank: {kind: volume, storage: A * der(h), terms: {pump: k * u}, level: h}}
outputs: {h: {value: h, unit: cm}}
"""
    assert read_model(tank).site("tank", EFFECTS["leak"]).per("level") == "cm**2/s"
    with pytest.raises(BadModel, match="unit clash"):
        read_model(tank.replace("unit: cm**3/s/V", "unit: m**3/s/V"))


def test_a_balance_an_input_and_an_output_may_share_a_name():
    loop = """name: flow loop
inputs: {flow: "%"}
states: {y: {unit: m**3/h}}
parameters: {K: {value: 0.5, unit: m**3/h/%, lower: 0}, tau: {value: 9, unit: s, lower: 0.01}}
balances: {flow: {kind: signal, storage: tau * der(y), terms: {gain: K * flow, decay: -y}}}
outputs: {flow: {value: y, unit: m**3/h}}
"""
    model = read_model(loop)
    assert {("output-lag", "flow"), ("input-delay", "flow")} <= set(candidates(model))
    lagging = model.with_effect("output-lag", "flow", {"tau": 2.0})
    assert read_model(write_model(lagging)).effects[0].label == "output-lag@flow"


def test_the_surroundings_are_no_input_that_drives():
    targets = {target for id, target in candidates(load_model("oven")) if id.startswith("input-")}
    assert targets == {"duty"}


@pytest.mark.parametrize(
    ("before", "after", "line"),
    [
        ("M * der(v)", "M**9**9 * der(v)", r"line \d+, column \d+.*exponent"),
        (None, "outputs: {}", r"line \d+, column \d+.*outputs: is empty"),
    ],
)
def test_towers_of_powers_and_models_that_measure_nothing_are_refused(before, after, line):
    text = AXIS.replace(before, after) if before else AXIS[: AXIS.index("outputs:")] + after
    with pytest.raises(BadModel, match=line):
        read_model(text)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (
            "inputs: {heat: W, outside: degC}\nstates: {T: {unit: degC}}\n"
            "parameters: {C: {value: 2e7, unit: J/K}, R: {value: 0.006, unit: K/W}}\n"
            "balances: {air: {kind: heat, storage: C * der(T), terms: {heater: heat, loss: (outside - T) / R}VARIABLES}}\n"
            "outputs: {room: {value: T, unit: degC}}\n",
            ", temperature: T",
        ),
        (
            "inputs: {push: N}\nstates: {q: {unit: m, rate: v}, v: {unit: m/s}}\nparameters: {M: {value: 2, unit: kg}}\n"
            "balances: {axis: {kind: force, storage: M * der(v), terms: {drive: push}VARIABLES}}\n"
            "outputs: {place: {value: q, unit: m}}\n",
            ", position: q, velocity: v",
        ),
        (
            "inputs: {u: V}\nstates: {h: {unit: cm}}\n"
            "parameters: {A: {value: 154, unit: cm**2}, k: {value: 3, unit: cm**3/s/V}}\n"
            "balances: {tank: {kind: volume, storage: A * der(h), terms: {pump: k * u}VARIABLES}}\n"
            "outputs: {h: {value: h, unit: cm}}\n",
            ", level: h",
        ),
    ],
)
def test_a_variable_that_a_balance_does_not_name_is_what_it_stores(text, named):
    left_out, said = (
        read_model("name: m\n" + text.replace("VARIABLES", words)) for words in ("", named)
    )
    assert left_out == said and candidates(left_out) == candidates(said)


def test_a_state_in_another_unit_plays_no_role():
    text = (
        "name: rc\ninputs: {u: V}\nstates: {y: {unit: V}}\nparameters: {tau: {value: 2, unit: s}}\n"
        "balances: {capacitor: {kind: voltage, storage: tau * der(y), terms: {u: u, y: -y}}}\noutputs: {y: {value: y, unit: V}}\n"
    )
    assert not read_model(text).balances["capacitor"].variables
