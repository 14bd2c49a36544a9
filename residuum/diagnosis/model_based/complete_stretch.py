"""The longest stretch of a window in which every signal of the model was read."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from residuum.identification.record import Record


def complete_stretch(record: Record, signals: Iterable[str], fewest: float) -> Record:
    """The longest stretch without a missing sample of these signals; the record itself where that is not longer than `fewest`.

    A polled bus loses a sample now and then. A simulation cannot go on over a missing input, and none is invented; but what was
    read before it, or after it, is as good as any window.
    """
    lost = np.zeros(record.n, dtype=bool)
    for name in signals:
        if name in record.names:
            lost |= record.missing(name)
    ends = np.concatenate([[-1], np.flatnonzero(lost), [record.n]])
    lengths = np.diff(ends) - 1
    k = int(np.argmax(lengths))
    start = int(ends[k]) + 1
    return record.window(start, start + int(lengths[k])) if lost.any() and lengths[k] > fewest else record
