"""What a model leaves on unseen blocks, and when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from residuum.identification.physics import noise_floor
from residuum.identification.unseen_blocks.judged import Judged
from residuum.identification.unseen_blocks.looks import Court
from residuum.identification.unseen_blocks.verdict import share_of


@dataclass(frozen=True)
class Remaining:
    """What a model leaves on unseen blocks. `share` is of the power that the model left as it was, `times_noise` the largest
    RMS error over its measurement noise. `where` (from, to) [s] is the block of time in which most of it lies.
    """

    share: float
    times_noise: float
    where: tuple[float, float]


def remaining(base: Judged, best: Judged, court: Court) -> Remaining:
    """What `best` leaves of what `base` left."""
    data = court.data
    noise = np.nan_to_num(noise_floor(np.concatenate([e.Y for e in data.experiments])))
    times = best.rms[data.measured] / np.where(noise > 0.0, noise, np.nan)[data.measured]
    largest = float(np.nanmax(times)) if np.isfinite(times).any() else float("inf")
    where = int(np.argmax(court.scale.by_block(best.power)))
    return Remaining(1.0 - share_of(base, best).value, largest, data.times_of(where))
