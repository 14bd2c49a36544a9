"""Error codes and still spans of sensors, drawn into records of a tank whose truth is known."""

import numpy as np
import pytest

import residuum as rs
from residuum.identification.physics import match, read_model
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.residual_analysis.odd_readings import far_beside, without_odd
from residuum.identification.work import Work, counted_as

TANK = """
name: tank
inputs: {power: W}
states: {T: {unit: degC}}
parameters:
  C: {value: 21000.0, unit: J/K, lower: 1}
  k: {value: 14.0, unit: W/K, lower: 0}
  T_room: {value: 20.0, unit: degC, fixed: true}
balances:
  heat: {kind: heat, storage: C * der(T), terms: {heater: power, loss: -k * (T - T_room)}}
outputs: {measured: {value: T, unit: degC}}
"""


def tank(seed, n=600):
    rng = np.random.default_rng(seed)
    power = np.repeat(rng.choice([0.0, 800.0], n // 40 + 1), 40)[:n]
    T = np.empty(n)
    T[0] = 20.0
    for k in range(n - 1):
        rest = 20 + power[k] / 14
        T[k + 1] = rest + (T[k] - rest) * np.exp(-10 * 14 / 21e3)
    return power, np.round((T + 0.05 * rng.standard_normal(n)) * 16) / 16, rng


def compared(power, y):
    record = Record(
        {"power": power, "measured": y}, {"power": "W", "measured": "degC"}, 10.0, source="tank.csv"
    )
    return compare(read_model(TANK), [record])


@pytest.mark.parametrize("seed", range(4))
def test_error_codes_are_named_and_left_out(seed):
    power, y, rng = tank(seed)
    codes = rng.choice([-127.0, 85.0, -999.9, 850.0], 2, replace=False)
    rows = np.sort(rng.choice(np.arange(5, 595, 3), 12, replace=False))
    y[rows] = np.tile(codes, 6)
    found = compared(power, y)
    assert found.outputs["measured"].rmse < 0.08 and not found.present
    (said,) = [text for text in found.warnings if "error code" in text]
    assert "12 samples" in said and all(f"'{code:.10g}'" in said for code in codes)


@pytest.mark.parametrize(
    ("rows", "code"),
    [
        (slice(200, 206), -127.0),
        (slice(200, 260), -999.9),
        (slice(596, 600), -32768.0),
        (slice(0, 4), 850.0),
        (slice(5, 595, 10), 6553.5),
    ],
    ids=["six on end", "a tenth on end", "at the end", "at the begin", "every tenth"],
)
def test_codes_on_end_and_often_are_left_out(rows, code):
    power, y, _ = tank(3)
    y[rows] = code
    found = compared(power, y)
    assert found.outputs["measured"].rmse < 0.08 and not found.present
    assert any(f"read {code:.10g} degC, an error code" in text for text in found.warnings)


@pytest.mark.parametrize("code", [-999.9, 6553.5, -32768.0, 8191.875, 5000.0])
def test_an_input_that_error_codes_drive_is_named(code):
    power, y, _ = tank(3)
    power[[50, 51, 52, 200, 400]] = code
    known = code != 5000.0  # a power, for all anybody knows
    said = [text for text in compared(power, y).warnings if "drive the model" in text]
    assert len(said) == known
    assert not known or (
        f"missing=['{code:.10g}']" in said[0]
        and "power: 5 samples (numbers 50, 51, 52, 200, 400)" in said[0]
    )


def test_one_reading_far_off_is_told_wherever_it_stands():
    for row in (0, 48, 599):
        power, y, _ = tank(3)
        y[row] = 85.0 if y[row] < 50 else -127.0
        assert any(
            f"1 single sample (number {row}) lies" in text for text in compared(power, y).warnings
        )


def test_spikes_that_differ_are_told_and_left_out():
    power, y, _ = tank(7)
    y[[50, 200, 333]] += [90.0, -77.0, 120.0]
    found = compared(power, y)
    assert found.outputs["measured"].rmse < 0.08 and not found.present
    (said,) = [
        text for text in found.warnings if "3 single samples (numbers 50, 200, 333) lie" in text
    ]
    assert "they are left out here" in said


def test_a_spike_that_the_model_has_too_stays():
    """An output that follows its input at once jumps with it for a sample."""
    resistor = """
name: resistor
inputs: {u: V}
states: {}
parameters: {R: {value: 2.0, unit: ohm}}
balances: {lead: {kind: voltage, storage: 0, terms: {supply: u, drop: -R * i}, current: i}}
outputs: {amps: {value: i, unit: A}}
"""
    rng = np.random.default_rng(3)
    u = 1.0 + 0.1 * rng.standard_normal(600)
    u[[50, 200, 333]] += [9.0, -7.7, 12.0]
    amps = u / 1.6 + 0.001 * rng.standard_normal(600)
    found = compare(
        read_model(resistor),
        [Record({"u": u, "amps": amps}, {"u": "V", "amps": "A"}, 0.1, source="leads.csv")],
    )
    assert found.present and found.outputs["amps"].rmse > 0.1


@pytest.mark.parametrize("where", [150, 180])
def test_a_noisy_reading_that_repeats_itself_is_held_wherever_it_goes_on(where):
    """Its noise tells: a machine that rests, and a reading in coarse steps, repeat values elsewhere, too."""
    power, _, rng = tank(5)
    T = tank(5)[1] + 0.0
    y = T + 0.05 * rng.standard_normal(600)
    y[where : where + 60] = y[where + 60]
    found = compared(power, y)
    assert [odd.held for odd in found.odd] == [((where, where + 60),)]
    coarse = np.round(y * 16) / 16
    assert not any(odd.held for odd in compared(power, coarse).odd)


@pytest.mark.parametrize("seed", range(3))
def test_a_span_that_stands_still_is_named(seed):
    power, y, rng = tank(seed)
    power[250:] = np.repeat([800.0, 0.0], 35)[np.arange(350) % 70]
    first = int(rng.integers(260, 500))
    _, y, _ = tank(seed)
    T = y.copy()
    for k in range(249, 599):
        rest = 20 + power[k] / 14
        T[k + 1] = rest + (T[k] - rest) * np.exp(-10 * 14 / 21e3)
    y = np.round(T * 16 + rng.standard_normal(600) * 0.8) / 16
    y[first : first + 60] = y[first]
    found = compared(power, y)
    spans = [span for odd in found.odd for span in odd.still]
    assert (
        len(spans) == 1 and abs(spans[0][0] - first) <= 2 and abs(spans[0][1] - (first + 59)) <= 2
    )
    assert any("stands still in samples" in text for text in found.warnings)


@pytest.mark.parametrize("seed", range(30))
def test_what_plants_do_is_not_odd(seed):
    rng = np.random.default_rng(seed)
    steps = np.repeat(rng.standard_normal(40), 25)
    slow = np.cumsum(rng.standard_normal(1000))
    binary = np.repeat(rng.integers(0, 2, 200), 5).astype(float)
    off = np.where(np.repeat(rng.random(50) < 0.2, 20), 0.0, 1450.0 + rng.standard_normal(1000))
    rest = np.r_[np.zeros(100), 1450.0 + rng.standard_normal(900)]
    noisy = steps + 0.01 * rng.standard_normal(1000)
    for y in (noisy, slow, binary, off, rest, rng.standard_normal(1000), rng.laplace(size=1000)):
        assert not far_beside(y)[0].size


def held_tank():
    """600 rows, 60 of which a sensor holds while the heater is on: the truth, and what was recorded."""
    power = np.repeat([800.0, 0.0], 35)[np.arange(600) % 70]
    T = np.full(600, 20.0)
    for k in range(599):
        rest = 20 + power[k] / 14
        T[k + 1] = rest + (T[k] - rest) * np.exp(-10 * 14 / 21e3)
    y = np.round(T * 16 + np.random.default_rng(5).standard_normal(600) * 0.8) / 16
    y[280:335] = y[280]
    return power, y


def test_a_held_span_is_left_out():
    found = compared(*held_tank())
    assert found.outputs["measured"].rmse < 0.08 and not found.present
    assert any("left out here" in text and "samples 280 to 33" in text for text in found.warnings)


def test_a_machine_that_sticks_is_no_sensor_that_held():
    """It goes on from where it stands: told, and left in, for it may be friction."""
    power, y = held_tank()
    y[335:] += y[334] - y[335]
    found = compared(power, y)
    assert not any("left out" in text for text in found.warnings)
    assert found.odd[0].still and not found.odd[0].held


def test_estimates_leave_out_what_no_sensor_measured():
    power, y = held_tank()
    y[10:250:20] = np.tile([-127.0, 85.0], 6)
    record = Record(
        {"power": power, "measured": y}, {"power": "W", "measured": "degC"}, 10.0, source="tank.csv"
    )
    found = rs.model(TANK.replace("value: 14.0", "value: 8.0")).estimate(record)
    assert found.model.parameters["k"].value == pytest.approx(14.0, abs=0.1)
    assert sum("left out here" in text for text in found.to_dict()["warnings"]) == 2


SHAFT = """
name: shaft
inputs: {torque: N*m}
states: {theta: {unit: rad, rate: omega}, omega: {unit: rad/s}}
parameters: {J: {value: 0.01, unit: kg*m**2}, b: {value: 0.02, unit: N*m*s/rad}}
balances:
  shaft: {kind: torque, storage: J * der(omega), terms: {drive: torque, drag: -b * omega}, position: theta, velocity: omega}
outputs: {angle: {value: theta, unit: rad}, speed: {value: omega, unit: rad/s}}
"""


def shaft(torque, breakaway=0.3):
    """A shaft that friction holds below its breakaway torque; encoder steps, for angle and speed."""
    angle, speed = np.zeros(len(torque)), np.zeros(len(torque))
    for k, drive in enumerate(torque[:-1]):
        w, theta = speed[k], angle[k]
        for _ in range(20):
            free = drive - 0.02 * w
            if w == 0.0 and abs(free) <= breakaway:
                break
            new = w + 5e-4 / 0.01 * (free - breakaway * (np.sign(w) or np.sign(free)))
            w = 0.0 if new * w < 0 else new
            theta += 5e-4 * w
        angle[k + 1], speed[k + 1] = theta, w
    return np.round(angle / 0.002) * 0.002, np.round(speed / 0.01) * 0.01


def shaft_compared(torque, angle, speed):
    channels = {"torque": torque, "angle": angle, "speed": speed}
    record = Record(
        channels, {"torque": "N*m", "angle": "rad", "speed": "rad/s"}, 0.01, source="shaft.csv"
    )
    return compare(read_model(SHAFT), [record])


@pytest.mark.parametrize("seed", range(4))
def test_a_shaft_that_friction_holds_is_no_sensor_that_held(seed):
    """It rests while its drive is below breakaway, and sets out by one step of the drive."""
    torque = np.repeat(
        np.random.default_rng(seed).choice([0.0, 0.1, -0.2, 0.25, 0.9, -0.9], 20), 60
    )
    angle, speed = shaft(torque)
    found = shaft_compared(torque, angle, speed)
    assert (speed == 0.0).sum() > 200 and not any("still" in text for text in found.warnings), (
        found.warnings
    )


def test_an_encoder_that_held_is_one_all_the_same():
    torque = np.repeat(np.random.default_rng(1).choice([0.5, 0.9, -0.9], 20), 60)
    angle, speed = shaft(torque)
    first = int(np.argmax(np.abs(speed) > 5)) + 200
    angle[first : first + 150], speed[first : first + 150] = angle[first], speed[first]
    found = shaft_compared(torque, angle, speed)
    assert any(odd.output == "angle" and odd.held for odd in found.odd)
    assert any(odd.output == "speed" and odd.still for odd in found.odd)


@pytest.mark.parametrize("rows", [2, 5, 12])
def test_what_a_thermometer_reads_before_its_first_conversion_is_left_out(rows):
    """Of 85 °C at the begin, for several rows, and in any unit of temperature; 85 of another quantity is a value."""
    power, y, _ = tank(3)
    y[:rows] = 85.0
    found = compared(power, y)
    assert found.outputs["measured"].rmse < 0.08 and not found.present
    assert any(
        f"{rows} samples (numbers 0, 1" in text and "read 85 degC, an error code" in text
        for text in found.warnings
    )
    assert far_beside(y + 273.15, "K")[1] == (358.15,)
    assert not far_beside(y, "rpm")[1] and not far_beside(y)[1]
    y[:rows], y[300 : 300 + rows] = 21.0, 85.0
    assert not far_beside(y, "degC")[1], "in the midst no thermometer is switched on"


@pytest.mark.parametrize(("odd", "left_out", "simulated"), [(None, 0, 0), (-127.0, 1, 1)])
def test_a_record_in_which_nothing_stands_out_is_not_simulated_for_it(odd, left_out, simulated):
    power, y, _ = tank(0)
    if odd is not None:
        y[300] = odd
    channels, units = {"power": power, "measured": y}, {"power": "W", "measured": "degC"}
    model, experiments = match(read_model(TANK), [Record(channels, units, 10.0)])
    with counted_as(Work()) as work:
        without, _ = without_odd(model, experiments)
    assert np.isnan(without[0].Y).sum() == left_out
    assert work.fits == simulated
