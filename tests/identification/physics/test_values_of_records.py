"""`per: record`: a value that each record has for itself, beside the values that all have in common."""

import numpy as np
import pytest

import residuum as rs
from residuum.identification.errors import BadInput, BadModel
from residuum.identification.physics import Experiment, estimate, read_model
from residuum.identification.physics.export import explicit
from residuum.identification.physics.files.model_file import write_model
from residuum.identification.physics.simulate.simulation import Simulator

AXIS = """
name: axis
inputs: {u: N}
states: {v: {unit: m/s}}
parameters:
  m: {value: 2.5, unit: kg, lower: 0.1}
  d: {value: 0.6, unit: N*s/m, lower: 0}
  load: {value: 0.2, unit: N, per: record}
balances: {axis: {kind: force, storage: m * der(v), terms: {u: u, d: -d * v, load: -load}, velocity: v}}
outputs: {v: {value: v, unit: m/s}}
"""
TRUE = {"m": 3.0, "d": 0.8}


def experiments(loads, seed, n=200):
    """By the exact step of the linear equation, in plain NumPy."""
    rng, dt = np.random.default_rng(seed), 0.05
    a = np.exp(-TRUE["d"] / TRUE["m"] * dt)
    made = []
    for load in loads:
        u, v = np.repeat(rng.normal(size=n // 10) * 3.0, 10), np.zeros(n)
        v[0] = rng.normal()
        for k in range(n - 1):
            v[k + 1] = a * v[k] + (1 - a) / TRUE["d"] * (u[k] - load)
        made.append(
            Experiment(u[:, None], (v + 0.05 * rng.normal(size=n))[:, None], np.zeros(1), dt)
        )
    return made


def test_values_of_records_and_those_in_common_are_recovered_with_bands_that_cover():
    """40 times three records: of 5 values each, a band of two standard deviations covers 95 %."""
    model, inside = read_model(AXIS), []
    for seed in range(40):
        loads = np.random.default_rng(1000 + seed).normal(size=3)
        fit = estimate(model, experiments(loads, seed))
        values, stds = fit.of_records["load"]
        inside += list(abs(values - loads) < 1.96 * stds)
        inside += list(abs(fit.theta - [TRUE[name] for name in fit.parameters]) < 1.96 * fit.std)
    # of 200, the binomial distribution has 95 % of its chances from 183 to 196
    assert 182 <= sum(inside) <= 197


def test_one_record_is_as_if_the_value_were_a_common_one():
    one = experiments([0.7], 3)
    fit = estimate(read_model(AXIS), one)
    common = estimate(read_model(AXIS.replace(", per: record", "")), one)
    (value,), (std,) = fit.of_records["load"]
    k = common.parameters.index("load")
    assert value == pytest.approx(common.theta[k], abs=1e-5)
    assert std == pytest.approx(common.std[k], rel=1e-3)


def test_a_simulation_begins_at_the_declared_value():
    (one,) = experiments([0.0], 1)
    of_record = Simulator(read_model(AXIS)).run(one)
    common = Simulator(read_model(AXIS.replace(", per: record", ""))).run(one)
    np.testing.assert_allclose(of_record.Y, common.Y, rtol=1e-12)


def test_the_answer_tells_each_record(tmp_path):
    records = [
        rs.from_arrays(
            {"u": e.U[:, 0], "v": e.Y[:, 0]}, sample_time=0.05, units={"u": "N", "v": "m/s"}
        )
        for e in experiments([0.5, -0.5], 2)
    ]
    answer = rs.model(AXIS).estimate(records)
    told = answer.to_dict()["per_record"]["load"]
    assert told["values"] == pytest.approx([0.5, -0.5], abs=0.1) and told["unit"] == "N"
    assert str(answer).count("load of record = ") == 2


@pytest.mark.parametrize("method", ["prediction", "kalman"])
def test_other_methods_say_that_they_find_none(method):
    (one,) = experiments([0.5], 2)
    record = rs.from_arrays(
        {"u": one.U[:, 0], "v": one.Y[:, 0]}, sample_time=0.05, units={"u": "N", "v": "m/s"}
    )
    with pytest.raises(BadInput, match="'load' has one for each; say method='simulation'"):
        rs.model(AXIS).estimate(record, method=method)


def test_what_is_written_keeps_it_and_no_export_hides_it():
    model = read_model(AXIS)
    again = read_model(write_model(model))
    assert again.states["load"].of_record == model.states["load"].of_record
    assert "load" not in again.parameters and list(again.balances) == ["axis"]
    with pytest.raises(BadModel, match="'load' has a value for each record, which no export holds"):
        explicit(model)


def test_a_part_can_be_given_a_value_for_each_record():
    model = read_model(
        "name: fan\nuse: {motor: dc-motor}\nparameters: {motor_d: {per: record}}\n"
        "outputs: {speed: {value: motor_speed, unit: rad/s}}\n"
    )
    assert "motor_d" not in model.parameters
    assert model.states["motor_d"].of_record.unit == "N*m*s/rad"


@pytest.mark.parametrize(
    ("of_load", "says"),
    [
        ("per: batch", "per is 'batch'; must be 'record'"),
        ("per: record, lower: 0", "neither bounds nor a prior hold; leave out 'lower'"),
        ("per: record, fixed: true", "leave out 'fixed'"),
    ],
)
def test_what_a_value_of_records_cannot_have_is_refused(of_load, says):
    with pytest.raises(BadModel, match=f"line 8, .*parameter 'load': .*{says}"):
        read_model(AXIS.replace("per: record", of_load))
    with pytest.raises(BadModel, match="leave out the ±"):
        read_model(AXIS.replace("value: 0.2,", "value: 0.2 ± 0.1,"))
