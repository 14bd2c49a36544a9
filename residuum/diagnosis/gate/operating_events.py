"""Operating events of a gate that are no damage: cut short, obstacle, supply sag, manual
pushing.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from residuum.diagnosis.gate.movements import Movement, flat_part, smoothed

Signal = npt.NDArray[np.float64]
_SAG = 0.04  # of the flat voltage; eight times the usual wander of a mains supply
_FULL = 0.98  # of the flat voltage: beyond the ramps
_SAG_SMOOTHING = 0.1  # s
_NO_RAMP = (
    0.5  # of the flat voltage at the last sample: the movement ended without its falling ramp
)
_SLOWED = 0.85  # of the flat speed at the last sample
_SHORTENED = 0.85  # of the shortest travel in training
_SLOW = 0.6  # s; a tooth passes in less than a tenth of it
_SLOW_RATE = 50.0  # Hz


class OperatingEvent(StrEnum):
    """What happened to a movement that therefore says nothing about teeth."""

    CUT_SHORT = "cut-short"
    OBSTACLE = "obstacle-stop"
    SUPPLY_SAG = "supply-sag"
    MANUAL_PUSH = "manual-pushing"


@dataclass(frozen=True)
class Happened:
    """An operating event with the numbers that show it, in one sentence."""

    event: OperatingEvent
    says: str


def event_of_profile(movement: Movement, shortest_travel: float) -> Happened | None:
    """The event that voltage and speed profile show before any model is used, or None.

    `shortest_travel` is the least motor angle of a training movement [rad]; 0 does not judge the
    travel.
    """
    flat, level = flat_part(movement)
    smooth = smoothed(movement.voltage, movement.sample_time, _SAG_SMOOTHING)
    flat_speed = float(np.median(movement.speed[flat]))
    last = slice(max(0, movement.n - round(0.02 / movement.sample_time)), movement.n)
    if np.median(movement.voltage[last]) > _NO_RAMP * level:
        return _ended_without_ramp(movement, float(np.min(movement.speed[last])), flat_speed)
    full = np.flatnonzero(smooth >= _FULL * level)
    inside = smooth[full[0] : full[-1] + 1]
    lowest = float(np.min(inside))
    if lowest < (1.0 - _SAG) * level:
        seconds = float(np.count_nonzero(inside < (1.0 - _SAG) * level)) * movement.sample_time
        return Happened(
            OperatingEvent.SUPPLY_SAG,
            f"the supply sagged from {level:.1f} V to {lowest:.1f} V for {seconds:.2f} s while the"
            " gate ran at full voltage",
        )
    travel = float(movement.motor_angle[-1])
    if travel < _SHORTENED * shortest_travel:
        return Happened(
            OperatingEvent.CUT_SHORT,
            f"the motor turned {travel / (2 * np.pi):.0f} times, the shortest trained movement"
            f" takes {shortest_travel / (2 * np.pi):.0f} turns",
        )
    return None


def _ended_without_ramp(movement: Movement, last_speed: float, flat_speed: float) -> Happened:
    if last_speed < _SLOWED * flat_speed:
        return Happened(
            OperatingEvent.OBSTACLE,
            f"the motor was driven down from {flat_speed:.0f} to {last_speed:.0f} rad/s under full"
            f" voltage at {movement.duration:.1f} s and stopped without a falling ramp",
        )
    return Happened(
        OperatingEvent.CUT_SHORT,
        f"the movement breaks off at full voltage after {movement.duration:.1f} s, without its"
        " ramp",
    )


def slow_residual(residual: Signal, sample_time: float) -> float:
    """Largest magnitude of the residual's running median over 0.6 s [unit of the residual].

    A person pushing the gate, or wind, moves it; a tooth, which passes in less than half that time,
    does not.
    """
    step = max(1, round(1.0 / (_SLOW_RATE * sample_time)))
    coarse = residual[: residual.shape[0] // step * step].reshape(-1, step)
    half = round(_SLOW * _SLOW_RATE / 2)
    running = median_filter(np.median(coarse, axis=1), 2 * half + 1)
    whole_windows = running[half : running.shape[0] - half]
    return float(np.max(np.abs(whole_windows), initial=0.0))


def manual_push(slow: float, limit: float) -> Happened | None:
    """The event when the slow residual [rad/s] is beyond its limit, or None."""
    if slow <= limit:
        return None
    return Happened(
        OperatingEvent.MANUAL_PUSH,
        f"for over half a second the motor ran {slow:.1f} rad/s off its model (limit {limit:.1f}"
        " rad/s): something pushed or held the gate",
    )
