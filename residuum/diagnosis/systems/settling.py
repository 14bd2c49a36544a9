"""How long a stable system remembers."""

from __future__ import annotations

import numpy as np

from residuum.identification.linear_models.state_space import StateSpace

_LONGEST = 4096


def settled_length(system: StateSpace, part: float = 1e-4) -> int:
    """Samples after which the slowest mode of a stable system is down to this part of itself; 1 without states, 4096 at most."""
    if not system.order:
        return 1
    slowest = float(np.max(np.abs(system.poles)))
    if slowest <= 0.0:
        return system.order + 1
    return min(_LONGEST, system.order + 1 + int(np.ceil(np.log(part) / np.log(slowest))))
