"""Made-up movements of a gate by formula, for the conformance test to train on. Not a machine: no friction, no teeth."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from residuum.identification.record import Record

_RATE = 2000.0  # Hz
_LEVEL, _GAIN, _T = 30.0, 14.37, 0.0434  # V, rad/(V·s), s
_GEAR_TEETH = 44
_OPENING, _CLOSING = 1, 2


def example_record(fault: str, seed: int, duration: float = 7.0) -> Record:
    """One movement of `duration` seconds with ramps of 1 s.

    Speed is the first-order response to the voltage less a load; `gear` adds a load pulse once a shaft turn, `rack` one in the
    middle of the way. Tooth errors are a fixed random pattern once a turn; noise is white.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration * _RATE)) / _RATE
    voltage = _LEVEL * np.clip(np.minimum(t, duration - t), 0.0, 1.0) + 0.03 * rng.standard_normal(t.shape[0])
    flat = _GAIN * _LEVEL / (2 * np.pi * _GEAR_TEETH)
    turns = flat * (t - 0.5) + rng.uniform()
    load = 20.0 + sum(rng.normal(0.0, 0.4) * np.cos(2 * np.pi * (k * turns + rng.uniform())) for k in range(1, 15))
    if fault == "gear":
        load = load + 60.0 * np.exp(-0.5 * ((turns % 1.0 - 0.5) / 0.015) ** 2)
    if fault == "rack":
        load = load + 150.0 * np.exp(-0.5 * ((t - 0.5 * duration) / 0.01) ** 2)
    speed = _low_pass(np.maximum(_GAIN * voltage - load, 0.0)) + rng.normal(0.0, 1.0, t.shape[0])
    closing = seed % 2 == 1
    sign = -1.0 if closing else 1.0
    channels = {
        "speed": sign * speed,
        "voltage": sign * voltage,
        "phase": np.full(t.shape[0], _CLOSING if closing else _OPENING, float),
    }
    return Record(channels, {"speed": "rad/s", "voltage": "V", "phase": ""}, 1.0 / _RATE, source=f"example {fault} {seed}")


def example_records(fault: str, count: int, first_seed: int) -> list[Record]:
    """`count` movements with consecutive seeds."""
    return [example_record(fault, first_seed + k) for k in range(count)]


def _low_pass(u: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    a = float(np.exp(-1.0 / (_RATE * _T)))
    return np.asarray(lfilter([1.0 - a], [1.0, -a], u))
