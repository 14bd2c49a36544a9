"""Where on the broker windows, receipts and the news of stored windows are."""

from __future__ import annotations

from zlib import crc32

PARTITIONS = 64
"""Parts into which the machines are divided; scorers share them, so there can be at most so many."""


def partition_of(asset: str) -> int:
    """The partition of a machine, the same for ever.

    >>> partition_of("press-1") == partition_of("press-1") < PARTITIONS
    True
    """
    return crc32(asset.encode()) % PARTITIONS


def window_topic(prefix: str, asset: str, gateway: str, key: str) -> str:
    """Where a window is published."""
    return f"{prefix}/windows/{partition_of(asset)}/{gateway}/{key}"


def windows_of_part(prefix: str, part: int, parts: int) -> list[str]:
    """What the scorer `part` (from 1) of so many subscribes to.

    >>> len(windows_of_part("residuum", 1, 2)) + len(windows_of_part("residuum", 2, 2)) == PARTITIONS
    True
    """
    return [f"{prefix}/windows/{number}/+/+" for number in range(part - 1, PARTITIONS, parts)]


def receipt_topic(prefix: str, gateway: str) -> str:
    """Where a gateway is told which of its windows are stored."""
    return f"{prefix}/receipts/{gateway}"


def stored_topic(prefix: str) -> str:
    """Where services are told which windows scorers have stored."""
    return f"{prefix}/stored"
