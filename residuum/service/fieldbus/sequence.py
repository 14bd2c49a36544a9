"""SequenceCounter: turns a counter that wraps into numbers that do not, and tells loss, repetition
and disorder apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.source import Numbers

BREAK = 1 << 32
"""How far the numbers advance where the distance is unknown; no window reaches across."""

# Missing numbers that a late frame may still fill; a hole of 2³⁰ frames must not fill the memory.
_REMEMBERED = 8192


@dataclass(frozen=True)
class Placed:
    """Where a batch of frames belongs.

    `number` is the place of each frame, shape (n,); `keep` is False for repetitions. `lost` counts
    frames newly missing minus frames that filled an earlier hole.
    """

    number: Numbers
    keep: npt.NDArray[np.bool_]
    lost: int = 0
    duplicated: int = 0
    reordered: int = 0
    jumps: int = 0


class SequenceCounter:
    """Unwraps a sequence counter of `bits` bits.

    A step ahead of up to a quarter of the counter's range is a loss. A step back to a number that
    is missing is a late frame; a step back of up to an eighth of the range to one that is not is a
    repetition; anything else is a jump: the sender has restarted, and the numbers advance by
    `BREAK`. A counter that goes on where it stopped, however long after, belongs to a sender that
    paused; after any other silence long enough for the counter to have wrapped, the number of
    frames lost is the one nearest to silence × rate that the counter allows.

    Parameters
    ----------
    bits : int
        Width of the counter, 4 to 32.

    Examples
    --------
    >>> counter = SequenceCounter(bits=10)
    >>> counter.place(np.array([1022, 1023, 0, 2, 1, 1])).number
    array([1022, 1023, 1024, 1026, 1025, 1025])
    """

    def __init__(self, bits: int) -> None:
        if not 4 <= bits <= 32:
            raise ValueError(f"SequenceCounter, bits: is {bits}; must be 4 to 32")
        self._modulus = 1 << bits
        self._next: int | None = None
        self._missing: dict[int, None] = {}

    def place(
        self, counters: npt.NDArray[np.integer], silence: float = 0.0, rate: float = 0.0
    ) -> Placed:
        """Place the frames of one batch, in their order of arrival.

        `silence` is how long the bus was seen empty before this batch [s], `rate` the frames a
        second it carries otherwise.
        """
        n = len(counters)
        if n == 0:
            return Placed(np.empty(0, np.int64), np.empty(0, bool))
        values = counters.astype(np.int64)
        if self._next is None:
            self._next = int(values[0])
        wrapped = self._wraps(int(values[0]), silence, rate)
        expected = self._next + np.arange(n, dtype=np.int64)
        # nearly every batch is whole and in order: placed at once, without a loop over its frames
        if not wrapped and not ((values - expected) % self._modulus).any():
            self._next += n
            return Placed(expected, np.ones(n, bool))
        return self._place_one_by_one(values, wrapped)

    def _wraps(self, first: int, silence: float, rate: float) -> int:
        """Whole turns of the counter that the silence hides."""
        if silence * rate < self._modulus / 4 or self._next is None:
            return 0
        # a step of 0: the counter goes on where it stopped, the sender paused
        step = (first - self._next) % self._modulus
        return max(0, round((silence * rate - step) / self._modulus)) if step else 0

    def _place_one_by_one(self, values: Numbers, wrapped: int) -> Placed:
        following = self._next if self._next is not None else int(values[0])
        number, keep = np.empty(len(values), np.int64), np.ones(len(values), bool)
        lost = duplicated = reordered = jumps = 0
        half = self._modulus // 2
        for k, value in enumerate(values.tolist()):
            step = (value - following) % self._modulus
            # only before the first frame there was a silence to hide turns of the counter
            if k == 0 and wrapped:
                skipped = step + wrapped * self._modulus
                lost += skipped
                following += skipped
                step = 0
            if step >= half:
                step -= self._modulus
            place = following + step
            # a number that is missing before one that was there: a late frame is no repetition
            if step < 0 and place in self._missing:
                del self._missing[place]
                reordered += 1
                lost -= 1
            elif -self._modulus // 8 <= step < 0:
                keep[k] = False
                duplicated += 1
            elif 0 <= step <= self._modulus // 4:
                lost += step
                self._remember(range(following, place))
                following = place + 1
            else:
                jumps += 1
                # of the sender before its restart nothing can come late any more
                self._missing.clear()
                place = (following // self._modulus) * self._modulus + BREAK + value
                following = place + 1
            number[k] = place
        self._next = following
        return Placed(number, keep, lost, duplicated, reordered, jumps)

    def _remember(self, missing: range) -> None:
        self._missing.update(dict.fromkeys(missing))
        while len(self._missing) > _REMEMBERED:
            del self._missing[next(iter(self._missing))]
