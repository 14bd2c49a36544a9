"""Give the memory of large arrays back to the system at once, so that a burst of requests leaves no mark on the process."""

from __future__ import annotations

import ctypes

LARGE = 1 << 20
"""Bytes from which an array gets pages of its own."""
_M_MMAP_THRESHOLD = -3


def give_back_large_arrays() -> bool:
    """Fix the size from which the C library maps allocations apart; False where the library has no such setting.

    Left alone, glibc raises this size up to 32 MB with every large array that is freed; such arrays then come from the heaps of
    the threads, which keep what they once held: twenty pages that each look at 10⁶ samples left tens of megabytes behind.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, LARGE))
