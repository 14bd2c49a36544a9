"""What the imports left in memory, and the garbage collector."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def loading_modules() -> Iterator[None]:
    """Import here what a command needs: nothing is collected meanwhile, and what is in memory
    afterwards is left alone.

    Modules are no garbage, yet every few hundred objects that they make the collector looks through
    all of them: a quarter of the seconds that imports take.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
    leave_loaded_modules()


def leave_loaded_modules() -> None:
    """Let later collections, and those at the end of the process, pass over what is in memory now,
    once a process.

    Half a million objects of the libraries stay until the end; to look through them takes a tenth
    of a second each time.
    """
    if gc.get_freeze_count() == 0:
        gc.freeze()


def settle_memory() -> None:
    """Take all that there is now out of the collector's rounds.

    The libraries are a million objects; a round over them takes 100 ms and more, in which nobody is
    answered. For the process of a service alone, once it has started: what is garbage by then is
    collected first, and later garbage as ever.
    """
    gc.collect()
    gc.freeze()
