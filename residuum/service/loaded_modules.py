"""What the imports left in memory, and the garbage collector."""

import gc


def leave_loaded_modules() -> None:
    """Let later collections pass over what is in memory now, once a process.

    Half a million objects of the libraries stay until the end; to look through them takes a tenth of a second each time.
    """
    if gc.get_freeze_count() == 0:
        gc.freeze()
