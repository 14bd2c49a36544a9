"""An effect of the catalogue as an object and as a line."""

from __future__ import annotations

from typing import Any

from residuum.identification.physics.effects.base import Effect, Parameter


def effect_json(effect: Effect) -> dict[str, Any]:
    """An effect of the catalogue as the command line and the HTTP interface show it."""
    return {
        "effect": effect.id,
        "title": effect.title,
        "equation": effect.equation,
        "acts_on": list(effect.acts_on),
        "needs": list(effect.needs),
        "reference": effect.reference,
    }


def parameters_json(parameters: tuple[Parameter, ...]) -> dict[str, Any]:
    """Unit, bounds and meaning of each parameter."""
    return {
        p.name: {"unit": p.unit, "lower": p.lower, "upper": p.upper, "meaning": p.meaning}
        for p in parameters
    }


def effect_line(entry: dict[str, Any]) -> str:
    """One line of the list."""
    # With a model its candidates are listed, each in its place; without one the catalogue, whose
    # effects say only on what they can act.
    where = entry["balance"] if "balance" in entry else ", ".join(entry["acts_on"])
    units = {name: p["unit"] for name, p in entry.get("parameters", {}).items()}
    shown = "".join(f"  {name} [{unit}]" for name, unit in units.items())
    return f"{entry['effect']:<22} {where:<16} {entry['equation']}{shown}"
