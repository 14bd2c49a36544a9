"""One compiled pass says what the estimator's simulations and products say, and its folds what refits without them leave."""

from dataclasses import replace

import numpy as np
import pytest

from residuum.identification.physics import (
    Experiment,
    Settings,
    Simulator,
    estimate,
    read_model,
    windows,
)
from residuum.identification.physics.estimation.estimation import SimulationErrorProblem
from residuum.identification.physics.estimation.gauss_newton import Cells, Problem, eliminated
from residuum.identification.unseen_blocks.scale import Scale

DRIVE = """
name: drive
inputs: {voltage: V}
states: {q: {unit: rad, rate: v}, v: {unit: rad/s}}
parameters:
  J: {value: 0.02, unit: kg*m**2, lower: 1e-4}
  d: {value: 0.05, unit: N*m*s/rad, lower: 0}
  k: {value: 0.6, unit: N*m/V, lower: 0.1, upper: 2}
  c: {value: 0.4, unit: N*m/rad, fixed: true}
balances:
  shaft: {kind: torque, storage: J * der(v), terms: {drive: k * voltage, drag: -d * v, spring: -c * q}, position: q, velocity: v}
outputs: {angle: {value: q, unit: rad}, speed: {value: v, unit: rad/s}}
"""
FILTERS = (np.array([1.0, -0.7, 0.1]), np.array([1.0, -0.3]))


