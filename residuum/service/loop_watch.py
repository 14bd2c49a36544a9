"""How long the event loop is held up: everything that the service answers waits for it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

TICK = 0.05
"""Seconds between looks."""


async def watch_loop(tell: Callable[[float], None], tick: float = TICK) -> None:
    """Tell again and again by how many seconds a timer of the running loop was late; ends when it is cancelled.

    A stall of length s is seen as at least s − `tick`.
    """
    loop = asyncio.get_running_loop()
    while True:
        due = loop.time() + tick
        await asyncio.sleep(tick)
        tell(max(0.0, loop.time() - due))
