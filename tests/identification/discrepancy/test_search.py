"""The search for missing effects where the model has gone astray; the machines are integrated here, in fine Euler steps."""

from pathlib import Path

import numpy as np

from residuum.identification.discrepancy.explain import explain
from residuum.identification.physics import load_model, read_model
from residuum.identification.record import Record
from residuum.simulation import MACHINES

VAN = """
name: van
inputs:      {traction: N}
states:      {s: {unit: m, rate: v}, v: {unit: m/s}}
parameters:  {m: {value: 2200, unit: kg, lower: 500}}
balances:
  chassis:   {kind: force, storage: m * der(v), terms: {wheels: traction}, position: s, velocity: v}
outputs:     {speed: {value: v, unit: m/s}}
"""
AXIS = Path(__file__).with_name("axis.yaml").read_text()
BELT = """name: belt
inputs: {force: N}
states: {x: {unit: m, rate: v}, v: {unit: m/s}}
parameters: {M: {value: 25, unit: kg, lower: 1}, d: {value: 95, unit: N*s/m, lower: 1}}
balances: {belt: {kind: force, storage: M * der(v), terms: {drive: force, viscous: -d * v}, position: x, velocity: v}}
outputs: {position: {value: x, unit: m}}
"""
COLUMN = """
name: column of water
inputs:      {pump: bar}
states:      {v: {unit: m/s}}
parameters:  {m: {value: 6195, unit: kg, fixed: true}, d: {value: 810, unit: N*s/m, lower: 0},
              S: {value: 4910, unit: N/bar, fixed: true}}
balances:
  column:    {kind: force, storage: m * der(v), terms: {pump: S * pump, wall: -d * v}, velocity: v}
outputs:     {flow: {value: v, unit: m/s}}
"""
FAN = """
name: fan
inputs:      {torque: N*m}
states:      {w: {unit: rad/s}}
parameters:  {J: {value: 0.0205, unit: kg*m**2, lower: 0}, d: {value: 0.0043, unit: N*m*s/rad, lower: 0}}
balances:
  rotor:     {kind: torque, storage: J * der(w), terms: {motor: torque, bearing: -d * w}, velocity: w}
outputs:     {speed: {value: w, unit: rad/s}}
"""
FINE = 20


def van(drag, rolling, seed=4, n=4000, sample_time=0.01):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-2500.0, 4200.0, n // 400 + 1), 400)[:n]
    v, speed = 8.0, np.empty(n)
    for k in range(n):
        speed[k] = v
        for _ in range(FINE):
            v += sample_time / FINE * (u[k] - drag * v * abs(v) - rolling * np.sign(v)) / 2380.0
    noise = np.zeros(n)
    for k in range(1, n):
        noise[k] = 0.5 * noise[k - 1] + 0.004 * rng.standard_normal()
    return Record(
        {"traction": u, "speed": speed + noise}, {"traction": "N", "speed": "m/s"}, sample_time
    )


