"""The gripping pliers: rounds and quadrants, two clocks, and where a damaged bearing is heard."""

import numpy as np
import pytest
from scipy.signal import butter, hilbert, sosfiltfilt

from residuum.simulation import MACHINES


def pliers(**settings):
    return MACHINES["gripping-pliers"](seed=1, **settings)


def envelope(acceleration):
    band = butter(4, [1466.7, 1600.0], "band", fs=12800, output="sos")
    return np.abs(hilbert(sosfiltfilt(band, acceleration)))


def rising(signal):
    return np.flatnonzero(np.diff(signal) > 0) + 1


def quadrant_rms(signals):
    """RMS of the envelope in Q1 … Q4 (of P3): quadrants follow the longer pulse of plier P1."""
    e, starts = envelope(signals["acceleration"]), rising(signals["indicator"])
    widths = [np.argmin(signals["indicator"][s:]) for s in starts[:-1]]
    first = int(np.argmax(widths[:4]))
    levels = [[], [], [], []]
    for k in range(first, len(starts) - 1):
        levels[(k - first) % 4].append(np.sqrt(np.mean(e[starts[k] : starts[k + 1]] ** 2)))
    return [np.mean(level) for level in levels]


def test_four_pulses_a_round_at_1800_rounds_an_hour():
    machine = pliers().advance(20.0)["machine"]
    assert np.diff(rising(machine["indicator"])) == pytest.approx(500, abs=3)
    assert machine["speed"].mean() == pytest.approx(30.0, abs=0.05)


def test_a_damaged_bearing_is_heard_in_q3_then_in_q4():
    healthy = quadrant_rms(pliers().simulate(60.0))
    q1, q2, q3, q4 = (
        np.array(quadrant_rms(pliers(faults={"plier-bearing": None}).simulate(60.0))) / healthy
    )
    assert q3 > 1.3 * q4
    assert q4 > 1.3 * max(q1, q2)


def test_another_pliers_damage_is_heard_a_quadrant_earlier():
    healthy = np.array(quadrant_rms(pliers().simulate(60.0)))
    grown = (
        np.array(
            quadrant_rms(pliers(faults={"plier-bearing": None}, damaged_plier=2).simulate(60.0))
        )
        / healthy
    )
    assert list(np.argsort(grown)[::-1][:2]) == [1, 2]


def test_indicators_are_of_the_size_that_the_bench_had():
    kurtosis, rms = [], []
    for faults in ({}, {"plier-bearing": None}):
        e = envelope(pliers(faults=faults).simulate(100.0)["acceleration"])
        rms.append(np.sqrt(np.mean(e**2)) / 9.81)
        kurtosis.append(np.mean((e - e.mean()) ** 4) / np.var(e) ** 2)
    assert rms == pytest.approx([0.0075, 0.0165], rel=0.25)
    assert 4 < kurtosis[0] < 9
    assert kurtosis[1] > 5 * kurtosis[0]


def test_before_the_first_preform_the_bearing_is_quieter():
    signals = pliers(faults={"plier-bearing": None}, preforms_after=20.0).simulate(60.0)
    e = envelope(signals["acceleration"])
    assert np.percentile(e[: 19 * 12800], 99.9) < 0.8 * np.percentile(e[21 * 12800 :], 99.9)


def test_the_sync_pulse_ties_two_clocks_that_differ_in_offset_and_rate():
    machine = pliers()
    streams = machine.advance(120.0)
    edges = {name: s.t0 + rising(s["sync"]) * s.sample_time for name, s in streams.items()}
    n = min(map(len, edges.values()))
    rate, offset = np.polyfit(edges["vibration"][:n], edges["machine"][:n], 1)
    constants = machine.truth["constants"]
    assert offset == pytest.approx(constants["machine_clock_offset"], abs=1e-3)
    assert 1e6 * (rate - 1) == pytest.approx(
        constants["vibration_clock_ppm"] - constants["machine_clock_ppm"], abs=6
    )
    assert abs(constants["vibration_clock_ppm"] - constants["machine_clock_ppm"]) <= 50


def test_one_record_is_aligned():
    signals = pliers().simulate(10.0)
    streams = pliers().advance(10.0)
    assert np.array_equal(signals["acceleration"], streams["vibration"]["acceleration"])
    assert rising(signals["indicator"]) / 12.8 == pytest.approx(
        rising(streams["machine"]["indicator"]), abs=1.1
    )
