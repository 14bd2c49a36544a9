"""Both estimates of the delay between voltage and speed."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.peers.delay_estimation import delay_by_likelihood, delay_by_simulation_error
from residuum.diagnosis.gate.actuator_model import AdaptedModel, delayed, first_order_response
from residuum.diagnosis.gate.movements import Direction, Movement


def noise_free(T=0.05, gain=14.0, load=20.0, delay=0.0, Ts=1e-3):
    t = np.arange(round(8.0 / Ts)) * Ts
    voltage = 30.0 * np.clip(np.minimum(t, 8.0 - t), 0.0, 1.0)
    speed = first_order_response(np.maximum(gain * delayed(voltage, delay, Ts) - load, 0.0), T, Ts)
    return Movement(Direction.OPENING, Ts, speed, voltage)


@pytest.mark.parametrize("delay", [0.0123, 0.0304])
def test_both_delay_estimates_recover_a_delay_between_samples(delay):
    movement = noise_free(delay=delay, Ts=2e-3)
    noisy = replace(
        movement, speed=movement.speed + np.random.default_rng(0).normal(0, 0.5, movement.n)
    )
    model = AdaptedModel(14.0, 0.05, 0.0, (20.0,))
    for estimate in (delay_by_simulation_error(noisy, model), delay_by_likelihood(noisy, model)):
        assert not estimate.at_edge
        assert estimate.value == pytest.approx(delay, abs=max(3 * estimate.std, 2e-4))


def test_a_delay_beyond_the_searched_range_is_said_to_be_at_its_edge():
    movement = noise_free(delay=0.03, Ts=2e-3)
    assert delay_by_simulation_error(
        movement, AdaptedModel(14.0, 0.05, 0.0, (20.0,)), largest=0.01
    ).at_edge
