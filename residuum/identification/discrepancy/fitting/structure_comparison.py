"""How structures compare: by likelihood, by the errors that they leave, and which is a rival for others."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structures import Rival, Structure, root_mean_squares, times_its_innovations
from residuum.identification.discrepancy.policy.acceptance import WORTH_A_LOOK
from residuum.identification.discrepancy.policy.likelihood import CLOSE
from residuum.identification.physics import Experiment, Key
from residuum.identification.physics.model import find_effect
from residuum.identification.residual_analysis.policy.noise import NOTHING_LEFT

FloatArray = npt.NDArray[np.float64]


def rival_of(structures: Collection[Structure]) -> Rival:
    """The likeliest of several; and the errors of those as likely that leave nothing but noise: they are at their tops, and
    others have to come near them.
    """
    highest = max((s.log_likelihood for s in structures), default=-np.inf)
    done = [s for s in structures if is_done(s, highest)]
    return Rival(highest, np.min([root_mean_squares(s.residuals) for s in done], axis=0) if done else None)


def is_done(structure: Structure, highest: float) -> bool:
    """Whether a structure is about as likely as the likeliest, and leaves nothing but noise."""
    return structure.log_likelihood > highest - CLOSE and times_its_innovations(structure) < NOTHING_LEFT


def likelier(found: Mapping[Key, Structure], others: Mapping[Key, Structure]) -> dict[Key, Structure]:
    """The likelier structure of each candidate."""
    more = {key: s for key, s in others.items() if key not in found or s.log_likelihood > found[key].log_likelihood}
    return {**found, **more}


def within_a_sample(structure: Structure, key: Key, experiments: Sequence[Experiment]) -> bool:
    """Whether an effect is a shift in time by less than a sample."""
    shift = structure.model.values.get(f"{structure.label_of(key)}.{find_effect(key[0]).shifts}", np.inf)
    return bool(shift < max(e.sample_time for e in experiments))


def simulates_no_worse(structure: Structure, before: Structure, rise: float = WORTH_A_LOOK) -> bool:
    """Whether the simulation error fell too: noise that is nearly integrated can swallow any slow error."""
    return mean_ratio(structure.rmse, before.rmse) < rise


def mean_ratio(after: FloatArray, before: FloatArray) -> float:
    """Geometric mean over the outputs of the ratio of their errors."""
    return float(np.exp(np.nanmean(np.log(after / before))))


def schwarz(structure: Structure, base: Structure) -> float:
    """Schwarz's criterion."""
    return structure.log_likelihood - structure.penalty(base)
