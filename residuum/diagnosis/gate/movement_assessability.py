"""Can a record of the gate be judged at all? Rate, gaps, dead and clipped sensors, too few turns."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.gate.actuator_model import ActuatorConstants
from residuum.diagnosis.gate.movement_features import FEWEST_TURNS, whole_turns
from residuum.diagnosis.gate.movements import Movement, flat_part
from residuum.identification.record import Record

_RATE_TOLERANCE = 0.01
_CLIPPED = 0.1  # of the samples at full voltage stand at the largest value
_SHORTEST = 1.0  # s


def unusable_record(record: Record, rate: float) -> str | None:
    """Why no movement of the record can be judged, in one sentence; None when they can be looked at. `rate` in Hz."""
    if abs(record.sampling_rate / rate - 1.0) > _RATE_TOLERANCE:
        return f"sampled at {record.sampling_rate:.6g} Hz; trained at {rate:.6g} Hz"
    for name in ("speed", "voltage", "current", "phase"):
        if name not in record.names:
            continue
        if missing := int(np.count_nonzero(record.missing(name))):
            first = int(np.argmax(record.missing(name)))
            return f"gap: {missing} of {record.n} samples of {name} are missing, the first at {first * record.sample_time:.4g} s"
        if name != "phase" and record.n > 1 and float(np.ptp(record[name])) == 0.0:
            return f"flat: {name} stands at {float(record[name][0]):.4g} {record.units[name]} throughout"
    return None


def unusable_movement(movement: Movement, constants: ActuatorConstants) -> str | None:
    """Why one movement cannot be judged, in one sentence; None when it can."""
    if movement.duration < _SHORTEST:
        return f"too short: the movement lasts {movement.duration:.3g} s; at least {_SHORTEST:g} s are needed"
    if np.max(movement.voltage) <= 0 or np.max(movement.speed) <= 0:
        return "the motor is not driven during the movement"
    flat, level = flat_part(movement)
    if np.ptp(movement.speed[flat]) == 0.0:
        return f"flat: speed stands at {movement.speed[flat][0]:.4g} rad/s at full voltage"
    for name, signal in (("speed", movement.speed), ("current", movement.current)):
        if signal is not None and (share := _share_at_rail(signal[flat])) > _CLIPPED:
            top = float(np.max(signal[flat]))
            return f"clipped: {100 * share:.0f} % of the samples of {name} at full voltage stand at its largest value {top:.4g}"
    turns = whole_turns(movement, constants)
    if turns < FEWEST_TURNS:
        return (
            f"too short: {max(turns, 0.0):.1f} turns of the shaft at the full {level:.1f} V; at least {FEWEST_TURNS} are needed"
        )
    return None


def _share_at_rail(x: npt.NDArray[np.float64]) -> float:
    return float(np.mean(x >= np.max(x) - 1e-9 * np.ptp(x)))
