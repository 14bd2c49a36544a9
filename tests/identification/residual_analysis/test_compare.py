"""Comparing the gate drive with records of a simulated one: a true model, wrong friction, coloured noise."""

import numpy as np
import pytest

from residuum.identification.errors import BadRecord
from residuum.identification.physics import load_model, read_model
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.residual_analysis.noise import noise_floor
from residuum.library.answers.comparison import comparison_text
from residuum.simulation.gate_drive import GateDrive

MODEL = load_model("gate-drive")


def record(**settings):
    signals = GateDrive(seed=3, deviation=0.0, **settings).simulate(12.0)
    return Record(signals.channels, signals.units, signals.sample_time)


@pytest.fixture(scope="module")
def with_friction():
    return compare(MODEL, [record(effects={"coulomb-friction": "medium"}, profile="rich")])


def test_a_true_model_has_only_noise_even_when_the_noise_is_coloured():
    found = compare(MODEL, [record(noise_color=0.9, profile="rich")])
    assert found.p_value > 0.01 and found.where == ()
    for name, output in found.outputs.items():
        assert output.noise_floor == pytest.approx(output.rmse, rel=0.05), name
        assert output.fit_percent > 90


def test_a_missing_friction_is_seen_and_sized(with_friction):
    assert with_friction.p_value < 1e-6 and with_friction.share > 0.5
    speed = with_friction.outputs["speed"]
    assert speed.rmse > 3 * speed.noise_floor
    assert speed.k_step[1] < speed.k_step[100] < 3 * speed.rmse
    assert (
        with_friction.balances["shaft"].relative_percent
        > 2 * with_friction.balances["winding"].relative_percent
    )


def test_the_missing_term_draws_the_friction_curve(with_friction):
    smoothed = with_friction.smoothed[0]
    speed = smoothed.X[:, 1]
    term = smoothed.missing["shaft"]
    running = np.abs(speed) > 30
    true = -0.02 * np.sign(speed[running])  # the simulated drive's medium Coulomb friction [N·m]
    assert np.corrcoef(term.value[running], true)[0, 1] > 0.9
    assert np.mean(term.value[running] * np.sign(true)) == pytest.approx(0.02, rel=0.2)


def test_it_says_where(with_friction):
    assert with_friction.where
    scores = [region.score for region in with_friction.where]
    assert scores == sorted(scores, reverse=True)
    assert all(region.times_noise > 1 and 0 < region.share <= 1 for region in with_friction.where)


