"""Options of the uncertainty weight (Algorithm 1), the same for every command that makes one; defaults are the source's."""

from typing import Annotated, Literal

import typer

Epsilon = Annotated[float, typer.Option(help="ε of the number of random models (2.24).")]
Zeta = Annotated[float, typer.Option(help="ζ of the number of random models (2.24).")]
Rule = Annotated[
    Literal["chernoff", "worst-case"],
    typer.Option(help="Meaning of ε and ζ: bounds for a share of the models, or for the worst of them."),
]
WeightOrder = Annotated[int, typer.Option(help="Order of the fitted weight W_T.", min=0, max=20)]
Points = Annotated[int | None, typer.Option(help="Number of frequencies in the first grid, logarithmic up to π/Ts.", min=2)]
Lowest = Annotated[float | None, typer.Option(help="Lowest of these frequencies \\[rad/s].")]
EPSILON, ZETA = 0.05, 0.05
