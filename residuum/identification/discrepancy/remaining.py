"""What a model leaves on blocks kept aside, and when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from residuum.identification.discrepancy.held_out_blocks import Blocks, cross_judged, looked_at
from residuum.identification.physics import PhysicalModel


@dataclass(frozen=True)
class Remaining:
    """What a model leaves on the blocks kept aside.

    `share` of the power of the model that the blocks were cut with, `times_noise` the largest RMS error over its measurement
    noise, and the block of time `where` (from, to) [s] in which most of it lies.
    """

    share: float
    times_noise: float
    where: tuple[float, float]


def remaining_on(model: PhysicalModel, blocks: Blocks) -> Remaining | None:
    """What the model leaves on the blocks kept aside; None where it diverges."""
    base, trained = cross_judged(blocks.base, blocks), cross_judged(looked_at(model, blocks), blocks)
    if base is None or trained is None:
        return None
    after = trained[1]
    power = after.relative(base[1])
    times = after.rms / np.where(blocks.noise > 0, blocks.noise, np.nan)
    largest = float(np.nanmax(times)) if np.isfinite(times).any() else float("inf")
    return Remaining(float(power.sum()), largest, _times_of(blocks)[int(np.argmax(power))])


def _times_of(blocks: Blocks) -> list[tuple[float, float]]:
    """Begin and end [s] of every block."""
    found = [(np.inf, -np.inf)] * blocks.folds[0].blocks
    for fold in blocks.folds:
        for e, spans in zip(fold.test, fold.spans, strict=True):
            for begin, end, block in spans:
                first, last = found[block]
                found[block] = min(first, e.t0 + begin * e.sample_time), max(last, e.t0 + end * e.sample_time)
    return found
