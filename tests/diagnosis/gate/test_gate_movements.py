"""Cutting, modelling and judging the usability of movements of the gate."""

from dataclasses import replace

import numpy as np
import pytest

from residuum.diagnosis.diagnosers.gate_actuator import example_record
from residuum.diagnosis.gate.actuator_model import (
    ActuatorConstants,
    adapt,
    delayed,
    first_order_response,
    from_data_sheet,
)
from residuum.diagnosis.gate.movements import Direction, Movement, cut_movements, flat_part
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.record import Record


def joined(*records, pause=1.0):
    """Records one after the other, with a pause (zeros, phase 0) around each."""
    Ts = records[0].sample_time
    still = np.zeros(round(pause / Ts))
    channels = {
        name: np.concatenate(
            [still, *(part for record in records for part in (record[name], still))]
        )
        for name in records[0].names
    }
    return Record(channels, records[0].units, Ts)


def noise_free(T=0.05, gain=14.0, load=20.0, delay=0.0, Ts=1e-3):
    t = np.arange(round(8.0 / Ts)) * Ts
    voltage = 30.0 * np.clip(np.minimum(t, 8.0 - t), 0.0, 1.0)
    speed = first_order_response(np.maximum(gain * delayed(voltage, delay, Ts) - load, 0.0), T, Ts)
    return Movement(Direction.OPENING, Ts, speed, voltage)


def test_cuts_opening_and_closing_by_the_phase_and_turns_both_forward():
    opening, closing = example_record("healthy", 0), example_record("healthy", 1)
    movements = cut_movements(joined(opening, closing))
    assert [movement.direction for movement in movements] == ["opening", "closing"]
    assert [movement.n for movement in movements] == [opening.n, closing.n]
    assert all(
        np.mean(movement.speed) > 300 and np.mean(movement.voltage) > 20 for movement in movements
    )


def test_without_a_phase_the_sign_of_the_voltage_tells():
    record = joined(example_record("healthy", 0), example_record("healthy", 1)).select(
        ["speed", "voltage"]
    )
    with_phase = cut_movements(joined(example_record("healthy", 0), example_record("healthy", 1)))
    without = cut_movements(record)
    assert [m.direction for m in without] == [m.direction for m in with_phase]
    assert all(
        abs(a.n - b.n) * record.sample_time < 0.2 for a, b in zip(without, with_phase, strict=True)
    )


def test_units_are_converted():
    record = example_record("healthy", 0)
    channels = dict(record.channels) | {"speed": record["speed"] * 60 / (2 * np.pi)}
    in_rpm = Record(channels, dict(record.units) | {"speed": "rpm"}, record.sample_time)
    np.testing.assert_allclose(
        cut_movements(in_rpm)[0].speed, cut_movements(record)[0].speed, rtol=1e-12
    )


def test_flat_part_lies_between_the_ramps():
    flat, level = flat_part(noise_free())
    assert level == pytest.approx(30.0)
    assert flat.start * 1e-3 == pytest.approx(0.95, abs=0.05) and flat.stop * 1e-3 == pytest.approx(
        7.05, abs=0.05
    )


def test_reduction_keeps_slow_signals_and_removes_the_ripple():
    movement = noise_free(Ts=2e-4)
    rippled = replace(
        movement,
        voltage=movement.voltage + 2.0 * np.sin(2 * np.pi * 100 * np.arange(movement.n) * 2e-4),
    )
    reduced = rippled.reduced(100.0)
    assert reduced.sample_time == pytest.approx(0.01)
    np.testing.assert_allclose(reduced.voltage[150:650], 30.0, atol=0.05)


def test_adaptation_recovers_gain_time_constant_and_load_of_another_exemplar():
    model = adapt([noise_free(T=0.061, gain=13.2, load=26.0)])
    assert model.gain == pytest.approx(13.2, rel=2e-3)
    assert model.time_constant + model.delay == pytest.approx(0.061, rel=0.03)
    assert model.load[0] == pytest.approx(26.0, abs=0.5)
    residual = model.residual(noise_free(T=0.061, gain=13.2, load=26.0))
    assert np.sqrt(np.mean(residual[1500:6500] ** 2)) < 0.1


def test_load_that_grows_along_the_gate_is_found():
    movement = noise_free()
    x = movement.motor_angle / movement.motor_angle[-1]
    speed = first_order_response(
        np.maximum(14.0 * movement.voltage - 20.0 - 9.0 * x, 0.0), 0.05, 1e-3
    )
    model = adapt([replace(movement, speed=speed)])
    assert model.load[0] + model.load[1] + model.load[2] == pytest.approx(29.0, abs=1.0)
    assert model.load[0] == pytest.approx(20.0, abs=1.0)


def test_a_movement_without_ramps_cannot_adapt_the_model():
    movement = noise_free()
    with pytest.raises(NotIdentifiable, match="ramps"):
        adapt(
            [
                replace(
                    movement, speed=movement.speed[2000:6000], voltage=movement.voltage[2000:6000]
                )
            ]
        )


def test_data_sheet_model_has_the_constants_of_the_source():
    model = from_data_sheet(ActuatorConstants())
    assert model.gain == pytest.approx(1 / 0.0696)
    # F_L = m g 3e-4 = 1.79 N acts through τ̄ R/K²: 0.18 rad/s of 429.
    assert model.load[0] == pytest.approx(1.79 * 0.028 / 44 * 0.7473 / 0.0696**2, rel=0.01)


def test_constants_that_are_not_positive_are_refused():
    with pytest.raises(BadInput, match="gear_teeth: is 0"):
        ActuatorConstants(gear_teeth=0)
