"""Sensor faults are told from machine faults; severity comes back from known signals."""

import numpy as np
import pytest

from residuum.diagnosis.thresholds.healthy_band import HealthyBand
from residuum.diagnosis.vibration.sensor_health import clipped_share, suspect, unusable
from residuum.diagnosis.vibration.vibration_severity import severity
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
    for x in (NOISE, NOISE + 5, impacts, NOISE + 3 * np.cos(2 * np.pi * 100 * T), np.round(NOISE), np.cos(2 * np.pi * 47.3 * T)):
        assert unusable(x) is None and suspect(x, FS) is None
    assert suspect(NOISE + 4 * np.cos(2 * np.pi * 50 * T), FS, shaft=49.5) is None
    assert clipped_share(impacts) == 0


def test_healthy_limit_keeps_its_false_alarm_rate_also_for_few_observations():
    rng = np.random.default_rng(1)
    alarms = [np.exp(rng.standard_normal(400)) > HealthyBand.of(np.exp(rng.standard_normal(12))).upper(0.02) for _ in range(200)]
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
