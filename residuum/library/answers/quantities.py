"""Numbers with their standard deviations and units, as the commands show them."""

import math
from collections.abc import Mapping
from typing import Any

from residuum.identification.unseen_blocks.verdict import Quantity


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
    digits = -math.floor(math.log10(std))
    return f"{round(value, digits) + 0.0:.12g} ± {round(std, digits):.12g} {unit}".rstrip()
