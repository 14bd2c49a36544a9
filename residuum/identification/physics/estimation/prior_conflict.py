"""Where records speak against what was known of parameters before."""

from __future__ import annotations

import numpy as np

from residuum.identification.physics.estimation.estimation import Estimate

DISAGREE = 3.0
"""Combined standard deviations beyond which the data speak against a prior."""


def disagreement(found: Estimate) -> tuple[str, ...]:
    """One line that names the priors which the data speak against; none where they agree.

    An estimate θ̂ ± s from a prior μ ± σ and data moves by θ̂ − μ with the variance σ² − s². That
    many standard deviations it is off as the data alone are off the prior, measured in the
    deviation of both together.
    """
    said, parameters = [], found.model.all_parameters
    for name, value, s in zip(found.parameters, found.theta, found.std, strict=True):
        prior = parameters[name].prior
        if prior is None or not s < prior.std:
            continue
        off = abs(value - prior.mean) / np.sqrt(prior.std**2 - s**2)
        if off > DISAGREE:
            data = 1.0 / s**2 - 1.0 / prior.std**2
            alone = prior.mean + (value - prior.mean) / (s**2 * data)
            before = f"{prior.mean:g} ± {prior.std:g} before"
            said.append(
                f"{name} = {alone:.4g} by the data, {before} ({off:.1f} combined deviations)"
            )
    if not said:
        return ()
    return (
        (
            f"data and prior disagree: {'; '.join(said)}; the prior is wrong, or the model lacks an"
            " effect"
        ),
    )
