"""Models made of parts, beside the same written out by hand and beside independent solutions; what is refused."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from residuum.identification.errors import BadModel
from residuum.identification.physics import Experiment, Simulator, load_model, read_model
from residuum.identification.physics.files.model_file import write_model
from residuum.identification.physics.files.parts import MOST_PARTS, library

ROOT = Path(__file__).parents[3]
GATE = """
name: gate
use: {motor: dc-motor, door: carriage}
connect: {axle: {motor.shaft: 1, door.body: r / N}}
inputs: {u: V}
let: {motor_voltage: u}
parameters:
  r: {value: 0.028, unit: m, fixed: true}
  N: {value: 44, unit: "1", fixed: true}
  motor_R: 0.7473
  motor_K: {value: 0.0696, unit: V*s/rad}
  motor_J: {value: 3.5e-5, fixed: true}
  motor_d: 0
  door_m: 608
  door_d: 20
outputs:
  speed: {value: motor_speed, unit: rad/s}
  place: {value: door_position, unit: m}
"""


def simulated(model, n, dt, start=(), **inputs):
    """Outputs of n samples; states and inputs that are not said are 0."""
    U = np.stack(
        [np.broadcast_to(inputs.get(name, 0.0), n) for name in model.inputs] or [[]] * n, 1
    )
    U = U.reshape(n, len(model.inputs)).astype(float)
    empty = np.full((n, len(model.outputs)), np.nan)
    held = Experiment(U, empty, np.zeros(len(model.inputs)), dt)
    return Simulator(model).run(held, dict(start)).Y


def system(use, connect, outputs, more=""):
    return read_model(
        f"name: system\nuse: {{{use}}}\nconnect: {connect}\noutputs: {outputs}\n{more}"
    )


def test_a_rigid_train_is_what_one_writes_by_hand():
    made = read_model(GATE)
    hand = read_model("""
name: gate
inputs: {u: V}
states: {theta: {unit: rad, rate: omega}, omega: {unit: rad/s}}
parameters:
  R: {value: 0.7473, unit: ohm}
  K: {value: 0.0696, unit: V*s/rad}
  J: {value: 3.5e-5, unit: kg*m**2}
  m: {value: 608, unit: kg}
  d: {value: 20, unit: N*s/m}
  q: {value: 0.000636363636363636, unit: m}
balances:
  shaft: {kind: torque, storage: (J + m * q**2) * der(omega), terms: {motor: K * i, door: -d * q**2 * omega}}
  winding: {kind: voltage, storage: 0, terms: {u: u, R: -R * i, emf: -K * omega}, current: i}
