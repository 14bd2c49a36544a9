"""What is wrong with an estimation, in sentences: its search did not come to rest, its values sit
at bounds, or its records speak against what was known of parameters before.

Values of a search that did not come to rest are those of wherever it was left; their covariance,
the curvature there, says nothing of their error.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from residuum.identification.physics.estimation.estimation import Estimate

Array = npt.NDArray[np.float64]

DISAGREE = 3.0
"""Combined standard deviations beyond which the data speak against a prior."""
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
    estimated : Estimate
        As it ended.
    start : Estimate
        The model as it was before on the same pieces, nothing but first states fitted; None where
        residuals are not what fell.
    """
    says = []
    # Short of a minimum nothing else need be said of where it stands.
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


def disagreement(estimated: Estimate) -> tuple[str, ...]:
    """One line that names the priors which the data speak against; none where they agree.

    An estimate θ̂ ± s from a prior μ ± σ and data moves by θ̂ − μ with the variance σ² − s². That
    many standard deviations it is off as the data alone are off the prior, measured in the
    deviation of both together.
    """
    conflicts = []
    parameters = estimated.model.all_parameters
    for name, value, s in zip(estimated.parameters, estimated.theta, estimated.std, strict=True):
        prior = parameters[name].prior
        if prior is None or not s < prior.std:
            continue
        off = abs(value - prior.mean) / np.sqrt(prior.std**2 - s**2)
        if off > DISAGREE:
            # The precision of the data alone, and the value that they alone would give.
            data = 1.0 / s**2 - 1.0 / prior.std**2
            alone = prior.mean + (value - prior.mean) / (s**2 * data)
            before = f"{prior.mean:g} ± {prior.std:g} before"
            conflicts.append(
                f"{name} = {alone:.4g} by the data, {before} ({off:.1f} combined deviations)"
            )
    if not conflicts:
        return ()
    listed = "; ".join(conflicts)
    return (f"data and prior disagree: {listed}; the prior is wrong, or the model lacks an effect",)
