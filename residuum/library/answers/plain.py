"""Results as plain JSON values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def finite(value: float) -> float | None:
    """The number, None for one that JSON cannot tell."""
    return value if math.isfinite(value) else None


def to_plain(value: Any) -> Any:
    """JSON values only: arrays become lists, NumPy numbers Python ones, non-finite numbers null."""
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return to_plain(value.tolist())
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if isinstance(value, np.generic):
        return to_plain(value.item())
    return finite(value) if isinstance(value, float) else value
