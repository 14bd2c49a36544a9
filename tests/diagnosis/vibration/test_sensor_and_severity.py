"""Sensor faults are told from machine faults; severity comes back from known signals."""

import numpy as np
import pytest

from residuum.diagnosis.thresholds.tails import HealthyBand
from residuum.diagnosis.vibration.sensor_health import (
    clipped_share,
    not_heard,
    remarks,
    suspect,
    unusable,
    without_spikes,
)
from residuum.diagnosis.vibration.vibration_indicators import severity
from residuum.identification.errors import BadInput

FS = 12000
NOISE = np.random.default_rng(0).standard_normal(2 * FS)
T = np.arange(2 * FS) / FS


@pytest.mark.parametrize(
    ("x", "says"),
    [
        (NOISE[:50], "too short: 50"),
        (np.where(np.arange(NOISE.size) == 5, np.nan, NOISE), "a gap: 1 of"),
        (np.full(2000, 0.3), "dead"),
        (np.where((T > 0.5) & (T < 0.9), 1.0, NOISE), "froze"),
        (np.clip(NOISE, -1.5, 1.5), "clipped"),
        (np.clip(NOISE, -9.0, 1.0), "clipped"),
    ],
)
def test_unusable_signals_say_why(x, says):
    assert says in unusable(x)


@pytest.mark.parametrize(
    ("x", "says"),
    [
        (NOISE + 10 * T, "drifts"),
        (NOISE + 9 * np.cos(2 * np.pi * 3 * T), "loose"),
        (NOISE + 4 * np.cos(2 * np.pi * 60 * T) + 2 * np.cos(2 * np.pi * 180 * T), "60 Hz"),
    ],
)
def test_suspect_sensors_say_what(x, says):
    assert unusable(x) is None
    assert says in suspect(x, FS)


def test_machine_signals_are_not_blamed_on_the_sensor():
    impacts = NOISE + 40 * (np.arange(NOISE.size) % 400 == 0)
    for x in (
        NOISE,
        NOISE + 5,
        impacts,
        NOISE + 3 * np.cos(2 * np.pi * 100 * T),
        np.round(NOISE),
        np.cos(2 * np.pi * 47.3 * T),
    ):
        assert unusable(x) is None and suspect(x, FS) is None
    assert suspect(NOISE + 4 * np.cos(2 * np.pi * 50 * T), FS, shaft=49.5) is None
    assert clipped_share(impacts) == 0


def test_healthy_limit_keeps_its_false_alarm_rate_also_for_few_observations():
    rng = np.random.default_rng(1)
    alarms = [
        np.exp(rng.standard_normal(400))
        > HealthyBand.of(np.exp(rng.standard_normal(12))).upper(0.02)
        for _ in range(200)
    ]
    assert np.mean(alarms) == pytest.approx(0.018, abs=0.008)
    assert HealthyBand.of([1.0, 1.0, 1.01]).upper(1e-3, 1.5) >= 1.5


def test_severity_does_not_count_what_lies_below_10_hz():
    a = 2 * np.pi * 120 * 0.004 * np.sqrt(2) * np.cos(2 * np.pi * 120 * T)
    drift = 3 * np.cos(2 * np.pi * 2 * T)
    found = severity(a + drift, FS, "group-2-rigid")
    assert found.velocity == pytest.approx(4.0, rel=0.01) and found.zone == "C"
    with pytest.raises(BadInput, match="machine class 'V' is not known"):
        severity(a, FS, "V")
    with pytest.raises(BadInput, match="need 2000 Hz"):
        severity(a, 500, "I")


def _dropping_out() -> np.ndarray:
    x = NOISE.copy()
    for start in range(300, x.size - 200, 1000):
        x[start : start + 60] = 0.0
    return x


@pytest.mark.parametrize(
    ("x", "says"),
    [
        (_dropping_out(), "drops out: 24 stretches, 6 % of the samples, stand at 0"),
        (np.repeat(NOISE[::4], 4), "each value stands for 4 samples"),
        (np.round(NOISE / 1.5) * 1.5, "smaller than a step of its converter, 1.5"),
        (np.where(np.arange(NOISE.size) % 4 == 0, 0.0, NOISE), "25 % of the samples are 0"),
        (
            np.where(np.random.default_rng(3).random(NOISE.size) < 0.004, 30.0 + NOISE, NOISE),
            "single samples stand far beside",
        ),
    ],
)
def test_a_line_that_hands_on_other_than_the_sensors_values_is_told(x, says):
    assert says in unusable(x)


def test_a_sensor_that_falls_silent_is_told():
    for silent in (T > 1.0, (T > 0.5) & (T < 0.7)):
        assert "silent for" in suspect(np.where(silent, 1e-4, 1.0) * NOISE, FS)


def test_spikes_are_left_out_and_what_rings_stays():
    x, at = NOISE.copy(), np.array([900, 5000, 5600, 20000])
    x[at] += 40.0
    clean, spikes = without_spikes(x)
    assert spikes == 4 and clean[at] == pytest.approx((x[at - 1] + x[at + 1]) / 2)
    assert np.array_equal(np.delete(clean, at), np.delete(x, at))
    ring = 40 * np.exp(-np.arange(60) / 10) * np.cos(0.5 * np.arange(60))
    struck = NOISE + np.convolve(np.bincount(at, minlength=NOISE.size), ring)[: NOISE.size]
    assert without_spikes(struck)[1] == 0


def test_a_sensor_that_hears_less_than_it_did_calls_nothing_healthy():
    edges = [10, 100, 1000, 2000, 4000]
    assert "dead" in not_heard([1, 2, 3, 4], [0.01, 0.03, 0.001, 0.04], edges)
    assert "above 1000 Hz" in not_heard([1, 2, 3, 4], [1, 2, 0.1, 0.04], edges)
    # one band may fall: a gear's line that moved
    assert not_heard([1, 2, 3, 4], [1, 2, 3, 0.04], edges) is None
    assert not_heard([1, 2, 3, 4], [0.2, 0.4, 0.6, 0.8], edges) is None


def test_what_no_verdict_depends_on_is_remarked():
    assert remarks(NOISE + 9.8, FS, "m/s²") == []
    assert "mean lies at 50" in remarks(NOISE + 50, FS, "m/s²")[0]
    assert remarks(NOISE + 50, FS, "") == []
    assert "at 1234 Hz, holds 9" in remarks(NOISE + 6 * np.cos(2 * np.pi * 1234 * T), FS, "m/s²")[0]
    assert remarks(NOISE, FS, "m/s²", spikes=3)[0].startswith(
        "spikes of single samples were left out, 3 of 24000"
    )
