"""What the C library does with the memory of large arrays once they are freed: each process says which it wants, when it begins.

A service gives it back to the system at once, so that a burst of requests leaves no mark on it. A command that computes for
seconds, in a process of its own, keeps it for the next array.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping

LARGE = 1 << 20
"""Bytes from which an array gets pages of its own in a service."""
_KEPT = 64 << 20
"""Bytes up to which an array comes from kept memory, and which at most are kept at the end of the heap."""
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8
"""Names of the settings in glibc's malloc.h."""


def give_back_large_arrays() -> bool:
    """Fix the size from which the C library maps allocations apart; False where the library has no such setting.

    Left alone, glibc raises this size up to 32 MB with every large array that is freed; such arrays then come from the heaps of
    the threads, which keep what they once held: twenty pages that each look at 10⁶ samples left tens of megabytes behind.
    """
    return _set({_MMAP_THRESHOLD: LARGE})


def keep_large_arrays() -> bool:
    """Keep freed memory for the next array; False where the library has no such settings.

    Simulations with sensitivities allocate a few megabytes each, thousands of times: left alone, the system gives and takes every
    page anew, and zeroes it, which is a fifth of the time that explaining takes.
    """
    return _set({_MMAP_THRESHOLD: _KEPT, _TRIM_THRESHOLD: _KEPT, _ARENA_MAX: 2})


def _set(settings: Mapping[int, int]) -> bool:
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return all(mallopt(name, value) for name, value in settings.items())
