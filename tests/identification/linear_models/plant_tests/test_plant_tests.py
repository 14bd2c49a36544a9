"""Integrators, feedback and dead time on simulated plants whose truth is known; more in benchmarks/plant_tests.py."""

import numpy as np
import pytest
from scipy import signal

from benchmarks.plant_tests import dead_time_plant, feedback_plant, integrating_plant, plain_plant
from residuum.identification.errors import NotIdentifiable
from residuum.identification.linear_models.plant_tests import (
    dead_time,
    excitation_test,
    feedback_test,
    integrator_test,
    long_autoregression,
    unstable_test,
)
from residuum.identification.record import Record


def regression(u, y, **options):
    return long_autoregression(
        [Record({"u": u, "y": y}, {"u": "V", "y": "m"}, 0.1)], "u", "y", **options
    )


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
    found = integrator_test(
        regression(u, signal.lfilter([0.0, 0.3], [1.0, -0.7], u) + 0.1 * np.cumsum(e))
    )
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
    # taken for delayed, it looks like an answer to the noise
    assert feedback_test(regression(u, y)).present
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


def _excited(kind, rng, n):
    k = np.arange(n)
    pulse = (k >= 20) & (k < 23 + rng.integers(10))
    return {
        "sine": np.sin(2 * np.pi * k / rng.uniform(5, 40)).round(6),
        "two sines": (
            np.sin(2 * np.pi * k / 20) + np.sin(2 * np.pi * k / rng.uniform(40, 70))
        ).round(6),
        "ramp": k / n,
        "step": (k >= 20) * 1.0,
        "pulse": pulse * 1.0,
        "binary": np.repeat(rng.choice([-1.0, 1.0], n // 5 + 1), 5)[:n],
    }[kind]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("kind", "most", "tells_gain"),
    [
        ("sine", 2, False),
        ("two sines", 4, False),
        ("ramp", 1, True),
        ("step", 99, True),
        ("pulse", 99, True),
        ("binary", 99, True),
    ],
)
def test_an_input_excites_what_rises_above_the_noise(kind, most, tells_gain, seed):
    rng = np.random.default_rng(seed)
    tau = rng.uniform(3, 8)
    u = _excited(kind, rng, 480)
    pole = np.exp(-1 / tau)
    y = signal.lfilter([0.0, 1 - pole], [1.0, -pole], u) + 0.01 * rng.standard_normal(480)
    found = excitation_test([Record({"u": u, "y": y}, {"u": "V", "y": "m"}, 1.0)], "u", "y")
    assert found.tells_gain == tells_gain
    assert found.order == most if most < 99 else found.order > 20
    if tells_gain:
        gain = found.gain * np.std(y) / np.std(u)  # about; the powers are of the rows
        assert 0.5 < gain < 2
    regression(u, y)  # a singular Gram matrix is no obstacle


@pytest.mark.parametrize("seed", range(6))
def test_an_unstable_plant_in_its_loop_is_told_with_its_pole(seed):
    rng = np.random.default_rng(seed)
    pole, n = rng.uniform(1.03, 1.2), 2000
    y, u, (e, r) = np.zeros(n), np.zeros(n), rng.standard_normal((2, n))
    gain = rng.uniform(pole - 0.8, pole - 0.3)
    for t in range(1, n):
        y[t] = pole * y[t - 1] + u[t - 1] + 0.1 * e[t]
        u[t] = gain * (np.sign(r[t // 7]) - y[t])
    found = unstable_test(regression(u, y))
    assert found.unstable
    assert abs(found.pole - pole) < 4 * found.spread
    plants = integrating_plant(seed), feedback_plant(seed), plain_plant(seed)
    assert not any(unstable_test(regression(plant.u, plant.y)).unstable for plant in plants)
