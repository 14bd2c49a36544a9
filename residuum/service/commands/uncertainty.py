"""`residuum uncertainty`: the weight above the error of the models that an identified model's distribution allows."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from residuum.identification.linear_models.identified_model import load_identified
from residuum.identification.linear_models.uncertainty import UncertaintyWeight
from residuum.library.questions.uncertainty import Uncertainty, weight_for
from residuum.service.commands.asked import asks
from residuum.service.commands.report import AsJson, report

app = typer.Typer(add_completion=False)


@app.command()
@asks()
def uncertainty(
    identified: Annotated[Path, typer.Argument(help="Model file, as `residuum identify` writes it.")],
    asked: Uncertainty,
    as_json: AsJson = False,
) -> None:
    """Bound the error of a model at every frequency (Algorithm 1)."""
    made = weight_for(load_identified(identified), asked, asked.form, asked.seed)
    result = {
        "identified": str(identified),
        "form": made.form,
        "rule": asked.rule,
        "epsilon": asked.epsilon,
        "zeta": asked.zeta,
        "samples": made.n_samples,
        "promise": made.promise,
        "certified": made.certified,
        "weight": {"numerator": made.weight.num, "denominator": made.weight.den, "sample_time": made.weight.sample_time},
        "critical_frequency_rad_s": made.critical_frequency,
        "frequency_rad_s": made.omega,
        "largest_error": made.magnitude,
    }
    report(result, _human(made), as_json=as_json)


def _human(made: UncertaintyWeight) -> str:
    between = "proven at every frequency" if made.certified else "at the grid's frequencies alone; nothing is proven between them"
    crossing = "nowhere" if made.critical_frequency is None else f"from {made.critical_frequency:.4g} rad/s on"
    return "\n".join(
        [
            f"{made.form} error of {made.n_samples} random models: at most {float(np.max(made.magnitude)):.4g}",
            f"  W_T(z) = {_polynomial(made.weight.num)} over {_polynomial(made.weight.den)}, descending powers of z",
            f"  above the error {between}; 1 or more {crossing}",
            f"  {made.promise}",
        ]
    )


def _polynomial(coefficients: np.ndarray) -> str:
    return "[" + ", ".join(f"{value:.6g}" for value in coefficients) + "]"
