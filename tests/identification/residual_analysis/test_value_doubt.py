"""Values beside slow noise: what likelier ones would take away is no structure, what wrong ones leave is."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.identification.physics import estimate, match, read_model
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.residual_analysis.value_doubt import at_likeliest_values

FURNACE = """name: furnace
inputs: {heater: W}
states: {T: {unit: K}}
parameters: {C: {value: 50, unit: J/K, lower: 10}, h: {value: 4, unit: W/K, lower: 0}, T_a: {value: 290, unit: K, fixed: true}}
balances: {wall: {kind: heat, storage: C * der(T), terms: {heater: heater, loss: -h * (T - T_a)}, temperature: T, ambient: T_a}}
outputs: {temperature: {value: T, unit: K}}
"""


def furnace(seed, rho):
    """2400 s of a complete furnace, exact between the samples, read each second; and the noise of .3 K beside it."""
    rng = np.random.default_rng(seed)
    heater = np.repeat(rng.uniform(0.0, 2000.0, 40), 60)
    kept = np.exp(-4.0 / 50.0)
    after = (1.0 - kept) * (290.0 + heater / 4.0)
    temperature = lfilter([1.0], [1.0, -kept], np.r_[300.0, after[:-1]])
    noise = (
        0.3 * lfilter([np.sqrt(1 - rho**2)], [1, -rho], rng.normal(size=heater.size + 3000))[3000:]
    )
    return Record(
        {"heater": heater, "temperature": temperature + noise},
        {"heater": "W", "temperature": "K"},
        1.0,
    ), noise


def innovations(error):
    return error[1:] - 0.99 * error[:-1]


def test_the_likeliest_values_leave_the_noise_where_those_of_least_squares_do_not():
    """As the innovations of the noise see it: there the test looks."""
    raw, likelier = 0.0, 0.0
    for seed in range(6):
        record, noise = furnace(seed, 0.99)
        model, experiments = match(read_model(FURNACE), [record])
        found = estimate(model, experiments)
        simulation = estimate(found.model, experiments, free=())
        (left,) = at_likeliest_values(found.model, experiments, simulation)
        raw += innovations(simulation.residuals[0][:, 0] - noise) @ innovations(
            simulation.residuals[0][:, 0] - noise
        )
        likelier += innovations(left[:, 0] - noise) @ innovations(left[:, 0] - noise)
    assert likelier < 0.5 * raw


@pytest.mark.parametrize("rho", [0.9, 0.99])
def test_an_estimated_complete_model_is_called_adequate_beside_slow_noise(rho):
    called = 0
    for seed in range(12):
        record, _ = furnace(seed, rho)
        model, experiments = match(read_model(FURNACE), [record])
        called += compare(estimate(model, experiments).model, [record]).present
    assert called <= 1


def test_values_beyond_their_doubt_stay_structure():
    record, _ = furnace(3, 0.9)
    model, experiments = match(read_model(FURNACE), [record])
    wrong = estimate(model, experiments).model.with_values({"h": 4.6})
    assert compare(wrong, [record]).present
    simulation = estimate(wrong, experiments, free=())
    (left,) = at_likeliest_values(wrong, experiments, simulation)
    assert np.sqrt(np.mean(left**2)) > 0.9 * np.sqrt(np.mean(simulation.residuals[0] ** 2))


def test_a_model_without_states_or_free_values_is_compared_as_it_is():
    coil = """name: coil
inputs: {u: V}
parameters: {R: {value: 200, unit: ohm, fixed: true}}
balances: {winding: {kind: voltage, storage: 0, terms: {supply: u, drop: -R * i}, current: i}}
outputs: {current: {value: i, unit: A}}
"""
    rng = np.random.default_rng(8)
    u = np.repeat(rng.uniform(0.0, 10.0, 40), 50)
    record = Record(
        {"u": u, "current": u / 200 + 1e-4 * rng.normal(size=u.size)},
        {"u": "V", "current": "A"},
        0.01,
    )
    assert not compare(read_model(coil), [record]).present
