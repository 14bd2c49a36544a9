"""The longest stretch of a window in which every signal of the model was read."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from residuum.identification.record import Record
from residuum.identification.residual_analysis.noise.coloured_noise import stretches


def complete_stretch(record: Record, signals: Iterable[str], fewest: float) -> Record:
    """The longest stretch without a missing sample of these signals; the record itself where that is not longer than `fewest`.

    A polled bus loses a sample now and then. A simulation cannot go on over a missing input, and none is invented; but what was
    read before it, or after it, is as good as any window.
    """
    lost = np.zeros(record.n, dtype=bool)
    for name in signals:
        if name in record.names:
            lost |= record.missing(name)
    longest = max(stretches(~lost), key=lambda run: run.stop - run.start, default=slice(0, 0))
    n = longest.stop - longest.start
    return record.window(longest.start, longest.stop) if fewest < n < record.n else record
