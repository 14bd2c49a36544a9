"""What a service has loaded stays for its life: the garbage collector need not look at it again and
again.
"""

from __future__ import annotations

import gc


def settle_memory() -> None:
    """Take all that there is now out of the collector's rounds.

    The libraries are a million objects; a round over them takes 100 ms and more, in which nobody is
    answered. For the process of a service alone, once it has started: what is garbage by then is
    collected first, and later garbage as ever.
    """
    gc.collect()
    gc.freeze()
