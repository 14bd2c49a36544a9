"""Options of the uncertainty weight (Algorithm 1), the same for every command that makes one; defaults are the source's."""

from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
import typer

from residuum.identification.errors import BadInput

Epsilon = Annotated[float, typer.Option(help="ε of the number of random models (2.24).")]
Zeta = Annotated[float, typer.Option(help="ζ of the number of random models (2.24).")]
Rule = Annotated[Literal["chernoff", "worst-case"], typer.Option(help="What ε and ζ promise: of a share, or of a worst case.")]
WeightOrder = Annotated[int, typer.Option(help="Order of the fitted weight W_T.", min=0, max=20)]
Points = Annotated[int | None, typer.Option(help="Frequencies, logarithmic up to π/Ts, that the grid begins with.", min=2)]
Lowest = Annotated[float | None, typer.Option(help="Lowest of these frequencies \\[rad/s].")]
EPSILON, ZETA, RULE, WEIGHT_ORDER = 0.05, 0.05, "chernoff", 2
_POINTS, _DECADES = 600, 5.5


def frequencies(sample_time: float, points: int | None, lowest: float | None) -> npt.NDArray[np.float64] | None:
    """The grid [rad/s] that was asked for; None when nothing was."""
    if points is None and lowest is None:
        return None
    nyquist = np.pi / sample_time
    low = nyquist / 10**_DECADES if lowest is None else lowest
    if not 0 < low < nyquist:
        raise BadInput(f"--lowest {low:g}: must lie between 0 and the Nyquist frequency, {nyquist:.6g} rad/s")
    return np.asarray(np.geomspace(low, nyquist, points or _POINTS))
