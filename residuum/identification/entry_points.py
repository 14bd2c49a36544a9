"""What other installed packages add: objects named by their entry points."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from importlib.metadata import entry_points
from typing import Any


def from_entry_points(group: str) -> Iterator[Any]:
    """Each object of a group (`residuum.effects`, `residuum.diagnosers`); what cannot be loaded is
    left out, with a warning.
    """
    for point in entry_points(group=group):
        try:
            yield point.load()
        # Whatever another package raises at its import: it must not end a command that does not
        # need it.
        except Exception as error:
            warnings.warn(
                f"entry point {point.name!r} of {group}: cannot be loaded ({error})",
                RuntimeWarning,
                stacklevel=2,
            )
