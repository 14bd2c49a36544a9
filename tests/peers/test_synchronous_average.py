"""The synchronous average keeps what turns with the shaft."""

import numpy as np
import pytest

from benchmarks.peers.synchronous_average import synchronous_average
from residuum.diagnosis.vibration.rotation import angle_from_speed
from residuum.identification.errors import BadInput


def test_synchronous_average_keeps_the_gear_and_leaves_the_noise():
    fs, n = 5000.0, 50000
    angle = angle_from_speed(np.full(n, 1200.0), fs)
    noise = np.random.default_rng(0).standard_normal(n)
    average = synchronous_average(np.sin(2 * np.pi * 11 * angle) + noise, angle, 250)
    phase = np.arange(250) / 250
    assert average.revolutions == 199
    assert np.sqrt(np.mean((average.mean - np.sin(2 * np.pi * 11 * phase)) ** 2)) < 1.5 / np.sqrt(
        199
    )
    assert average.residual.std() == pytest.approx(1.0, abs=0.05)
    with pytest.raises(BadInput, match="at least 2"):
        synchronous_average(noise[:250], angle[:250], 250)
