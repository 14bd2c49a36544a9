"""`residuum uncertainty`: the weight above the error of the models that an identified model's distribution allows."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

from residuum.identification.linear_models.error_bounds.error_grid import asked_grid
from residuum.identification.linear_models.identified_model_file import load_identified
from residuum.identification.linear_models.uncertainty import (
    WEIGHT_ORDER,
    UncertaintyWeight,
    design_uncertainty_weight,
)
from residuum.service.commands.report import AsJson, report
from residuum.service.commands.weight_options import (
    EPSILON,
    ZETA,
    Epsilon,
    Lowest,
    Points,
    Rule,
    WeightOrder,
    Zeta,
)

app = typer.Typer(add_completion=False)


@app.command()
def uncertainty(
    identified: Annotated[Path, typer.Argument(help="Model file, as `residuum identify` writes it.")],
    epsilon: Epsilon = EPSILON,
    zeta: Zeta = ZETA,
    rule: Rule = "chernoff",
    form: Annotated[
        Literal["multiplicative", "additive", "inverse-multiplicative"], typer.Option(help="Form of the error that is bounded.")
    ] = "multiplicative",
    weight_order: WeightOrder = WEIGHT_ORDER,
    points: Points = None,
    lowest: Lowest = None,
    seed: Annotated[int, typer.Option(help="Seed of the random models.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Bound the error of a model at every frequency (Algorithm 1)."""
    model = load_identified(identified)
    grid = asked_grid(model.sample_time, points, lowest)
    made = design_uncertainty_weight(
        model, omega=grid, accuracy=epsilon, confidence=1 - zeta, rule=rule, form=form, order=weight_order, seed=seed
    )
    result = {
        "identified": str(identified),
        "form": made.form,
        "rule": rule,
        "epsilon": epsilon,
        "zeta": zeta,
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
