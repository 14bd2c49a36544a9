"""Numbers with their standard deviations and units, as the commands show them."""

from collections.abc import Mapping
from typing import Any

from residuum.identification.discrepancy.judgement import Quantity


def quantities_json(quantities: Mapping[str, Quantity]) -> dict[str, Any]:
    """Each with `value`, `std` (0 where it was held) and `unit`."""
    return {name: {"value": q.value, "std": q.std, "unit": q.unit} for name, q in quantities.items()}


def sizes_text(quantities: Mapping[str, Quantity]) -> str:
    """Each with its standard deviation, or as held where it was not estimated."""
    return ", ".join(_size(name, quantity) for name, quantity in quantities.items())


def _size(name: str, quantity: Quantity) -> str:
    if quantity.std == 0.0:
        return f"{name} = {quantity.value:.4g} {quantity.unit}".rstrip() + " (held)"
    return f"{name} = {quantity.value:.4g} ± {quantity.std:.1g} {quantity.unit}".rstrip()
