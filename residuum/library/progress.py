"""Progress of long work: told to a caller's function, or shown on one line of a terminal or
notebook.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Tell = Callable[[float, str], None]
"""Called with the share done (0 … 1) and what is being done. What it raises ends the work and comes
out of it.
"""
Progress = Tell | bool | None
"""A function to tell, True or False to show or hide the line, None to show it where somebody
watches.
"""

# Characters of the line, which must not wrap: a terminal has 80.
_WIDTH = 78


@contextmanager
def progress_shown(progress: Progress = None) -> Iterator[Tell]:
    """The function that long work tells how far it is; the line it shows is wiped at the end, and
    when interrupted.

    Examples
    --------
    >>> seen = []
    >>> with progress_shown(lambda share, doing: seen.append((share, doing))) as tell:
    ...     tell(0.5, "half")
    >>> seen
    [(0.5, 'half')]
    """
    if callable(progress):
        yield progress
        return
    if not (_watched() if progress is None else progress):
        yield lambda share, doing: None
        return
    try:
        yield _show
    finally:
        # Also where the work ends in an error, whose message would else stand behind the line. On
        # standard error, for standard output holds the answer.
        sys.stderr.write("\r" + " " * _WIDTH + "\r")
        sys.stderr.flush()


def _show(share: float, doing: str) -> None:
    sys.stderr.write("\r" + f"{100 * share:3.0f} % {doing}"[:_WIDTH].ljust(_WIDTH))
    sys.stderr.flush()


def _watched() -> bool:
    """Whether a person looks at standard error: a terminal, or a notebook's cell."""
    # A notebook's standard error is no terminal, and yet shows a line that is written over.
    return sys.stderr.isatty() or "ipykernel" in sys.modules