def controlled_axis(load, seed=6, n=5000, sample_time=0.002):
    """An axis that a controller moves to and fro; `load(q, v)` is what the model does not know."""
    rng = np.random.default_rng(seed)
    wanted = np.cumsum(
        np.clip(np.diff(np.repeat(rng.uniform(-0.2, 0.2, n // 600 + 1), 600)[: n + 1]), -0.4, 0.4)
    )
    wanted = np.convolve(wanted, np.full(300, 1 / 300), mode="same")
    q = v = 0.0
    F, Q, V = np.empty(n), np.empty(n), np.empty(n)
    for k in range(n):
        Q[k], V[k] = q + 2e-5 * rng.standard_normal(), v + 2e-3 * rng.standard_normal()
        F[k] = np.clip(2.5e4 * (wanted[k] - Q[k]) - 1.8e3 * V[k], -500.0, 500.0)
        for _ in range(FINE):
            v += sample_time / FINE * (F[k] - 57.0 * v + load(q, v)) / 40.0
            q += sample_time / FINE * v
    return Record(
        {"force": F, "position": Q, "velocity": V},
        {"force": "N", "position": "m", "velocity": "m/s"},
        sample_time,
    )


def test_two_effects_for_which_a_third_could_stand_are_both_found():
    """Drag and rolling friction of a vehicle, whose position nobody records: alone, viscous friction fits best."""
    effects = [
        "viscous-friction",
        "quadratic-drag",
        "coulomb-friction",
        "linear-spring",
        "stribeck-friction",
    ]
    told = []
    found = explain(
        read_model(VAN, "van.yaml"),
        [van(1.1, 320.0)],
        effects=effects,
        tell=lambda _, doing: told.append(doing),
    )
    accepted = dict.fromkeys(id for id, _ in found.accepted)
    assert list(accepted) in (
        ["quadratic-drag", "coulomb-friction"],
        ["coulomb-friction", "quadratic-drag"],
    )
    drag = next(c for c in found.candidates if c.effect == "quadratic-drag").parameters["c"]
    assert abs(drag.value - 1.1) < 4 * drag.std


def test_where_the_likeliest_effect_does_not_hold_up_the_search_begins_with_what_lowers_the_error_most():
    """A fan with drag, its speed read by a slow sensor: drag alone takes the error to a seventh, which noise that is nearly
    integrated hardly sees; the lag alone is likelier by far, and worse on data kept aside.
    """
    rng = np.random.default_rng(508)
    torque, w, seen, speed = np.repeat(rng.uniform(0.2, 3.0, 20), 175), 20.0, 20.0, np.empty(3500)
    for k in range(torque.size):
        speed[k] = seen
        for _ in range(FINE):
            seen += 0.02 / FINE * (w - seen) / 0.15
            w += 0.02 / FINE * (torque[k] - 0.0044 * w - 1.2e-4 * w * abs(w)) / 0.02
    channels = {"torque": torque, "speed": speed + 0.4 * rng.standard_normal(3500)}
    record = Record(channels, {"torque": "N*m", "speed": "rad/s"}, 0.02)
    found = explain(read_model(FAN), [record])
    assert {id for id, _ in found.accepted} == {"quadratic-drag", "output-lag"}
    assert abs(found.found.best.model.values["output-lag@speed.tau"] - 0.15) < 0.01


def test_a_position_that_is_not_recorded_is_no_free_force_of_every_window():
    told = []
    found = explain(
        read_model(VAN, "van.yaml"),
        [van(1.1, 0.0)],
        effects=["quadratic-drag", "linear-spring", "cubic-spring"],
        tell=lambda share, doing: told.append((share, doing)),
    )
    assert [id for id, _ in found.accepted] == ["quadratic-drag"]
    shares = [share for share, _ in told]
    # who waits sees the search go on
    assert shares == sorted(shares) and sum(0.2 <= share < 0.75 for share in shares) >= 2
    assert any("beside quadratic-drag" in doing for _, doing in told)


def test_an_end_stop_that_the_machine_hammers_is_found_where_it_is():
    def stop(q, v):
        return -max(8e4 * (q - 0.12) + 400.0 * v, 0.0) if q > 0.12 else 0.0

    found = explain(
        read_model(AXIS, "axis.yaml"),
        [controlled_axis(stop)],
        effects=["end-stop", "cubic-spring", "coulomb-friction"],
    )
    assert found.candidates[0].effect == "end-stop" and found.verdict == "missing-effect"
    values = found.candidates[0].parameters
    assert abs(values["q_max"].value - 0.12) < 1e-4 and abs(values["k"].value / 8e4 - 1.0) < 0.05


def test_cogs_that_hold_an_axis_are_found_with_their_pitch():
    pitch = 2 * np.pi / 0.032
    record = controlled_axis(lambda q, _v: -30.0 * np.sin(pitch * q))
    found = explain(
        read_model(AXIS, "axis.yaml"),
        [record],
        effects=["tooth-ripple", "coulomb-friction", "input-dead-zone"],
    )
    assert [id for id, _ in found.accepted] == ["tooth-ripple"]
    values = found.candidates[0].parameters
    assert abs(values["n"].value / pitch - 1.0) < 1e-3
    assert abs(np.hypot(values["a"].value, values["b"].value) - 30.0) < 0.5


def test_not_play_that_is_never_taken_up_but_the_inertia_that_is_wrong_is_the_answer():
    """A mass without what lies beyond an endless play is a smaller mass; the model holds its own five per cent too large."""
    rng = np.random.default_rng(12)
    u = np.convolve(np.repeat(rng.uniform(0.2, 4.0, 60), 40), np.full(8, 1 / 8), mode="same")
    v, flow = 0.0, np.empty(u.size)
    for k in range(u.size):
        flow[k] = v
        for _ in range(FINE):
            v += 0.25 / FINE * (4910.0 * u[k] - 900.0 * v) / 5900.0
    record = Record(
        {"pump": u, "flow": flow + 0.005 * rng.standard_normal(u.size)},
        {"pump": "bar", "flow": "m/s"},
        0.25,
    )
    found = explain(read_model(COLUMN), [record], effects=["backlash", "elastic-transmission"])
    assert list(found.accepted) == [] and found.verdict == "adequate"
    (held,) = found.held
    assert (held.name, held.indistinguishable_from) == ("m", ("S",))  # or the area that drives it
    assert abs(held.value / 5900.0 - 1.0) < 2e-3


def test_a_limit_that_acts_seldom_is_looked_at_though_no_first_order_test_can_see_it():
    """A limit has no zero: tested where it acts always, it is hopeless, and so it stood behind others that are."""
    signals = MACHINES["gate-drive"](
        seed=23, effects={"input-saturation": "medium"}, profile="rich"
    ).simulate(30.0)
    found = explain(
        load_model("gate-drive"), [Record(signals.channels, signals.units, signals.sample_time)]
    )
    assert list(found.accepted) == [("input-saturation", "voltage")]
    assert abs(found.candidates[0].parameters["u_max"].value - 20.0) < 0.01


def test_friction_whose_directions_a_spring_at_rest_anywhere_leaves_open_is_told_with_the_one_that_stands_for_it():
    """The spring's place of rest and the difference of the two sides do the same: only the price of a parameter parts them."""
    truth = {"directional-friction": "medium", "linear-spring": "medium"}
    signals = MACHINES["gate-drive"](seed=4, effects=truth, profile="rich", rate=200.0).simulate(
        20.0
    )
    record = Record(signals.channels, signals.units, signals.sample_time)
    found = explain(
        load_model("gate-drive"),
        [record],
        effects=["coulomb-friction", "directional-friction", "linear-spring"],
    )
    friction = next(c for c in found.candidates if c.effect == "coulomb-friction")
    assert set(found.accepted) == {("coulomb-friction", "shaft"), ("linear-spring", "shaft")}
    assert friction.indistinguishable_from == ("directional-friction",)


def test_play_with_a_soft_contact_is_found_over_windows():
    """Play of 22 mm behind a contact that gives way by a centimetre; stiff contacts, tried first, lead to none."""
    rng, n, h, fine = np.random.default_rng(31), 12_000, 1e-3, 20
    swept = sum(
        np.sin(2 * np.pi * f * np.arange(n) * h + p)
        for f, p in zip((0.7, 1.9, 4.3), rng.uniform(0, 6, 3), strict=True)
    )
    force, x, v, y, w, position = 120.0 * swept, 0.0, 0.0, 0.0, 0.0, np.empty(n)
    for k in range(n):
        position[k] = x
        for _ in range(fine):
            twist = x - y
            beyond = max(abs(twist) - 0.011, 0.0) * np.sign(twist)
            passed = 12_000.0 * beyond + 420.0 * (v - w) if beyond else 0.0
            v += h / fine * (force[k] - 100.0 * v - passed) / (0.55 * 26.0)
            w += h / fine * passed / (0.45 * 26.0)
            x, y = x + h / fine * v, y + h / fine * w
    record = Record(
        {"force": force, "position": position + 5e-4 * rng.normal(size=n)},
        {"force": "N", "position": "m"},
        h,
    )
    found = explain(
        read_model(BELT), [record], effects=["backlash", "elastic-transmission", "coulomb-friction"]
    )
    assert list(found.accepted) == [("backlash", "belt")]
    assert abs(found.candidates[0].parameters["gap"].value - 0.022) < 1e-3
