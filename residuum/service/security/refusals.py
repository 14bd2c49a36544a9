"""Refusals: who was turned away, from where and what for, in the log at once, and counted together
for the audit trail.

Whoever can reach the port can be refused a thousand times a second. So the trail gets an entry for
all equal refusals of some seconds, and of more different ones than are kept their number alone.
"""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass

import structlog

log = structlog.get_logger()

# Different refusals that are kept until they are taken.
_MOST = 20
# Characters of a path: whoever is refused chooses it.
_LONGEST = 100


@dataclass(frozen=True)
class Refusal:
    """One kind of refusal; `by` is the name of the key, None for one that nobody knows."""

    address: str
    by: str | None
    method: str
    path: str
    status: int


OTHERS = Refusal("many", None, "-", "-", 0)
"""Stands for all refusals that are more than are kept apart."""


class Refusals:
    """Refusals since they were last taken; safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counted: Counter[Refusal] = Counter()

    def note(
        self, address: str, by: str | None, method: str, path: str, status: int, reason: str
    ) -> None:
        """Log a refusal, and count it for the trail."""
        shown = "".join(char if char.isprintable() else "?" for char in path[:_LONGEST])
        refusal = Refusal(address[:64], by, method[:10], shown, status)
        log.warning(
            "refused",
            address=refusal.address,
            key=by,
            method=refusal.method,
            path=refusal.path,
            status=status,
            reason=reason,
        )
        with self._lock:
            known = refusal in self._counted or len(self._counted) < _MOST
            self._counted[refusal if known else OTHERS] += 1

    def take(self) -> list[tuple[Refusal, int]]:
        """All, with how often each was; from now on it is counted anew."""
        with self._lock:
            taken, self._counted = self._counted, Counter()
        return list(taken.items())
