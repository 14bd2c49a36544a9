"""What is wrong with an estimation whose search did not come to rest in a minimum of its own.

Such values are those of wherever the search was left; their covariance, the curvature there, says
nothing of their error.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from residuum.identification.physics.estimation.estimation import Estimate

Array = npt.NDArray[np.float64]

PROMISED = 0.02
"""Part of the cost that a whole step still promises from where the search was stuck: at rest it is
next to nothing.
"""
_RISEN = 1e-3
"""Part by which a mean logarithm of the errors may exceed that of the start: searches round."""


def unsettled(estimated: Estimate, start: Estimate | None = None) -> tuple[str, ...]:
    """What is wrong with the search, in words; empty where it came to rest.

    It rests at a bound as well: the least error within what the model allows, whose values
    `at_bounds` names.

    Parameters
    ----------
    found : Estimate
        As it ended.
    start : Estimate
        The model as it was before on the same pieces, nothing but first states fitted; None where
        residuals are not what fell.
    """
    says = []
    if not estimated.converged:
        says.append(f"the search stopped after {estimated.iterations} steps, short of a minimum")
    elif estimated.promised > PROMISED and not estimated.at_bound:
        moved = (
            "did not move from its start"
            if start is not None and _unmoved(estimated, start)
            else "is stuck"
        )
        says.append(
            f"the search {moved}: no step lowers the error, though the slopes promise"
            f" {100 * estimated.promised:.2g} % of it"
        )
    if start is not None and _logarithm(estimated) > _logarithm(start) + _RISEN:
        says.append("the error is larger than at the start: the search walked away")
    return tuple(says)


def at_bounds(estimated: Estimate) -> tuple[str, ...]:
    """What the data do not tell, since the model's bounds do, in words."""
    return tuple(
        f"{name} sits at its bound: widen it, or fix the value" for name in estimated.at_bound
    )


def _unmoved(estimated: Estimate, start: Estimate) -> bool:
    return all(
        estimated.model.values[name] == start.model.values[name] for name in estimated.parameters
    )


def _logarithm(estimated: Estimate) -> float:
    """Mean logarithm of the outputs' errors, each as often as it was measured: what falls when
    outputs are weighed by them.
    """
    count = np.sum(np.isfinite(np.concatenate(estimated.residuals)), axis=0)
    measured = count > 0
    return float(
        count[measured] @ np.log(np.maximum(estimated.rmse[measured], 1e-300)) / count.sum()
    )
