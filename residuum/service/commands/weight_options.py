"""Options of the uncertainty weight (Algorithm 1), the same for every command that makes one; defaults are the source's."""

from typing import Annotated, Literal

import typer

Epsilon = Annotated[
    float, typer.Option(help="Error ε that an estimated share of models may have. A smaller one draws more models, (2.24).")
]
Zeta = Annotated[
    float, typer.Option(help="Probability ζ that the error is larger than ε. A smaller one draws more models, (2.24).")
]
Rule = Annotated[
    Literal["chernoff", "worst-case"],
    typer.Option(help="What ε and ζ hold for: a share of the models (chernoff), or the worst of them (worst-case)."),
]
WeightOrder = Annotated[int, typer.Option(help="Order of the fitted weight W_T.", min=0, max=20)]
Points = Annotated[int | None, typer.Option(help="Number of frequencies in the first grid, logarithmic up to π/Ts.", min=2)]
Lowest = Annotated[float | None, typer.Option(help="Lowest frequency of the grid \\[rad/s].")]
EPSILON, ZETA = 0.05, 0.05
