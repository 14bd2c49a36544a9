"""Parity space, Kalman innovation, unknown input observer, adaptive threshold and the structured residual set."""

import numpy as np
import pytest

from benchmarks.peers.adaptive_threshold import adaptive_threshold
from residuum.diagnosis.residuals.generators.classical_filters import (
    kalman_residual,
    parity_space,
    unknown_input_observer,
)
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction

TS = 0.1
PLANT = TransferFunction([0.3, 0.1], [1.0, -1.2, 0.5], TS)
SYSTEM = StateSpace.from_transfer_function(PLANT)


def simulate(x0, u, noise, seed):
    rng = np.random.default_rng(seed)
    y, _ = SYSTEM.simulate(u[:, None], np.asarray(x0, dtype=float))
    return y[:, 0] + noise * rng.standard_normal(len(u))


def test_parity_residual_ignores_the_initial_state_and_has_unit_variance():
    u = np.random.default_rng(1).standard_normal(20_000)
    parity = parity_space(SYSTEM, 10, measurement_noise=0.04)
    exact = parity.residual(u, simulate([50.0, -20.0], u, 0.0, 2))
    assert np.nanmax(np.abs(exact)) < 1e-9
    assert np.nanstd(parity.residual(u, simulate([0.0, 0.0], u, 0.2, 3))) == pytest.approx(
        1.0, rel=0.03
    )
    with pytest.raises(BadModel, match="at least the order"):
        parity_space(SYSTEM, 1)


def test_kalman_innovation_is_white_with_unit_variance():
    rng = np.random.default_rng(4)
    u = rng.standard_normal(50_000)
    y = SYSTEM.simulate((u + 0.3 * rng.standard_normal(50_000))[:, None])[0][
        :, 0
    ] + 0.2 * rng.standard_normal(50_000)
    r = kalman_residual(SYSTEM, 0.09, 0.04).residual(u, y)[100:]
    assert np.std(r) == pytest.approx(1.0, rel=0.02)
    assert abs(np.corrcoef(r[1:], r[:-1])[0, 1]) < 0.02


def test_unknown_input_observer_is_blind_to_the_disturbance_but_not_to_a_sensor():
    A = np.array([[0.8, 0.2, 0.0], [-0.1, 0.7, 0.1], [0.0, 0.2, 0.6]])
    plant = StateSpace(
        A,
        np.array([[1.0], [0.0], [0.5]]),
        np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        np.zeros((2, 1)),
        TS,
    )
    E = np.array([[0.5], [1.0], [0.2]])
    rng = np.random.default_rng(5)
    u, d = rng.standard_normal(400), 10.0 * rng.standard_normal(400)
    joint = StateSpace(A, np.hstack([plant.B, E]), plant.C, np.zeros((2, 2)), TS)
    y, _ = joint.simulate(np.column_stack([u, d]))
    observer = unknown_input_observer(plant, E)
    assert np.abs(observer.residual(u, y)[100:]).max() < 1e-8
    y[300:, 0] += 1.0
    assert np.abs(observer.residual(u, y)[300:]).max() > 0.1
    with pytest.raises(BadModel, match="use up all"):
        unknown_input_observer(plant, np.eye(3)[:, [0, 2]])
    with pytest.raises(BadModel, match="rank C E"):
        unknown_input_observer(plant, np.eye(3)[:, [1]])


def test_adaptive_threshold_rises_with_the_input():
    model = IdentifiedModel(
        method="by hand",
        sample_time=TS,
        impulse_response=[0.5, 0.2],
        covariance=1e-4 * np.eye(2),
        noise_variance=0.01,
    )
    level = adaptive_threshold(model, TransferFunction([0.2], [1.0], TS), 0.1).level(
        np.concatenate([np.zeros(20), 10 * np.ones(20)])
    )
    assert level[:20] == pytest.approx(0.1) and level[-1] > 0.5
