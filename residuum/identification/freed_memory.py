"""Freed memory is kept for the next array: the system would give its pages back one by one, each of them zeroed."""

import ctypes
from functools import lru_cache

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8
"""Names of the settings in glibc's malloc.h."""
_KEPT = 64 << 20
"""Bytes up to which an array comes from kept memory, and which at most are kept at the end of the heap."""


@lru_cache(maxsize=1)
def keep_freed_memory() -> None:
    """For the rest of the process; on C libraries without these settings nothing happens.

    Simulations with sensitivities allocate a few megabytes each, thousands of times: page faults were a fifth of the time.
    """
    set_ = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_ is not None:
        for setting, value in ((_MMAP_THRESHOLD, _KEPT), (_TRIM_THRESHOLD, _KEPT), (_ARENA_MAX, 2)):
            set_(setting, value)
