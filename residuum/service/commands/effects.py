"""`residuum effects`: the catalogue of physical effects, or what fits a model's balances and
paths.
"""

from typing import Annotated

import typer

from residuum.identification.physics import candidates, load_model
from residuum.identification.physics.effects import EFFECTS
from residuum.library.answers.effect import effect_json, effect_line, parameters_json
from residuum.service.commands.own_catalogue import OwnCatalogue
from residuum.service.commands.report import AsJson, report

app = typer.Typer(add_completion=False)


@app.command()
def effects(
    model: Annotated[
        str | None, typer.Argument(metavar="[MODEL]", help="A built-in model or a model file.")
    ] = None,
    catalogue: OwnCatalogue = None,
    as_json: AsJson = False,
) -> None:
    """List the catalogue of physical effects, or where each fits in MODEL."""
    if model is None:
        entries = [effect_json(effect) for effect in EFFECTS.values()]
        report({"effects": entries}, "\n".join(map(effect_line, entries)), as_json=as_json)
        return
    loaded = load_model(model)
    entries = [
        effect_json(effect)
        | {
            "balance": target,
            "parameters": parameters_json(effect.parameters(loaded.site(target, effect))),
        }
        for effect, target in ((EFFECTS[id], target) for id, target in candidates(loaded))
    ]
    present = [{"effect": use.id, "balance": use.target} for use in loaded.effects]
    report(
        {"model": loaded.name, "present": present, "effects": entries},
        "\n".join(map(effect_line, entries)),
        as_json=as_json,
    )
