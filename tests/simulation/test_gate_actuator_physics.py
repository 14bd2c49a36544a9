"""The gate actuator: its movement, where damaged teeth show, and what operating events do."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from residuum.simulation import MACHINES, BadSetting


def lived(seconds=40.0, events=(), **settings):
    machine = MACHINES["gate-actuator"](seed=7, **settings)
    for event in events:
        machine.trigger(event)
    return machine.simulate(seconds), machine.position


def movements(signals):
    """(phase, first sample, last sample) of every movement that ended."""
    edges = np.flatnonzero(np.diff(signals["phase"]))
    return [
        (signals["phase"][a + 1], a + 1, b) for a, b in pairwise(edges) if signals["phase"][a + 1]
    ]


def steady(signals, first, last):
    return slice(first + 8000, last - 8000)


def ripple(signals, first, last):
    """Fast part of the speed in steady motion [rad/s]."""
    part = signals["speed"][steady(signals, first, last)]
    return sosfiltfilt(butter(2, [0.8, 40.0], "band", fs=5000, output="sos"), part - part.mean())


def test_opens_pauses_and_closes_at_the_speed_of_the_real_one():
    signals, position = lived()
    (opening, a, b), (closing, c, d) = movements(signals)[:2]
    assert (opening, closing) == (1, 2)
    assert 11.0 < (b - a) / 5000 < 12.0
    assert (c - b) / 5000 == pytest.approx(7.0, abs=0.01)
    for first, last, sign in ((a, b, 1), (c, d, -1)):
        rpm = signals["speed"][steady(signals, first, last)].mean() * 30 / np.pi
        assert sign * rpm == pytest.approx(4100, rel=0.03)
    assert position[b] == pytest.approx(2.85, abs=0.03)
    assert position[d] == pytest.approx(0.0, abs=0.03)


def test_a_missing_pinion_tooth_comes_once_a_shaft_revolution():
    signals, _ = lived(faults={"pinion-tooth": None})
    healthy, _ = lived()
    _, a, b = movements(signals)[0]
    extra = ripple(signals, a, b)
    spectrum = np.abs(np.fft.rfft(extra * np.hanning(len(extra)), 1 << 18))
    frequency = np.fft.rfftfreq(1 << 18, 1 / 5000)
    shaft = signals["speed"][steady(signals, a, b)].mean() / (2 * np.pi * 44)
    on = [spectrum[np.argmin(np.abs(frequency - k * shaft))] for k in (1, 2, 3, 4, 5)]
    between = [spectrum[np.argmin(np.abs(frequency - (k + 0.5) * shaft))] for k in (1, 2, 3, 4, 5)]
    assert min(on) > 3 * max(between)
    assert extra.std() > 2 * ripple(healthy, a, b).std()


def test_a_missing_rack_tooth_comes_at_one_place_of_the_gate_in_both_directions():
    signals, position = lived(faults={"rack-tooth": None})
    places = []
    for _, a, b in movements(signals)[:2]:
        places.append(position[steady(signals, a, b)][np.argmax(np.abs(ripple(signals, a, b)))])
    assert places == pytest.approx([1.2, 1.2], abs=0.03)


@pytest.mark.parametrize("id", ["gear-notch", "pinion-tooth", "rack-tooth"])
def test_damage_grows_from_hardly_visible_to_gross(id):
    healthy, _ = lived(13.0)
    _, a, b = movements(healthy)[0]
    level = [
        np.abs(ripple(lived(13.0, faults={id: size})[0], a, b)).max() for size in (0.1, 0.5, 1.0)
    ]
    assert level[0] < 1.5 * np.abs(ripple(healthy, a, b)).max()
    assert level[2] > level[1]
    assert level[2] > 1.3 * np.abs(ripple(healthy, a, b)).max()


def test_wear_and_heat_change_what_they_should():
    cold, hot = (MACHINES["gate-actuator"](temperature=t).truth["constants"] for t in (20.0, 70.0))
    assert hot["R"] / cold["R"] == pytest.approx(1 + 0.0039 * 50)
    assert hot["motor_friction"] < cold["motor_friction"]
    assert MACHINES["gate-actuator"](wear=1.0).truth["constants"]["clearance"] == pytest.approx(
        3 * cold["clearance"]
    )
    with pytest.raises(BadSetting, match="wear is 2; must be between 0 and 1"):
        MACHINES["gate-actuator"](wear=2)


def test_operating_events_happen_once_and_the_gate_goes_on():
    normal = movements(lived(60.0)[0])
    for event in ("cut-short", "obstacle"):
        signals, position = lived(60.0, [event])
        first, second, third = movements(signals)[:3]
        assert first[2] - first[1] < 0.65 * (normal[0][2] - normal[0][1])
        assert 0.4 * 2.85 < position[first[2]] < 0.65 * 2.85
        assert position[second[2]] == pytest.approx(0.0, abs=0.03)
        assert third[2] - third[1] == pytest.approx(normal[2][2] - normal[2][1], rel=0.02)
    assert lived(13.0, ["obstacle"])[0]["current"].max() > 10.0
    pushed, sagging, plain = (
        lived(13.0, events)[0] for events in (["manual-push"], ["supply-sag"], [])
    )
    middle = slice(int(6.3 * 5000), int(6.8 * 5000))
    assert pushed["current"][middle].mean() < plain["current"][middle].mean() - 0.3
    assert sagging["voltage"][middle].mean() == pytest.approx(
        plain["voltage"][middle].mean() - 6.0, abs=0.5
    )
