"""Movements of a gate: one opening or closing, cut out of a record by its phase signal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d
from scipy.signal import firwin, resample_poly

from residuum.identification.errors import BadInput
from residuum.identification.record import Record

# The residual over the gate's way: a damaged rack tooth stays at its place, noise and gusts do
# not.

Signal = npt.NDArray[np.float64]
BINS = 200  # of the whole way: 14 mm of a gate of 2.85 m, about a rack tooth


@dataclass(frozen=True, eq=False)
class PositionProfile:
    """Largest pulse statistic at each place.

    `statistic`, shape (BINS,), in standard deviations, NaN where the gate only ramps; bin 0 is the
    closed gate, whichever way the movement went.
    """

    statistic: Signal

    @property
    def place(self) -> float:
        """Fraction of the way, from the closed gate, where the statistic is largest."""
        return (float(np.nanargmax(self.statistic)) + 0.5) / BINS

    @property
    def contrast(self) -> float:
        """How far the largest bin stands out of the others: (largest − median) / (1.4826 · median
        absolute deviation).
        """
        median = float(np.nanmedian(self.statistic))
        deviation = 1.4826 * float(np.nanmedian(np.abs(self.statistic - median)))
        return (float(np.nanmax(self.statistic)) - median) / max(deviation, np.finfo(float).tiny)


def position_profile(statistic: Signal, position: Signal) -> PositionProfile:
    """Largest |statistic| in each bin of `position` (fraction of the way from the closed gate);
    both of shape (n,).
    """
    profile = np.full(BINS, -np.inf)
    np.maximum.at(profile, np.clip((position * BINS).astype(int), 0, BINS - 1), np.abs(statistic))
    return PositionProfile(np.where(np.isfinite(profile), profile, np.nan))


def average_profile(profiles: Sequence[PositionProfile]) -> PositionProfile:
    """Mean over movements, bin by bin, opening and closing alike.

    What stays at its place keeps its height while the scatter of the rest shrinks with √movements,
    so the contrast of a damage too small for one movement grows. Fails for a gate whose movements
    start at other places than its ends.

    >>> rng = np.random.default_rng(0)
    >>> way = np.linspace(0, 1, 5000)
    >>> damage = 2.5 * (abs(way - 0.4) < 0.002)
    >>> noises = [rng.standard_normal(5000) for _ in range(12)]
    >>> profiles = [position_profile(noise + damage, way) for noise in noises]
    >>> average = average_profile(profiles)
    >>> typical = np.median([profile.contrast for profile in profiles])
    >>> round(average.place, 2), bool(average.contrast > 2 * typical)
    (0.4, True)
    """
    if not profiles:
        raise BadInput("average over the way: no movement is given; at least one is needed")
    stacked = np.array([profile.statistic for profile in profiles])
    finite = np.isfinite(stacked)
    total = np.where(finite, stacked, 0.0).sum(axis=0)
    return PositionProfile(
        np.where(finite.any(axis=0), total / np.maximum(finite.sum(axis=0), 1), np.nan)
    )


_SHORTEST = 0.05  # s; shorter runs of the phase signal are no movement
_SMOOTHING = 0.05  # s; five periods of the 100 Hz pulse-width modulation
_DRIVEN = (
    0.05  # of the largest voltage: the gate is driven (only used when there is no phase signal)
)
_FLAT = 0.95  # of the flat level: the ramp has ended
_KEPT_BAND = 0.8  # of the reduced Nyquist frequency


class Direction(StrEnum):
    """Which way the gate moves."""

    OPENING = "opening"
    CLOSING = "closing"


_DIRECTIONS = {1: Direction.OPENING, 2: Direction.CLOSING}


@dataclass(frozen=True, eq=False)
class Movement:
    """One movement, with the motor's forward direction positive whichever way the gate goes.

    Parameters
    ----------
    direction : Direction
    sample_time : float
        [s]
    speed, voltage : array, shape (n,)
        Motor speed ω_M [rad/s] and motor voltage V [V].
    current : array, shape (n,), or None
        Motor current i [A].
    start : int
        First sample in the record it was cut from.
    """

    direction: Direction
    sample_time: float
    speed: Signal
    voltage: Signal
    current: Signal | None = None
    start: int = 0

    @property
    def n(self) -> int:
        """Number of samples."""
        return int(self.speed.shape[0])

    @property
    def duration(self) -> float:
        """n sample times [s]."""
        return self.n * self.sample_time

    @property
    def motor_angle(self) -> Signal:
        """∫ω_M dt from the start of the movement [rad], shape (n,)."""
        return np.asarray(np.cumsum(self.speed) * self.sample_time)

    def reduced(self, rate: float) -> Movement:
        """The movement low-passed and sampled at about `rate` Hz (a whole fraction of its own
        rate).
        """
        factor = max(1, round(1.0 / (self.sample_time * rate)))
        if factor == 1:
            return self
        taps = np.asarray(firwin(10 * factor + 1, _KEPT_BAND / factor))
        speed, voltage = _reduce(self.speed, factor, taps), _reduce(self.voltage, factor, taps)
        current = None if self.current is None else _reduce(self.current, factor, taps)
        return Movement(
            self.direction, self.sample_time * factor, speed, voltage, current, self.start
        )


def cut_movements(record: Record) -> list[Movement]:
    """Every movement in a record, in their order.

    A movement is a run of samples in which the phase is 1 (opening) or 2 (closing); without a phase
    signal, in which the motor is driven (|V| above 5 % of its largest value, smoothed over the
    pulse-width modulation), positive voltage opening.

    Parameters
    ----------
    record : Record
        Channels `speed`, `voltage` and, if there, `current` and `phase`; no missing sample.
    """
    speed, voltage = record.in_unit("speed", "rad/s"), record.in_unit("voltage", "V")
    current = record.in_unit("current", "A") if "current" in record.names else None
    phase = _phase(record, voltage)
    edges = np.flatnonzero(np.diff(phase)) + 1
    runs = zip([0, *edges], [*edges, record.n], strict=True)
    movements = []
    for start, stop in runs:
        if phase[start] == 0 or (stop - start) * record.sample_time < _SHORTEST:
            continue
        run = slice(int(start), int(stop))
        direction, Ts = _DIRECTIONS[int(phase[start])], record.sample_time
        current_run = None if current is None else _forward(current[run])
        movements.append(
            Movement(
                direction, Ts, _forward(speed[run]), _forward(voltage[run]), current_run, int(start)
            )
        )
    return movements


def flat_part(movement: Movement) -> tuple[slice, float]:
    """Where the voltage is past its rising and before its falling ramp, and its level there [V].

    The level is the median voltage (smoothed over the pulse-width modulation) of the driven
    samples; the flat part reaches from the first to the last sample at 95 % of it, so a dip between
    them stays inside.
    """
    smooth = smoothed(movement.voltage, movement.sample_time)
    level = float(np.median(smooth[smooth > 0.5 * np.max(smooth)])) if np.max(smooth) > 0 else 0.0
    reached = np.flatnonzero(smooth >= _FLAT * level)
    return slice(int(reached[0]), int(reached[-1]) + 1), level


def smoothed(x: Signal, sample_time: float, seconds: float = _SMOOTHING) -> Signal:
    """Moving average over `seconds`, the same length."""
    return np.asarray(uniform_filter1d(x, max(1, round(seconds / sample_time)), mode="nearest"))


def _phase(record: Record, voltage: Signal) -> npt.NDArray[np.int_]:
    if "phase" in record.names:
        phase = np.rint(record["phase"]).astype(int)
        return np.where(np.isin(phase, list(_DIRECTIONS)), phase, 0)
    smooth = smoothed(voltage, record.sample_time)
    driven = np.abs(smooth) > _DRIVEN * np.max(np.abs(smooth))
    return np.where(driven, np.where(smooth > 0, 1, 2), 0)


def _forward(x: Signal) -> Signal:
    return x if np.mean(x) >= 0 else -x


def _reduce(x: Signal, factor: int, taps: Signal) -> Signal:
    return np.asarray(resample_poly(x, 1, factor, window=taps, padtype="line"))
