"""How each kind of fault shows in the primary residual M y − N u, per unit of its size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.generators.residual_generator import ResidualGenerator


@dataclass(frozen=True, eq=False)
class FaultContext:
    """What a signature is computed from: the generator and the record's input as deviation from the operating point."""

    generator: ResidualGenerator
    u: FloatArray

    def path(self, y: FloatArray, u: FloatArray) -> FloatArray:
        """M y − N u from rest."""
        generator = self.generator
        if generator.taps is not None:
            return y - np.convolve(u, generator.taps)[: len(u)] if np.any(u) else y
        if generator.observer is None:
            return y
        return generator.observer.simulate(np.column_stack([y, u]))[0][:, 0]

    def after(self, onset: int) -> FloatArray:
        """1 from sample `onset` on, 0 before."""
        return (np.arange(len(self.u)) >= onset).astype(float)


@dataclass(frozen=True)
class FaultKind:
    """One kind of fault.

    `signature(context, onset)` is the change of the primary residual for size 1, shape (n,). `per` says what the size is
    counted in: `output`, `input`, `output/s` or `` (a fraction). `shape` is that of the size over time: a step or a ramp.
    """

    meaning: str
    per: str
    signature: Callable[[FaultContext, int], FloatArray]
    shape: str = "step"


def _sensor_offset(context: FaultContext, onset: int) -> FloatArray:
    return context.path(context.after(onset), np.zeros_like(context.u))


def _sensor_drift(context: FaultContext, onset: int) -> FloatArray:
    elapsed = np.maximum(np.arange(len(context.u)) - onset + 1, 0) * context.generator.sample_time
    return context.path(elapsed, np.zeros_like(context.u))


def _sensor_gain(context: FaultContext, onset: int) -> FloatArray:
    """The healthy output is N u here (M = 1); an unstable plant's own output is not known, so its nominal one is taken."""
    healthy = -context.path(np.zeros_like(context.u), context.u) + context.generator.output_mean
    return context.path(healthy * context.after(onset), np.zeros_like(context.u))


def _actuator_gain(context: FaultContext, onset: int) -> FloatArray:
    applied = (context.u + context.generator.input_mean) * context.after(onset)
    return context.path(np.zeros_like(context.u), applied)


def _actuator_offset(context: FaultContext, onset: int) -> FloatArray:
    return -context.path(np.zeros_like(context.u), context.after(onset))


# The commoner kind first: where the data cannot tell two apart, the first is named and the other mentioned.
FAULT_KINDS: dict[str, FaultKind] = {
    "sensor-offset": FaultKind("y reads this much too high", "output", _sensor_offset),
    "actuator-gain": FaultKind("this fraction of the input's effect is lost", "", _actuator_gain),
    "sensor-drift": FaultKind("y runs away at this rate from the onset on", "output/s", _sensor_drift, "ramp"),
    "sensor-gain": FaultKind("y is multiplied by 1 + this", "", _sensor_gain),
    "actuator-offset": FaultKind("the plant gets this much more input than is recorded", "input", _actuator_offset),
}
