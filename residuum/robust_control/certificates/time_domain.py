"""Step responses of a loop over sampled plants: overshoot, settling time, integral absolute error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.signal import lfilter

from residuum.array_types import FloatArray
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.loop import characteristic


@dataclass(frozen=True)
class StepResponse:
    """Of one closed loop to a unit step of the reference.

    `overshoot` (0.1 = 10 %) and `settling_time` [s] into ±2 % of the final value 1 (infinite when it is not reached within
    the horizon), `integral_absolute_error` [s] = Ts Σ|1 − y|, (2.40) with its missing sample time.
    """

    overshoot: float
    settling_time: float
    integral_absolute_error: float


def step_response(plant: TransferFunction, controller: TransferFunction, duration: float) -> FloatArray:
    """y of the closed loop T = GK/(1 + GK) for a unit step, shape (n,); grows without bound for an unstable loop."""
    return _unit_step(plant, controller, plant.num, duration)


def control_response(plant: TransferFunction, controller: TransferFunction, duration: float) -> FloatArray:
    """u = K/(1 + GK) r, what the controller asks of the actuator for a unit step of the reference, shape (n,)."""
    return _unit_step(plant, controller, plant.den, duration)


def _unit_step(plant: TransferFunction, controller: TransferFunction, path: FloatArray, duration: float) -> FloatArray:
    """The unit step's response of `path` · K's numerator over the loop's characteristic polynomial."""
    n = max(2, round(duration / float(plant.sample_time or 0.0)))
    den = characteristic(plant, controller)
    num = np.polymul(path, controller.num)
    num = np.concatenate([np.zeros(len(den) - len(num)), num])
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(lfilter(num, den, np.ones(n)), dtype=float)


def assess(y: FloatArray, sample_time: float) -> StepResponse:
    """The figures of a step response."""
    if not np.isfinite(y).all():
        return StepResponse(float("inf"), float("inf"), float("inf"))
    outside = np.flatnonzero(np.abs(y - 1.0) > 0.02)
    last = int(outside[-1]) + 1 if outside.size else 0
    settled = last * sample_time if last < len(y) else float("inf")
    return StepResponse(max(0.0, float(y.max() - 1.0)), settled, float(sample_time * np.abs(1.0 - y).sum()))


def over_plants(plants: Sequence[TransferFunction], controller: TransferFunction, duration: float) -> list[StepResponse]:
    """The figures for every plant."""
    return [assess(step_response(plant, controller, duration), float(plant.sample_time or 0.0)) for plant in plants]


_NARROW, _OVERSHOOT_STEP = 0.1, 0.005


@dataclass(frozen=True)
class Measured:
    """Step responses of the nominal loop and of drawn plants, to be held against what was promised."""

    nominal: StepResponse
    drawn: tuple[StepResponse, ...]

    def reached_by(self, share: float) -> tuple[float, float]:
        """(overshoot, settling time [s]) that this share of the drawn plants stays below, each for itself."""
        return (
            float(np.quantile([step.overshoot for step in self.drawn], share, method="higher")),
            float(np.quantile([step.settling_time for step in self.drawn], share, method="higher")),
        )

    def is_sure_of(self, share: float, sample_time: float) -> bool:
        """Whether the 95 % intervals of both `reached_by` are narrow: a tenth of the value, else a sample, half a per cent.

        The interval of a quantile lies between two of the ordered values, whose ranks are those of a binomial law.
        """
        n = len(self.drawn)
        ranks = stats.binom.ppf([0.025, 0.975], n, share).astype(int)
        low, high = np.clip(ranks - [1, 0], 0, n - 1)
        for name, least in (("overshoot", _OVERSHOOT_STEP), ("settling_time", sample_time)):
            values = np.sort([getattr(step, name) for step in self.drawn])
            if values[low] < values[high] and not values[high] - values[low] <= max(_NARROW * values[low], 1.001 * least):
                return False
        return True

    def kept(self, overshoot: float, settling_time: float) -> tuple[bool, float]:
        """Whether the nominal loop stays within both, and the share of the drawn plants that does."""

        def within(step: StepResponse) -> bool:
            return step.overshoot <= overshoot and step.settling_time <= settling_time

        return within(self.nominal), float(np.mean([within(step) for step in self.drawn]))


def measured(
    nominal: TransferFunction, plants: Sequence[TransferFunction], controller: TransferFunction, duration: float
) -> Measured:
    """Follow the steps of the nominal loop and of every drawn plant for `duration` [s]."""
    first, *others = over_plants([nominal, *plants], controller, duration)
    return Measured(first, tuple(others))
