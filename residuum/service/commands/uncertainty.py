"""`residuum uncertainty`: the weight above the error of the models that an identified model's
distribution allows.
"""

from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.linear_models.identified_model_file import load_identified
from residuum.library.questions.uncertainty import Uncertainty
from residuum.library.uncertainty import bounded
from residuum.service.commands.asked import asks
from residuum.service.commands.report import AsJson, report

app = typer.Typer(add_completion=False)


@app.command()
@asks()
def uncertainty(
    identified: Annotated[
        Path, typer.Argument(help="Model file, as `residuum identify` writes it.")
    ],
    asked: Uncertainty,
    as_json: AsJson = False,
) -> None:
    """Bound the error of a model at every frequency (Algorithm 1)."""
    answer = bounded(load_identified(identified), asked)
    report(answer.to_dict() | {"identified": str(identified)}, str(answer), as_json=as_json)
