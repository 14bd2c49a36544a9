"""Ports for the servers that benchmarks start."""

from __future__ import annotations

import random
import socket
from contextlib import suppress

_chance = random.SystemRandom()


def free_port() -> int:
    """A port that nobody listens at, below those that the system gives to outgoing connections.

    A client that tries one of those again and again while its server is away is in the end connected to itself and holds it.
    """
    while True:
        port = _chance.randint(20_000, 32_000)
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
