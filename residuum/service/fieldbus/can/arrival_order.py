"""ArrivalOrder: places of frames that carry no counter, as they come; a pause breaks them off."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from residuum.service.fieldbus.sequence import BREAK, Placed

_SHORTEST_PAUSE = 0.5
_FRAMES_OF_A_PAUSE = 4.0


class ArrivalOrder:
    """Numbers frames in the order in which they come; single losses cannot be seen, and what they were worth is not known.

    A time without frames of more than half a second, and of more than four frames' time, is a pause: the numbers advance by
    `BREAK`, and no window reaches across.

    Examples
    --------
    >>> order = ArrivalOrder()
    >>> order.place(np.zeros(3)).number
    array([0, 1, 2])
    >>> int(order.place(np.zeros(1), since=10.0, rate=100.0).number[0]) == 3 + BREAK
    True
    """

    def __init__(self) -> None:
        self._next = 0

    def place(self, counters: npt.NDArray[np.generic], since: float = 0.0, rate: float = 0.0) -> Placed:
        """Place the frames of one batch that comes `since` seconds after the one before, at a rate of `rate` frames a second.

        Of `counters`, shape (n,), only the length counts.
        """
        n = len(counters)
        waited = since - n / rate if rate else 0.0
        paused = bool(waited > max(_SHORTEST_PAUSE, _FRAMES_OF_A_PAUSE / (rate or np.inf)))
        begin = self._next + BREAK * paused
        self._next = begin + n
        return Placed(np.arange(begin, begin + n, dtype=np.int64), np.ones(n, bool), jumps=int(paused))
