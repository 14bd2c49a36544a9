"""Results as plain JSON values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:  # the search is compiled, and every command writes its answer through here
    from residuum.identification.unseen_blocks.verdict import Quantity

# A test's p-value in words.

SMALLEST = 1e-300
"""Below which a number of double precision cannot tell one chance from another, or from none."""


def chance(p: float) -> str:
    """`p = 0.03`; no chance is nothing.

    >>> chance(0.0), chance(0.0312)
    ('p < 1e-300', 'p = 0.031')
    """
    return f"p < {SMALLEST:g}" if p < SMALLEST else f"p = {p:.2g}"


# Numbers with their standard deviations and units, as the commands show them.


def quantities_json(quantities: Mapping[str, Quantity]) -> dict[str, Any]:
    """Each with `value`, `std` (0 where it was held) and `unit`."""
    return {
        name: {"value": q.value, "std": q.std, "unit": q.unit} for name, q in quantities.items()
    }


def sizes_text(quantities: Mapping[str, Quantity]) -> str:
    """Each with its standard deviation, or as held where it was not estimated."""
    return ", ".join(_size(name, quantity) for name, quantity in quantities.items())


def _size(name: str, quantity: Quantity) -> str:
    return f"{name} = {value_text(quantity.value, quantity.std, quantity.unit)}" + (
        " (held)" if quantity.std == 0.0 else ""
    )


def value_text(value: float, std: float, unit: str) -> str:
    """A value to the digit in which its standard deviation begins; without one, or a usable one, to
    four digits.
    """
    if not 0.0 < std < math.inf:
        return f"{value:.4g} {unit}".rstrip() + ("" if std == 0.0 else " (not determined)")
    # The decimal in which the deviation begins; adding 0.0 makes 0 of a −0 that rounding left.
    digits = -math.floor(math.log10(std))
    return f"{round(value, digits) + 0.0:.12g} ± {round(std, digits):.12g} {unit}".rstrip()


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
