"""Waiting for the signal that ends a command which runs for ever."""

import signal
import sys
import threading
from types import FrameType


def until_interrupted(greeting: str) -> None:
    """Say that all has begun, and return when SIGINT or SIGTERM comes."""
    over = threading.Event()

    def end(_number: int, _frame: FrameType | None) -> None:
        over.set()

    # A terminal sends the first, systemd and Docker the second; both mean an end in good order.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    sys.stdout.write(f"{greeting}\n")
    sys.stdout.flush()
    # A wait without end would hold the signal back on some systems.
    while not over.wait(1.0):
        pass
