"""What was known before: θ is drawn from its prior, and bands, values and files have to know it."""

from types import SimpleNamespace

import numpy as np
import pytest

import residuum as rs
from residuum.identification.errors import BadModel
from residuum.identification.physics import (
    Experiment,
    Simulator,
    estimate,
    estimate_by_likelihood,
    read_model,
    with_coloured_noise,
)
from residuum.identification.physics.effects.base import Prior
from residuum.identification.physics.estimation.gauss_newton import Cells, Problem
from residuum.identification.physics.files.model_file import write_model

FLYWHEEL = """
name: flywheel
inputs: {torque: N*m}
states: {w: {unit: rad/s}}
parameters: {J: {value: 0.07 ± 0.01, unit: kg*m**2}, d: {value: 0.05 +- 0.01, unit: N*m*s/rad}}
balances: {shaft: {kind: torque, storage: J * der(w), terms: {drive: torque, drag: -d * w}, velocity: w}}
outputs: {speed: {value: w, unit: rad/s}}
initial: {w: 0}
"""
KNOWN = {"J": Prior(0.07, 0.01), "d": Prior(0.05, 0.01)}


def measured(J, d, noise, seed, n=100, step=0.05):
    """The exact solution of J·dw/dt = u − d·w for a torque held over each sample, with white noise."""
    rng = np.random.default_rng(seed)
    u, w, seen = np.repeat(rng.uniform(-1.0, 1.0, n // 10), 10), 0.0, []
    for torque in u:
        seen.append(w)
        w = w * np.exp(-d / J * step) + torque / d * (1.0 - np.exp(-d / J * step))
    return u, np.array(seen) + noise * rng.standard_normal(n)


def experiment(u, y):
    return Experiment(u[:, None], y[:, None], np.zeros(1), 0.05)


def test_both_spellings_are_read_and_a_written_model_keeps_them():
    model = read_model(FLYWHEEL)
    assert {name: p.prior for name, p in model.parameters.items()} == KNOWN
    assert model.values == {"J": 0.07, "d": 0.05}
    again = read_model(write_model(model.with_values({"J": 0.075})))
    assert (
        again.values["J"] == 0.075
        and {name: p.prior for name, p in again.parameters.items()} == KNOWN
    )


def test_an_effect_s_parameter_has_a_prior_too():
    effect = "effects: [{id: coulomb-friction, balance: shaft, parameters: {tau_c: 0.1 ± 0.02}}]"
    model = read_model(FLYWHEEL + effect)
    assert read_model(write_model(model)).all_parameters[
        "coulomb-friction@shaft.tau_c"
    ].prior == Prior(0.1, 0.02)


def test_bands_cover_what_is_drawn_from_the_prior_as_often_as_they_say():
    """Noise so large that prior and data know about as much."""
    model, rng, inside, gained = read_model(FLYWHEEL), np.random.default_rng(3), [], []
    for seed in range(300):
        truth = np.array([rng.normal(0.07, 0.01), rng.normal(0.05, 0.01)])
        given = [experiment(*measured(*truth, noise=3.0, seed=seed))]
        found = with_coloured_noise(estimate(model, given), given)
        inside.append(np.abs(found.theta - truth) < 1.96 * found.std)
        gained.append(found.std / [0.01, 0.01])
    assert np.all(np.median(gained, axis=0) < 0.8) and np.all(np.median(gained, axis=0) > 0.2)
    assert 0.93 <= np.mean(inside) <= 0.97


@pytest.mark.parametrize("way", [estimate, estimate_by_likelihood])
def test_the_estimate_lies_between_prior_and_data_by_their_precisions(way):
    u, y = measured(0.09, 0.05, noise=1.0, seed=1)
    loose = FLYWHEEL.replace("0.07 ± 0.01", "0.07").replace("0.05 +- 0.01, ", "0.05, fixed: true, ")
    held = FLYWHEEL.replace("0.05 +- 0.01, ", "0.05, fixed: true, ")
    alone, both = (way(read_model(text), [experiment(u, y)]) for text in (loose, held))
    data, before = 1.0 / alone.std[0] ** 2, 1.0 / 0.01**2
    assert both.theta[0] == pytest.approx(
        (data * alone.theta[0] + before * 0.07) / (data + before), abs=0.3 * both.std[0]
    )
    assert both.std[0] == pytest.approx((data + before) ** -0.5, rel=0.15)


def test_the_search_fits_with_the_same_prior():
    model, e = read_model(FLYWHEEL), experiment(*measured(0.09, 0.05, noise=1.0, seed=1))
    whole = estimate(model, [e])
    unit = SimpleNamespace(
        weights=whole.weights, clip=np.array([np.inf]), filters=None, variance=1.0
    )
    begun = Problem.of(Simulator(model), Cells.of([e]), unit, [1]).begin(np.zeros((1, 1)))
    found = begun.descended(20, 1e-12)
    assert found.theta == pytest.approx(whole.theta, rel=1e-4) and found.std == pytest.approx(
        whole.std, rel=0.02
    )


def test_estimate_tells_the_prior_and_warns_where_the_data_speak_against_it():
    def asked(J):
        u, y = measured(J, 0.05, noise=0.05, seed=2)
        record = rs.Record({"torque": u, "speed": y}, {"torque": "N*m", "speed": "rad/s"}, 0.05)
        return rs.model(FLYWHEEL).estimate(record, hold="zero-order")

    good, bad = asked(0.075), asked(0.15)
    assert good.parameters["J"]["prior"] == {
        "value": 0.07,
        "std": 0.01,
    } and "(prior 0.07 ± 0.01)" in str(good)
    assert not any("prior" in line for line in good.to_dict()["warnings"])
    (line,) = (line for line in bad.to_dict()["warnings"] if "prior" in line)
    assert "J = 0.1498" in line and "0.07 ± 0.01" in line and "d =" not in line


@pytest.mark.parametrize(
    ("new", "says"),
    [
        ("0.07 ± 0", "must be positive"),
        ("0.07 ± wide", "standard deviation is 'wide'"),
        ("0.07 ± 0.01, prior: 0.07 ± 0.01", "only one may be"),
        ("0.07, prior: 0.07", "its standard deviation"),
    ],
)
def test_refusals_say_what_and_where(new, says):
    with pytest.raises(BadModel, match=r"line 5, column \d+: parameter 'J'.*" + says):
        read_model(FLYWHEEL.replace("0.07 ± 0.01", new))