outputs: {speed: {value: omega, unit: rad/s}, place: {value: q * theta, unit: m}}
""")
    U = 24.0 * np.sign(np.sin(np.arange(400) * 0.05))
    assert list(made.states) == ["motor_omega", "axle_position"]
    np.testing.assert_allclose(
        simulated(made, 400, 0.01, u=U), simulated(hand, 400, 0.01, u=U), rtol=1e-9, atol=1e-12
    )


def test_what_is_written_is_the_same_model():
    made = read_model(GATE)
    again = read_model(write_model(made))
    assert list(again.parameters) == list(made.parameters) and not again.effects
    U = np.linspace(0.0, 24.0, 100)
    np.testing.assert_allclose(
        simulated(again, 100, 0.01, u=U), simulated(made, 100, 0.01, u=U), rtol=1e-12
    )


def test_a_value_of_a_part_keeps_what_is_not_said_of_it():
    parameter = read_model(GATE).parameters["motor_R"]
    assert (parameter.value, parameter.unit, parameter.lower) == (0.7473, "ohm", 1e-4)
    assert read_model(GATE.replace("0.7473", "0.7473 ± 0.1")).parameters["motor_R"].prior.std == 0.1
    with pytest.raises(BadModel, match=r"line 10, .*motor_R.* is -1; must be within 0.0001 to"):
        read_model(GATE.replace("0.7473", "-1"))


def test_effects_fit_where_parts_are_joined():
    made = read_model(GATE).with_effect("coulomb-friction", "axle", {"tau_c": 0.1})
    assert made.balances["axle"].variables == {
        "position": "axle_position",
        "velocity": "motor_omega",
    }


def test_files_beside_the_model_are_parts_that_may_have_parts(tmp_path):
    (tmp_path / "drive.yaml").write_text(
        "name: drive\nuse: {motor: dc-motor, wheel: inertia}\nconnect: {shaft: [motor.shaft, wheel.shaft]}\n"
        "outputs: {speed: {value: wheel_speed, unit: rad/s}}\n"
    )
    text = (
        "name: two\nuse: {a: drive.yaml, b: drive.yaml}\nlet: {b_motor_voltage: a_motor_voltage}\n"
        "outputs: {a: {value: a_speed, unit: rad/s}, b: {value: b_speed, unit: rad/s}}\n"
    )
    (tmp_path / "two.yaml").write_text(text)
    model = load_model(tmp_path / "two.yaml")
    assert list(model.inputs) == ["a_motor_voltage", "a_wheel_load", "b_wheel_load"]
    Y = simulated(model, 50, 0.01, a_motor_voltage=5.0)
    assert Y[-1, 0] > 1.0
    np.testing.assert_allclose(Y[:, 0], Y[:, 1], rtol=1e-12)
    with pytest.raises(BadModel, match="given as a text has no files beside it"):
        read_model(text)
    (tmp_path / "drive.yaml").write_text("name: drive\nuse: {me: drive.yaml}\noutputs: {x: me_x}\n")
    with pytest.raises(BadModel, match=f"more than {MOST_PARTS} parts"):
        load_model(tmp_path / "two.yaml")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("dc-motor", "dc-moter", "line 3, .*no part 'dc-moter'; .*dc-motor"),
        (
            "door.body: r",
            "door.bod: r",
            "line 4, .*'door.bod' is no balance of a part; .*door_body",
        ),
        ("r / N", "u", "a ratio is made of parameters and constants; 'u' is none"),
        (
            "r / N",
            "1 / N",
            "unit clash: 'door_v' of a part is in 'm/s'; .* is in s",
        ),
        (
            "door.body: r / N",
            "door.body: 1",
            "a force balance and 'motor_shaft' a torque balance; say the ratio",
        ),
        (
            "axle: {motor.shaft: 1, door.body: r / N}",
            "axle: [motor.shaft]",
            "must be a list of two balances",
        ),
        ("inputs: {u: V}", "inputs: {u: mV}", "line 6, .*'motor_voltage' of a part is in 'V'"),
        (
            "motor_voltage: u",
            "motor_voltage: motor_voltage + u",
            "'motor_voltage' is defined by itself",
        ),
        ("motor_speed, unit", "motor_sped, unit", "name 'motor_sped' is not declared"),
        (
            "inputs: {u: V}",
            "inputs: {u: V}\nstates: {motor_omega: {unit: rad/s}}",
            "declared in the model already",
        ),
    ],
)
def test_a_refusal_names_the_place(old, new, says):
    assert old in GATE
    with pytest.raises(BadModel, match=says):
        read_model(GATE.replace(old, new))


def test_a_storage_that_depends_on_its_variable_has_no_ratio(tmp_path):
    (tmp_path / "cone.yaml").write_text(
        "name: cone\nstates: {h: {unit: m}}\nparameters: {a: {value: 1}}\n"
        "balances: {tank: {kind: volume, storage: a * h**2 * der(h), terms: {leak: -a}}}\n"
        "outputs: {h: {value: h, unit: m}}\n"
    )
    (tmp_path / "two.yaml").write_text(
        "name: two\nuse: {a: tank, b: cone.yaml}\nconnect: {node: {a.bottom: 1, b.tank: 2}}\n"
        "outputs: {h: {value: a_h, unit: m}}\n"
    )
    with pytest.raises(
        BadModel, match="depends on 'b_h' itself; it can only be joined with ratio 1"
    ):
        load_model(tmp_path / "two.yaml")


def test_motor_shaft_and_inertia_swing_as_two_masses_do():
    model = system(
        "motor: dc-motor, coupling: shaft, wheel: inertia",
        "{left: [motor.shaft, coupling.a], right: [coupling.b, wheel.shaft]}",
        "{speed: {value: wheel_speed, unit: rad/s}, torque: {value: coupling_torque, unit: N*m}}",
        "parameters: {motor_J: 2e-4, motor_d: 1e-4, wheel_J: 1e-3, wheel_d: 2e-4, coupling_c: 5, coupling_d: 1e-3}\n",
    )
    assert list(model.inputs) == ["motor_voltage", "wheel_load"]

    def rate(t, x):
        w, twist, v = x
        torque = 5 * twist + 1e-3 * (w - v)
        motor = 0.05 * (6.0 - 0.05 * w) / 1.0
        return [(motor - 1e-4 * w - torque) / 2e-4, w - v, (torque - 2e-4 * v) / 1e-3]

    t = np.arange(300) * 1e-3
    x = solve_ivp(rate, (0, t[-1]), [0, 0, 0], t_eval=t, rtol=1e-10, atol=1e-12).y
    order = [("motor_omega", 0), ("coupling_twist", 1), ("wheel_omega", 2)]
    assert {name for name, _ in order} == set(model.states)
    Y = simulated(model, len(t), 1e-3, motor_voltage=6.0)
    np.testing.assert_allclose(Y[:, 0], x[2], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(Y[:, 1], 5 * x[1] + 1e-3 * (x[0] - x[2]), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("use", "ends", "ratio", "stiff"),
    [
        ("gear: gear", ("gear.input", "gear.output"), 10.0, "gear_c: 1e5, gear_d: 10"),
        (
            "belt: belt",
            ("belt.driving", "belt.driven"),
            2.5,
            "belt_c: 1e8, belt_d: 1e4, belt_r_2: 0.05",
        ),
    ],
)
def test_stiff_teeth_and_belts_are_a_ratio(use, ends, ratio, stiff):
    """Beside the rigid ratio of `connect`."""
    values = "motor_J: 1e-3, wheel_J: 0.05, wheel_d: 0.01"
    soft = system(
        f"motor: dc-motor, {use}, wheel: inertia",
        f"{{left: [motor.shaft, {ends[0]}], right: [{ends[1]}, wheel.shaft]}}",
        "{speed: {value: wheel_speed, unit: rad/s}}",
        f"parameters: {{{values}, {stiff}}}\n",
    )
    rigid = system(
        "motor: dc-motor, wheel: inertia",
        f"{{axle: {{motor.shaft: 1, wheel.shaft: 1 / {ratio}}}}}",
        "{speed: {value: wheel_speed, unit: rad/s}}",
        f"parameters: {{{values}}}\n",
    )
    driven = {"motor_voltage": 12.0, "wheel_load": 0.02}
    np.testing.assert_allclose(
        simulated(soft, 400, 0.01, **driven)[20:],
        simulated(rigid, 400, 0.01, **driven)[20:],
        rtol=2e-3,
    )


def test_two_tanks_and_a_pipe_swing_with_the_column():
    """ω² = (g A / l) (1/A_1 + 1/A_2), without friction."""
    model = system(
        "left: tank, right: tank, pipe: pipe",
        "{a: [left.bottom, pipe.inlet], b: [right.bottom, pipe.outlet]}",
        "{level: {value: left_level, unit: m}, flow: {value: pipe_flow, unit: m**3/s}}",
        "parameters: {left_A: 0.01, right_A: 0.03, pipe_k: 0, pipe_l: 4, pipe_A: 1e-3}\n",
    )
    omega = np.sqrt(9.81 * 1e-3 / 4 * (1 / 0.01 + 1 / 0.03))
    t = np.arange(400) * 0.05
    start = {"left_h": 1.2, "right_h": 1.0, "pipe_q": 0.0}
    Y = simulated(model, len(t), 0.05, start)
    mean, size = (1.2 * 0.01 + 1.0 * 0.03) / 0.04, 0.2 * 0.75
    np.testing.assert_allclose(Y[:, 0], mean + size * np.cos(omega * t), atol=2e-5)
    np.testing.assert_allclose(Y[:, 1], 0.01 * size * omega * np.sin(omega * t), atol=2e-6)


def test_a_pump_fills_until_its_curve_ends_and_a_valve_lets_out():
    model = system(
        "sump: tank, pump: pump, tower: tank, valve: valve",
        "{low: [sump.bottom, pump.inlet, valve.outlet], high: [pump.outlet, tower.bottom, valve.inlet]}",
        "{level: {value: tower_level, unit: m}, sump: {value: sump_level, unit: m}}",
        "parameters: {sump_A: 100, tower_A: 0.5, pump_h_0: 20, pump_k: 1e5, valve_k: 1e-3}\n",
    )
    start = {"sump_h": 2.0, "tower_h": 2.0}
    Y = simulated(model, 6000, 10.0, start, pump_speed=0.9, valve_opening=0.8)
    # steady: sqrt((20 s² − Δh)/k) = K·o·sqrt(Δh)
    loss = 1e5 * (1e-3 * 0.8) ** 2
    assert Y[-1, 0] - Y[-1, 1] == pytest.approx(20 * 0.81 / (1 + loss), rel=1e-3)
    np.testing.assert_allclose(0.5 * Y[:, 0] + 100 * Y[:, 1], 0.5 * 2 + 100 * 2, rtol=1e-9)


def test_a_heater_behind_a_wall_warms_a_room_as_the_resistances_say():
    model = system(
        "stove: heater, wall: wall, room: heater",
        "{a: [stove.body, wall.inside], b: [wall.outside, room.body]}",
        "{stove: {value: stove_temperature, unit: K}, room: {value: room_temperature, unit: K}, "
        "heat: {value: wall_heat, unit: W}}",
        "let: {room_surroundings: stove_surroundings, room_power: 0 * stove_power}\n"
        "parameters: {stove_G: 0, stove_C: 500, wall_G: 4, wall_C: 800, room_C: 900, room_G: 8}\n",
    )
    assert sorted(model.inputs) == ["stove_power", "stove_surroundings"]
    start = dict.fromkeys(model.states, 280.0)
    Y = simulated(model, 1000, 10.0, start, stove_power=100.0, stove_surroundings=280.0)
    np.testing.assert_allclose(Y[-1], [280 + 100 / 8 + 100 / 4, 280 + 100 / 8, 100.0], rtol=1e-6)


def test_both_streams_of_a_heat_exchanger_keep_the_energy():
    model = system(
        "hx: heat-exchanger",
        "{}",
        "{hot: {value: hx_hot_out, unit: K}, cold: {value: hx_cold_out, unit: K}}",
    )
    at = {"hx_w_hot": 50.0, "hx_w_cold": 80.0, "hx_T_hot_in": 360.0, "hx_T_cold_in": 290.0}
    hot, cold = simulated(model, 500, 1.0, dict.fromkeys(model.states, 300.0), **at)[-1]
    assert 50 * (360 - hot) == pytest.approx(80 * (cold - 290), rel=1e-6)
    assert 50 * (360 - hot) == pytest.approx(100 * (hot - cold), rel=1e-6)


def test_a_cell_drives_a_motor_in_its_loop():
    model = system(
        "cell: battery-cell, motor: dc-motor, wire: resistor",
        "{loop: [cell.loop, motor.winding, wire.loop]}",
        "{voltage: {value: cell_voltage, unit: V}, current: {value: motor_current, unit: A}, "
        "charge: {value: cell_state_of_charge}}",
        "let: {motor_voltage: 0 * cell_U_0}\nparameters: {wire_R: 0.1, motor_J: 1e-3}\n",
    )
    assert not model.inputs

    def rate(t, x):
        charge, v, w = x
        i = (np.interp(charge, [0, 0.5, 1], [3.0, 3.7, 4.2]) - v - 0.05 * w) / (0.02 + 0.1 + 1.0)
        return [-i / 9000, (i - v / 0.01) / 2000, (0.05 * i - 1e-5 * w) / 1e-3]

    t = np.arange(200) * 0.05
    start = {"cell_charge": 0.9, "cell_v": 0.0, "motor_omega": 0.0}
    x = solve_ivp(rate, (0, t[-1]), list(start.values()), t_eval=t, rtol=1e-10, atol=1e-12).y
    Y = simulated(model, 200, 0.05, start)
    np.testing.assert_allclose(Y[:, 2], x[0], rtol=1e-7)
    i = (np.interp(x[0], [0, 0.5, 1], [3.0, 3.7, 4.2]) - x[1] - 0.05 * x[2]) / 1.12
    np.testing.assert_allclose(Y[:, 1], i, rtol=1e-5)


def test_effects_of_a_part_are_not_left_out_without_a_word(tmp_path):
    text = (
        library()["inertia"]
        + "effects: [{id: coulomb-friction, balance: shaft, parameters: {tau_c: 1}}]\n"
    )
    (tmp_path / "wheel.yaml").write_text(text)
    (tmp_path / "two.yaml").write_text(
        "name: two\nuse: {wheel: wheel.yaml}\noutputs: {w: {value: wheel_speed, unit: rad/s}}\n"
    )
    with pytest.raises(
        BadModel, match=r"wheel\.yaml, line 13, .*effects: a part has none; put them into"
    ):
        load_model(tmp_path / "two.yaml")


def test_degrees_and_kelvins_are_not_joined():
    text = """
name: room
use: {wall: wall}
connect: {inner: [air, wall.inside], outer: [yard, wall.outside]}
states: {T: {unit: °C}, T_yard: {unit: K}}
parameters: {C: {value: 1000, unit: J/K}}
balances:
  air: {kind: heat, storage: C * der(T), terms: {}}
  yard: {kind: heat, storage: C * der(T_yard), terms: {}}
outputs: {T: {value: T, unit: °C}}
"""
    with pytest.raises(
        BadModel, match="'wall_T_in' of a part is in 'K', 'T' in '°C'; declare both"
    ):
        read_model(text)
    assert read_model(text.replace("°C", "K"))


def test_every_part_of_the_library_is_listed_and_says_where_it_is_from():
    table = (ROOT / "docs/reference/model-files.md").read_text()
    for name, text in library().items():
        head = [line for line in text.splitlines() if line.startswith("#")]
        assert f"\n| `{name}` |" in table
        assert f"\nname: {name}\n" in text and any(", ch. " in line for line in head), name
