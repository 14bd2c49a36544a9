"""Cutting rounds, aligning clocks, and following the shaft's angle: known pulses, clocks and speeds come back."""

import numpy as np
import pytest

from residuum.diagnosis.vibration.rotation import (
    align_clocks,
    angle_from_speed,
    at_even_angle,
    cut_rounds,
    on_clock_of,
    pulses,
)
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.simulation.gripping_pliers import GrippingPliers


def indicator(quadrants, width=20, long_every=0, first_long=0, length=100):
    x = np.zeros(quadrants * length)
    for q in range(quadrants):
        longer = 2 if long_every and q % long_every == first_long else 1
        x[q * length : q * length + width * longer] = 1
    return x


def test_rounds_begin_at_the_first_pulse_and_the_long_one_names_the_quadrants():
    plain = cut_rounds(indicator(9))
    assert (
        plain.edges.tolist() == [[0, 100, 200, 300, 400], [400, 500, 600, 700, 800]]
        and plain.phase is None
    )
    marked = cut_rounds(indicator(8, long_every=4, first_long=1))
    assert [marked.quadrant(s) for s in range(4)] == [3, 0, 1, 2]


def test_a_window_from_pulse_to_pulse_is_one_round_and_a_cut_one_is_none():
    assert cut_rounds(indicator(4)).count == 1
    with pytest.raises(BadInput, match="a round needs 4"):
        cut_rounds(indicator(4)[:-60])


def test_lost_pulse_silent_indicator_and_gaps_are_refused():
    lost = indicator(8)
    lost[300:320] = 0
    with pytest.raises(BadInput, match="a pulse is lost or extra"):
        cut_rounds(lost)
    with pytest.raises(BadInput, match="never changes"):
        cut_rounds(np.ones(100))
    with pytest.raises(BadInput, match="missing samples"):
        cut_rounds(np.full(100, np.nan))


def test_clock_offset_and_drift_come_back_and_a_pulse_only_one_saw_is_left_out():
    true = np.arange(300.0)
    other = np.delete(0.2 + true * (1 - 50e-6), [7, 100])
    alignment = align_clocks(
        np.append(true, 33.4), other + np.where(np.arange(298) == 50, 0.3, 0.0)
    )
    assert alignment.drift == pytest.approx(50e-6, rel=1e-3) and alignment.pulses == 297
    assert alignment.to_reference(0.2) == pytest.approx(0.0, abs=1e-6)
    assert alignment.to_other(alignment.to_reference(123.4)) == pytest.approx(123.4)
    with pytest.raises(BadInput, match="no synchronisation pulse"):
        align_clocks([], true)
    with pytest.raises(BadInput, match="ppm"):
        align_clocks(true[:60], true[:60] * 1.005)


def pulse_times(record):
    rising, _ = pulses(record["sync"])
    return record.t0 + (rising[rising > 0] - 0.5) * record.sample_time


def test_two_recorders_of_the_pliers_agree_to_a_machine_sample():
    machine = GrippingPliers(seed=3)
    streams = machine.advance(40.0)
    vibration, slow = (
        Record(s.channels, s.units, s.sample_time, s.t0)
        for s in (streams["vibration"], streams["machine"])
    )
    alignment = align_clocks(pulse_times(vibration), pulse_times(slow))
    joined = on_clock_of(vibration, slow, alignment, ["indicator"])
    truth = GrippingPliers(seed=3).simulate(40.0)["indicator"]
    known = ~np.isnan(joined["indicator"])
    shift = (
        np.flatnonzero(np.diff(joined["indicator"][known]) > 0)[5:60]
        - np.flatnonzero(np.diff(truth[known]) > 0)[5:60]
    )
    assert known.mean() > 0.999 and np.abs(shift / 12.8).max() <= 1.5  # ms


def test_order_tracking_sharpens_a_line_that_speed_smears():
    fs, n = 2000.0, 20000
    speed = 600 * (1 + 0.2 * np.sin(2 * np.pi * 0.2 * np.arange(n) / fs))  # rpm
    angle = angle_from_speed(speed, fs)
    x = np.cos(2 * np.pi * 7.3 * angle)
    even = at_even_angle(x, angle, 200)
    spectrum = np.abs(np.fft.rfft(even * np.hanning(even.size))) / even.size * 4
    assert spectrum.max() == pytest.approx(1.0, abs=0.15)
    assert np.argmax(spectrum) * 200 / even.size == pytest.approx(7.3, abs=0.02)
    assert np.abs(np.fft.rfft(x * np.hanning(n))).max() / n * 4 < 0.5
    with pytest.raises(BadInput, match="not positive"):
        angle_from_speed(-speed, fs)
