"""Integrators, feedback and dead time on simulated plants whose truth is known; more in benchmarks/plant_tests.py."""

import numpy as np
import pytest
from scipy import signal

from benchmarks.plant_tests import dead_time_plant, feedback_plant, integrating_plant, plain_plant
from residuum.identification.errors import NotIdentifiable
from residuum.identification.linear_models.plant_tests.dead_time import dead_time
from residuum.identification.linear_models.plant_tests.feedback import feedback_test
from residuum.identification.linear_models.plant_tests.integrator import integrator_test
from residuum.identification.linear_models.plant_tests.long_autoregression import long_autoregression
from residuum.identification.record import Record


def regression(u, y, **options):
    return long_autoregression([Record({"u": u, "y": y}, {"u": "V", "y": "m"}, 0.1)], "u", "y", **options)


@pytest.mark.parametrize("seed", range(4))
def test_integrating_plants_are_told_from_slow_ones(seed):
    plant = integrating_plant(seed)
    assert integrator_test(regression(plant.u, plant.y)).integrates
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(3000)
    slow = signal.lfilter([0.0, 0.02], [1.0, -0.98], u)
    found = integrator_test(regression(u, slow + 0.05 * np.std(slow) * rng.standard_normal(3000)))
    assert not found.integrates
    assert not found.wanders


def test_an_output_that_wanders_by_itself_is_no_integrator():
    rng = np.random.default_rng(2)
    u, e = rng.standard_normal((2, 2000))
    found = integrator_test(regression(u, signal.lfilter([0.0, 0.3], [1.0, -0.7], u) + 0.1 * np.cumsum(e)))
    assert not found.integrates
    assert found.wanders


@pytest.mark.parametrize("seed", range(4))
def test_feedback_is_told_from_open_loops(seed):
    closed, plain = feedback_plant(seed), plain_plant(seed)
    assert feedback_test(regression(closed.u, closed.y)).present
    assert not feedback_test(regression(plain.u, plain.y)).present


def test_a_plant_that_answers_within_the_sample_is_no_feedback():
    u, e = np.random.default_rng(0).standard_normal((2, 2000))
    y = signal.lfilter([0.5, 0.2], [1.0, -0.6], u) + 0.2 * e
    assert feedback_test(regression(u, y)).present  # taken for delayed, it looks like an answer to the noise
    assert not feedback_test(regression(u, y, first_lag=0)).present


@pytest.mark.parametrize("seed", range(4))
def test_dead_time_is_found_within_what_drowns_in_noise(seed):
    plant = dead_time_plant(seed)
    found = dead_time(regression(plant.u, plant.y))
    assert plant.delay <= found <= plant.delay + 9


def test_missing_samples_and_several_records_change_nothing_but_the_rows():
    plant = dead_time_plant(0)
    u, y = plant.u.copy(), plant.y.copy()
    y[500], u[900] = np.nan, np.nan
    halves = [
        Record({"u": u[part], "y": 40.0 * k + y[part]}, {"u": "V", "y": "m"}, 0.1)
        for k, part in enumerate([slice(0, 1500), slice(1500, None)])
    ]
    found = long_autoregression(halves, "u", "y")
    assert abs(dead_time(found) - plant.delay) <= 3
    assert not integrator_test(found).integrates


def test_too_short_or_still_records_are_refused():
    with pytest.raises(NotIdentifiable, match="at least 120"):
        regression(np.arange(50.0), np.arange(50.0))
    with pytest.raises(NotIdentifiable, match="'u': does not move"):
        regression(np.ones(500), np.random.default_rng(0).standard_normal(500))