def test_a_resonance_beside_its_place_is_no_noise():
    """The error of a stiffness that is 8 % off rings as noise through the same resonance would."""
    n, h, rng = 3000, 0.005, np.random.default_rng(1)
    force = np.repeat(rng.normal(0.0, 50.0, n // 10), 10)
    x, v, seen = 0.0, 0.0, np.zeros(n)
    for k in range(n):
        seen[k] = x
        for _ in range(20):
            v += h / 20 * (force[k] - 4000.0 * x - 8.0 * v) / 2.0
            x += h / 20 * v
    noise = 2e-5 * rng.standard_normal(n)
    text = """name: rig
inputs: {force: N}
states: {x: {unit: m, rate: v}, v: {unit: m/s}}
parameters: {M: {value: 2, unit: kg, fixed: true}, d: {value: 8, unit: N*s/m, lower: 0}, k: {value: 4320, unit: N/m, lower: 0}}
balances:
  mass: {kind: force, storage: M * der(v), terms: {shaker: force, spring: -k * x, damper: -d * v}, position: x, velocity: v}
outputs: {x: {value: x, unit: m}}
"""
    found = compare(
        read_model(text), [Record({"force": force, "x": seen + noise}, {"force": "N", "x": "m"}, h)]
    )
    assert found.p_value < 1e-4 and found.share > 0.9
    assert found.outputs["x"].rmse > 5 * found.outputs["x"].noise_floor


def test_a_slow_error_that_dwarfs_the_noise_is_structured():
    """A swinging arm pushed by what its model does not know: noise that is integrated would explain any such error."""
    n, h, rng = 3000, 0.005, np.random.default_rng(4)
    torque = np.repeat(rng.normal(0.0, 3.0, n // 100), 100)
    shaken = 0.8 * np.sign(np.sin(2 * np.pi * np.arange(n) * h / 2.7))
    x, v, seen = 0.3, 0.0, np.zeros(n)
    for k in range(n):
        seen[k] = x
        for _ in range(10):
            v += h / 10 * (torque[k] + shaken[k] - 7.0 * np.sin(x) - 0.5 * v) / 0.9
            x += h / 10 * v
    text = """name: arm
inputs: {torque: N*m}
states: {x: {unit: rad, rate: v}, v: {unit: rad/s}}
parameters: {J: {value: 0.9, unit: kg*m**2}, d: {value: 0.5, unit: N*m*s/rad}, w: {value: 7, unit: N*m}}
balances:
  joint: {kind: torque, storage: J * der(v), terms: {in: torque, weight: -w * sin(x), damper: -d * v}, position: x, velocity: v}
outputs: {x: {value: x, unit: rad}}
"""
    noise = 0.002 * rng.standard_normal(n)
    found = compare(
        read_model(text),
        [Record({"torque": torque, "x": seen + noise}, {"torque": "N*m", "x": "rad"}, h)],
    )
    assert found.p_value < 0.01 and found.share > 0.9 and found.where
    assert found.outputs["x"].rmse > 10 * found.outputs["x"].noise_floor


def test_a_record_without_the_input_is_refused():
    with pytest.raises(BadRecord, match="input 'voltage' is missing"):
        compare(MODEL, [record(profile="rich").select(["speed", "current"])])


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_noise_floor_reads_coloured_noise_under_a_slow_error(rho):
    rng = np.random.default_rng(5)
    v = np.zeros(20_000)
    e = rng.normal(size=v.size)
    for k in range(1, v.size):
        v[k] = rho * v[k - 1] + np.sqrt(1 - rho**2) * e[k]
    slow = 10 * np.sin(2 * np.pi * np.arange(v.size) / 4000)
    assert noise_floor([v + slow]) == pytest.approx(1.0, rel=0.15)


def test_a_signal_may_rest_in_one_record_of_several():
    """A drive that is moved, and one that coasts unpowered: no signal's columns are missing where it is zero throughout."""
    powered = record(profile="rich")
    speed = 50.0 * np.exp(-np.arange(3000) * 0.002 / 0.05) + 0.3 * np.random.default_rng(
        5
    ).standard_normal(3000)
    coasting = Record(
        {"voltage": np.zeros(3000), "speed": speed}, {"voltage": "V", "speed": "rad/s"}, 0.002
    )
    both = [
        Record(
            {n: powered.channels[n] for n in ("voltage", "speed")},
            coasting.units,
            powered.sample_time,
        ),
        coasting,
    ]
    assert compare(MODEL, both).structured


STAGE = """name: stage
inputs: {force: N}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters: {M: {value: 8.9, unit: kg, fixed: true}, d: {value: 60, unit: N*s/m, fixed: true}}
balances: {axis: {kind: force, storage: M * der(v), terms: {drive: force, guide: -d * v}, position: q, velocity: v}}
outputs: {position: {value: q, unit: m}, velocity: {value: v, unit: m/s}}
"""


@pytest.mark.parametrize("damping", [60.0, 90.0])
def test_a_controller_that_answers_the_noise_is_no_structure_and_does_not_hide_any(damping):
    """What it does in a sample knows the noise of that sample; the model is right at 60 N·s/m."""
    rng, n, h, sigma = np.random.default_rng(5), 12_000, 2e-3, np.array([6e-4, 5e-3])
    course = (
        np.cumsum(np.concatenate([np.full(400, rng.uniform(-0.25, 0.25)) for _ in range(n // 400)]))
        * h
    )
    q, v, force, shown = 0.0, 0.0, np.empty(n), np.empty((n, 2))
    noise = sigma * rng.normal(size=(n, 2))
    for k in range(n):
        shown[k] = [q, v] + noise[k]
        force[k] = 4000.0 * (course[k] - shown[k, 0]) - 250.0 * shown[k, 1]
        for _ in range(20):
            v += h / 20 * (force[k] - damping * v) / 8.9
            q += h / 20 * v
    record = Record(
        {"force": force, "position": shown[:, 0], "velocity": shown[:, 1]},
        {"force": "N", "position": "m", "velocity": "m/s"},
        h,
    )
    found = compare(read_model(STAGE), [record])
    assert found.structured["velocity"].present == (damping != 60.0)
    if damping == 60.0:
        np.testing.assert_allclose(
            [o.noise_floor for o in found.outputs.values()], sigma, rtol=0.05
        )


def test_an_error_that_is_all_bias_and_slow_is_structured_and_no_noise():
    """A force that is always 12 N more than recorded: noise in no hurry would explain that."""
    rng, n, h = np.random.default_rng(2), 6000, 0.1
    force, v, speed = np.repeat(rng.uniform(-300.0, 600.0, n // 100), 100), 0.0, np.empty(n)
    for k in range(n):
        speed[k] = v
        for _ in range(10):
            v += h / 10 * (force[k] + 12.0 - 40.0 * v) / 900.0
    body = STAGE.replace("M: {value: 8.9", "M: {value: 900").replace(
        "d: {value: 60", "d: {value: 40"
    )
    body = body.replace("  position: {value: q, unit: m}\n", "").replace(
        "position: {value: q, unit: m}, ", ""
    )
    record = Record(
        {"force": force, "velocity": speed + 0.2 * rng.normal(size=n)},
        {"force": "N", "velocity": "m/s"},
        h,
    )
    found = compare(read_model(body), [record])
    assert found.structured["velocity"].present
    assert found.outputs["velocity"].noise_floor == pytest.approx(0.2, rel=0.05)


def test_a_record_too_short_for_the_test_is_not_called_noise(with_friction):
    short = compare(
        MODEL, [record(effects={"coulomb-friction": "medium"}, profile="rich").window(0, 20)]
    )
    assert not short.structured and not short.present and short.p_value == 1.0
    assert "not told; the records are too short" in comparison_text(short)
    assert "structured error: yes" in comparison_text(with_friction)
