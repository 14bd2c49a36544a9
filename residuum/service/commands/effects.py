"""`residuum effects`: the catalogue of physical effects, or what fits a model's balances and paths."""

from typing import Annotated, Any

import typer

from residuum.identification.physics import candidates, load_model
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.effects.base import Effect, Parameter
from residuum.service.commands.report import AsJson, report

app = typer.Typer(add_completion=False)


@app.command()
def effects(
    model: Annotated[str | None, typer.Argument(metavar="[MODEL]", help="A built-in model or a model file.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the catalogue of physical effects, or where each fits in MODEL."""
    if model is None:
        entries = [effect_json(effect) for effect in EFFECTS.values()]
        report({"effects": entries}, "\n".join(map(_line, entries)), as_json=as_json)
        return
    loaded = load_model(model)
    entries = [
        effect_json(effect) | {"balance": target, "parameters": _parameters(effect.parameters(loaded.site(target, effect)))}
        for effect, target in ((EFFECTS[id], target) for id, target in candidates(loaded))
    ]
    present = [{"effect": use.id, "balance": use.target} for use in loaded.effects]
    report({"model": loaded.name, "present": present, "effects": entries}, "\n".join(map(_line, entries)), as_json=as_json)


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


def _parameters(parameters: tuple[Parameter, ...]) -> dict[str, Any]:
    return {p.name: {"unit": p.unit, "lower": p.lower, "upper": p.upper, "meaning": p.meaning} for p in parameters}


def _line(entry: dict[str, Any]) -> str:
    where = entry["balance"] if "balance" in entry else ", ".join(entry["acts_on"])
    units = {name: p["unit"] for name, p in entry.get("parameters", {}).items()}
    shown = "".join(f"  {name} [{unit}]" for name, unit in units.items())
    return f"{entry['effect']:<22} {where:<16} {entry['equation']}{shown}"
