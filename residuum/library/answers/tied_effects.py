"""What is told of an effect that is tied to other signals: the channel of a forgotten input, the
curve that was learned.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from residuum.identification.discrepancy.suggestion import nearest_formula
from residuum.identification.physics.model import place_of, tied_to
from residuum.identification.unseen_blocks.verdict import Quantity


def tied_json(effect: str, target: str, parameters: Mapping[str, Quantity]) -> dict[str, Any]:
    """Keys beside those that every effect has; none for an effect of the catalogue."""
    tied = tied_to(target)
    if effect == "forgotten-input":
        gain = parameters["gain"]
        return {
            "channel": tied[0],
            "gain": {"value": gain.value, "std": gain.std, "unit": gain.unit},
        }
    if effect == "coupling":
        return {"between": [place_of(target), tied[0]]}
    if effect == "learned":
        return {
            "signals": list(tied),
            "curve": _curve(parameters),
            "formula": _formula(tied[0], parameters),
        }
    return {}


def tied_text(effect: str, target: str, parameters: Mapping[str, Quantity]) -> str | None:
    """One sentence in the place of a list of parameters; None for an effect of the catalogue."""
    place, tied = place_of(target), tied_to(target)
    if effect == "forgotten-input":
        gain = parameters["gain"]
        return (
            f"what {place} lacks follows {tied[0]} with {gain.value:.3g} ± {gain.std:.2g}"
            f" {gain.unit}".rstrip()
        )
    if effect == "learned":
        formula = _formula(tied[0], parameters) or "no formula comes near"
        return f"a curve over {tied[0]}, {len(_curve(parameters)['at'])} values: {formula}"
    return None


def _curve(parameters: Mapping[str, Quantity]) -> dict[str, Any]:
    count = sum(name.startswith("a") for name in parameters)
    at, values = ([parameters[f"{letter}{k}"] for k in range(1, count + 1)] for letter in "av")
    return {
        "at": [q.value for q in at],
        "value": [q.value for q in values],
        "std": [q.std for q in values],
        "unit": values[0].unit,
        "at_unit": at[0].unit,
    }


def _formula(signal: str, parameters: Mapping[str, Quantity]) -> str | None:
    curve = _curve(parameters)
    nearest = nearest_formula(np.array(curve["at"]), np.array(curve["value"]))
    return (
        None
        if nearest is None
        else (
            f"{nearest.formula} {curve['unit']}, z = {signal} / {nearest.largest:.3g}"
            f" {curve['at_unit']}".rstrip()
        )
    )