def drive(n=900, lacking=0.0, noise=0.05, seed=3, **known):
    """The drive with dry friction, from an angle of its own; samples are missing at random in the angle."""
    rng = np.random.default_rng(seed)
    U = np.repeat(rng.uniform(-1.0, 1.0, (n // 30, 1)), 30, axis=0)
    model = read_model(DRIVE).with_effect("coulomb-friction", "shaft", {"tau_c": 0.1})
    e = Experiment(U, np.full((n, 2), np.nan), np.zeros(1), 0.01, known=known)
    simulator = Simulator(model)
    Y = simulator.run_vectors(e, simulator.x0({"q": 0.3}), simulator.p(), substeps=4).Y
    Y = Y + noise * rng.standard_normal(Y.shape)
    Y[rng.random(n) < lacking, 0] = np.nan
    return replace(e, Y=Y)


def problem(model, parts, scale, block=None):
    return Problem.of(Simulator(model), Cells.of(parts, block), scale, [1] * len(parts))


@pytest.mark.parametrize("lacking", [0.0, 0.2])
@pytest.mark.parametrize("filters", [None, FILTERS])
@pytest.mark.parametrize("known", [{}, {"v": 0.0}])
def test_a_pass_says_what_simulations_and_their_products_say(lacking, filters, known):
    model = read_model(DRIVE).with_effect("coulomb-friction", "shaft", {"tau_c": 0.05})
    model = model.with_effect("input-delay", "voltage", {"delay": 0.004})
    parts = windows(drive(lacking=lacking, **known), 300)
    weights = np.array([3.0, 0.7])
    at = problem(model, parts, Scale(weights, np.full(2, np.inf), filters), np.arange(900) // 45)
    fit = at.begin(np.array([[0.2, known.get("v", 0.1)], [0.2, 0.1], [0.2, 0.1]]))
    then = SimulationErrorProblem(
        at.simulator, parts, at.parameters, Settings(weights=weights, filters=filters)
    )
    then.weights, then.substeps = weights, [1] * 3
    point = then.point((fit.theta, fit.initial))
    M = [fit.M[at.cells.part == k].sum(axis=(0, 1)) for k in range(3)]
    q, scale = len(fit.theta), np.abs(point.hessian).max()
    assert fit.cost == pytest.approx(point.cost, rel=1e-10)
    np.testing.assert_allclose(sum(M)[:q, :q], point.hessian, rtol=1e-10, atol=1e-12 * scale)
    np.testing.assert_allclose(sum(M)[:q, -1], point.gradient, rtol=1e-10, atol=1e-12 * scale)
    for m, own, cross, gradient in zip(M, point.own, point.cross, point.own_gradient, strict=True):
        np.testing.assert_allclose(m[q:-1, q:-1], own, rtol=1e-10, atol=1e-12 * scale)
        np.testing.assert_allclose(m[:q, q:-1], cross, rtol=1e-10, atol=1e-12 * scale)
        np.testing.assert_allclose(m[q:-1, -1], gradient, rtol=1e-10, atol=1e-12 * scale)
    H, g, _ = then.eliminated(point, 0.0)
    reduced, gradient, _ = eliminated(fit.M, at.cells.part, 3, q, np.ones(len(fit.power)), 0.0)
    np.testing.assert_allclose(reduced, H, rtol=1e-8, atol=1e-10 * scale)
    np.testing.assert_allclose(gradient, g, rtol=1e-8, atol=1e-10 * scale)


def test_huber_s_weights_make_an_event_count_no_more_than_its_size():
    e = drive(n=600)
    e.Y[300:305] += 50.0
    model, weights = read_model(DRIVE), np.array([3.0, 0.7])
    clip = np.array([1.0, 2.0])
    fit = problem(model, [e], Scale(weights, clip)).begin(np.array([[0.2, 0.0]]))
    errors = np.abs(fit.residuals[0] * weights)
    assert fit.cost == pytest.approx(
        np.where(errors <= clip, errors**2, clip * (2.0 * errors - clip)).sum(), rel=1e-10
    )
    robust = fit.descended(30, 1e-6).model.values
    plainly = (
        problem(model, [e], Scale(weights, np.full(2, np.inf)))
        .begin(np.array([[0.2, 0.0]]))
        .descended(30, 1e-6)
        .model.values
    )
    assert abs(robust["k"] - 0.6) < 0.2 * abs(plainly["k"] - 0.6)


def test_a_descent_ends_at_the_least_error_and_keeps_bounds():
    bounded = DRIVE.replace(
        "value: 0.6, unit: N*m/V, lower: 0.1, upper: 2",
        "value: 0.4, unit: N*m/V, lower: 0.1, upper: 0.5",
    )
    model = read_model(bounded)
    e, weights = drive(noise=0.02), np.array([3.0, 0.7])
    found = (
        problem(model, [e], Scale(weights, np.full(2, np.inf)))
        .begin(np.array([[0.0, 0.0]]))
        .descended(40, 1e-9)
    )
    known = estimate(model, [e], settings=Settings(weights=weights), substeps=[1])
    assert found.cost == pytest.approx(known.cost, rel=1e-6)
    np.testing.assert_allclose(found.theta, known.theta, rtol=1e-3)
    assert found.model.values["k"] == 0.5
    np.testing.assert_allclose(found.std, known.std, rtol=0.02)


def test_a_fit_without_some_cells_is_that_of_the_others_in_a_step_or_two():
    e, weights = drive(n=1200, noise=0.02), np.array([3.0, 0.7])
    model = read_model(DRIVE)  # lacks the friction: not linear, and not noise, what it leaves
    unit, block = Scale(weights, np.full(2, np.inf)), np.arange(1200) // 60
    fit = problem(model, [e], unit, block).begin(np.array([[0.3, 0.0]])).descended(40, 1e-9)
    off = {1: [], 2: []}
    for fold in range(4):
        out = fit.problem.cells.block % 4 == fold
        masked = replace(
            e,
            Y=np.where((block % 4 == fold)[:, None], np.nan, e.Y),
            known=dict(zip("qv", fit.X0[0], strict=True)),
        )
        rest = estimate(model, [masked], settings=Settings(weights=weights), substeps=[1])
        errors = ((e.Y - rest.predicted[0]) * weights)[block % 4 == fold]
        for steps, each in off.items():
            there = fit.without(out, 0.0, steps).residuals[0] * weights
            each.append(abs(np.sum(there[block % 4 == fold] ** 2) / np.sum(errors**2) - 1.0))
    assert np.median(off[1]) < 0.01 and max(off[1]) < 0.07
    assert np.median(off[2]) < 0.005
