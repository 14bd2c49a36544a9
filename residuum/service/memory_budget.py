"""MemoryBudget: how much memory answers may take together while they are made; who finds no room
waits, and then is refused.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from residuum.identification.errors import BadInput

MIB = 2**20


class TooBusy(BadInput):
    """So many large answers are being made that there is no room for another; the message says what
    to do.
    """


class MemoryBudget:
    """Bytes that are shared by all, in the order in which they were asked for.

    To be used on one event loop. What asks for more than there is at all gets all there is, alone.

    Parameters
    ----------
    total : int
        Bytes.
    most_waiting : int
        Who would be behind so many others is refused at once.
    patience : float
        Seconds after which who waits is refused.
    """

    def __init__(self, total: int, most_waiting: int = 200, patience: float = 20.0) -> None:
        self._total, self._free = total, total
        self._most_waiting, self._patience = most_waiting, patience
        self._waiting: deque[tuple[int, asyncio.Future[None]]] = deque()

    @asynccontextmanager
    async def hold(self, size: int) -> AsyncIterator[None]:
        """Hold so many bytes; TooBusy where there is no room in time."""
        size = min(size, self._total)
        await self._take(size)
        try:
            yield
        finally:
            self._free += size
            self._hand_on()

    async def _take(self, size: int) -> None:
        # who comes now stands behind those who wait: small answers must not starve a large one
        if not self._waiting and size <= self._free:
            self._free -= size
            return
        if len(self._waiting) >= self._most_waiting:
            raise TooBusy(_WAY_ON)
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append((size, turn))
        try:
            # shielded: a client that leaves cancels its wait, and what it was given must come back
            await asyncio.wait_for(asyncio.shield(turn), self._patience)
        except BaseException as error:
            if turn.done() and not turn.cancelled():
                self._free += size  # it was given in the same moment
            else:
                self._waiting.remove((size, turn))
            self._hand_on()
            if isinstance(error, TimeoutError):
                raise TooBusy(_WAY_ON) from None
            raise

    def _hand_on(self) -> None:
        while self._waiting and self._waiting[0][0] <= self._free:
            size, turn = self._waiting.popleft()
            self._free -= size
            turn.set_result(None)


_WAY_ON = (
    "too many large answers are asked for at once; ask again later, for one at a time, with a"
    " smaller `limit` or shorter span"
)
