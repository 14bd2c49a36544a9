"""What is wrong with an estimation whose search did not come to rest in a minimum of its own.

Such values are those of wherever the search was left; their covariance, the curvature there, says nothing of their error.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from residuum.identification.physics.estimation.estimation import Estimate

Array = npt.NDArray[np.float64]

PROMISED = 0.02
"""Part of the cost that a whole step still promises from where the search was stuck: at rest it is next to nothing."""
_RISEN = 1e-3
"""Part by which a mean logarithm of the errors may exceed that of the start: searches round."""


def unsettled(found: Estimate, start: Estimate | None = None) -> tuple[str, ...]:
    """What is wrong with the search, in words; empty where it came to rest.

    It rests at a bound as well: the least error within what the model allows, whose values `at_bounds` names.

    Parameters
    ----------
    found : Estimate
        As it ended.
    start : Estimate
        The model as it was before on the same pieces, nothing but first states fitted; None where residuals are not what fell.
    """
    says = []
    if not found.converged:
        says.append(f"the search stopped after {found.iterations} steps, short of a minimum")
    elif found.promised > PROMISED and not found.at_bound:
        moved = "did not move from its start" if start is not None and _unmoved(found, start) else "is stuck"
        says.append(f"the search {moved}: no step lowers the error, though the slopes promise {100 * found.promised:.2g} % of it")
    if start is not None and _logarithm(found) > _logarithm(start) + _RISEN:
        says.append("the error is larger than at the start: the search walked away")
    return tuple(says)


def at_bounds(found: Estimate) -> tuple[str, ...]:
    """What the data do not tell, since the model's bounds do, in words."""
    return tuple(f"{name} sits at its bound: widen it, or fix the value" for name in found.at_bound)


def _unmoved(found: Estimate, start: Estimate) -> bool:
    return all(found.model.values[name] == start.model.values[name] for name in found.parameters)


def _logarithm(found: Estimate) -> float:
    """Mean logarithm of the outputs' errors, each as often as it was measured: what falls when outputs are weighed by them."""
    count = np.sum(np.isfinite(np.concatenate(found.residuals)), axis=0)
    there = count > 0
    return float(count[there] @ np.log(np.maximum(found.rmse[there], 1e-300)) / count.sum())
