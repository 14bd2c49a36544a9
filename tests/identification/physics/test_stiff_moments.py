"""A stiff part that is met for moments only: a relief valve that opens at the top of a level's range."""

import numpy as np
from scipy.integrate import solve_ivp

from residuum.identification.physics import Simulator, estimate, match, read_model
from residuum.identification.record import Record

VESSEL = """name: vessel
inputs: {pump: V}
states: {h: {unit: m}}
parameters: {k: {value: 0.05, unit: m/s/V, fixed: true}, c: {value: 0.05, unit: 1/s, fixed: true},
  v: {value: 11, unit: 1/s, fixed: true}, rim: {value: 6, unit: m, fixed: true}}
balances: {vessel: {kind: volume, storage: der(h), terms: {in: k * pump, out: -c * h, valve: '-v * max(h - rim, 0)'}, level: h}}
outputs: {level: {value: h, unit: m}}
"""


def vessel():
    """1000 samples of 4 s from 5 m on; the valve is open in one step of the pump alone."""
    rng = np.random.default_rng(4)
    pump = np.repeat(rng.uniform(1.0, 5.5, 50), 20)
    pump[600:606] = 12.0
    h, level = 5.0, np.empty(pump.size)
    for k, u in enumerate(pump):
        level[k] = h
        h = solve_ivp(
            lambda _, h, u=u: 0.05 * u - 0.05 * h - 11.0 * np.maximum(h - 6.0, 0.0),
            (0, 4),
            [h],
            method="LSODA",
        ).y[0, -1]
    assert np.mean(level > 6.0) < 0.01
    return Record({"pump": pump, "level": level}, {"pump": "V", "level": "m"}, 4.0)


def test_steps_are_fine_enough_for_a_valve_that_is_open_for_moments():
    model, (experiment,) = match(read_model(VESSEL), [vessel()])
    simulator = Simulator(model)
    (steps,) = simulator.modal_substeps([experiment], [np.array([5.0])], simulator.p())
    assert steps > 10
    run = simulator.run_vectors(experiment, np.array([5.0]), simulator.p(), substeps=steps)
    assert np.max(np.abs(run.Y - experiment.Y)) < 0.05


def test_an_estimate_whose_first_run_never_opens_the_valve_follows_it():
    """With four times the outflow the level stays below the rim."""
    model, experiments = match(
        read_model(
            VESSEL.replace("c: {value: 0.05", "c: {value: 0.2").replace(
                "1/s, fixed: true},\n", "1/s},\n"
            )
        ),
        [vessel()],
    )
    found = estimate(model, experiments)
    assert abs(found.model.values["c"] - 0.05) < 1e-3
    assert found.rmse[0] < 0.02
    assert found.substeps[0] > 10


def test_a_model_without_states_takes_single_steps():
    coil = """name: coil
inputs: {u: V}
parameters: {R: {value: 200, unit: ohm}}
balances: {winding: {kind: voltage, storage: 0, terms: {supply: u, drop: -R * i}, current: i}}
outputs: {current: {value: i, unit: A}}
"""
    u = np.linspace(0.0, 10.0, 200)
    model, experiments = match(
        read_model(coil), [Record({"u": u, "current": u / 150}, {"u": "V", "current": "A"}, 0.01)]
    )
    simulator = Simulator(model)
    assert simulator.modal_substeps(experiments, [np.zeros(0)], simulator.p()) == [1]
    assert abs(estimate(model, experiments).model.values["R"] - 150.0) < 1e-6
