"""Locating an error that was put in one known place."""

import numpy as np
import pytest

from residuum.identification.residual_analysis.locate import Axis, locate


def drive(seed=0, n=6000):
    rng = np.random.default_rng(seed)
    t = np.arange(n) * 0.01
    speed = 40 * np.sin(2 * np.pi * t / 7.3)
    position = np.cumsum(speed) * 0.01
    axes = [
        Axis("speed", "rad/s", "velocity", speed),
        Axis("position", "rad", "position", position),
        Axis("time", "s", "time", t),
    ]
    return rng, speed, position, axes


def test_finds_the_standstill_first():
    rng, speed, _, axes = drive()
    error = rng.normal(size=speed.size) + 6 * np.exp(-((speed / 3) ** 2))
    first = locate(error, axes, noise_rms=1.0, of="speed")[0]
    assert first.axis == "speed" and "standstill" in first.says
    assert -8 < first.start < -1 and 1 < first.stop < 8
    assert first.times_noise > 3 and first.share > first.time_share


def test_says_when_only_one_direction_fails():
    rng, speed, position, axes = drive()
    place = np.exp(-(((position - 60) / 6) ** 2))
    error = rng.normal(size=speed.size) + 5 * place * (speed > 0)
    first = locate(error, axes, noise_rms=1.0, of="speed", direction=np.sign(speed))[0]
    assert (
        first.axis == "position" and first.direction == "forward" and "forward only" in first.says
    )
    assert first.start < 60 < first.stop


@pytest.mark.parametrize("seed", range(8))
def test_plain_noise_has_no_place(seed):
    rng, speed, _, axes = drive(seed)
    assert (
        locate(
            rng.normal(size=speed.size), axes, noise_rms=1.0, of="speed", direction=np.sign(speed)
        )
        == []
    )


def test_missing_samples_and_constant_axes_are_passed_over():
    rng, speed, _, axes = drive()
    error = rng.normal(size=speed.size) + 6 * np.exp(-((speed / 3) ** 2))
    error[::7] = np.nan
    flat = Axis("temperature", "°C", "temperature", np.full(speed.size, 20.0))
    assert [
        region.axis for region in locate(error, [flat, axes[0]], noise_rms=1.0, of="speed")
    ] == ["speed"]
