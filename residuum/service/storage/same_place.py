"""SamePlace: whether what is open is still what its names mean, so that the next start finds what is written now."""

from __future__ import annotations

from pathlib import Path

from residuum.service.store import StorageUnavailable


class SamePlace:
    """The folder of signal blocks and the file of the database, known by device and inode.

    A folder or file that is moved or removed stays open, and takes writes that nobody ever finds again.

    Parameters
    ----------
    places : Path or None
        Folders and files that are there; None for a database that is no file.
    """

    def __init__(self, *places: Path | None) -> None:
        self._known = {place: _identity(place) for place in places if place is not None}

    def check(self) -> None:
        """Raise StorageUnavailable when one of them is not there any more, or another one."""
        for place, known in self._known.items():
            if _identity(place) != known:
                says = "was moved, removed or replaced while the service runs; put it back, or start the service again"
                raise StorageUnavailable(f"{place}: {says}")


def _identity(place: Path) -> tuple[int, int] | None:
    try:
        found = place.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino
