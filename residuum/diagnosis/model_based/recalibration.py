r"""Whether windows may be used to learn a baseline anew: never where a sensor's fault or a new effect is probable in them.

A fault that is too small for the limit of one window is judged healthy again and again; learned from, it would become the
new normal. So the windows are weighed together: for each hypothesis g the scores S = Σ s_w and information I = Σ I_w of all
windows give χ² = Sᵀ I⁻¹ S / (1 + n/N), n windows beside the N of the training (whose mean is no better known), and the
hypotheses share the posterior in which healthy is as probable beforehand as all the others, which pay for their sizes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.assessment import NotAssessable, followed
from residuum.diagnosis.model_based.baseline import Baseline
from residuum.identification.errors import BadInput
from residuum.identification.record import Record

Array = npt.NDArray[np.float64]

REFUSED = ("sensor", "actuator", "effect", "disturbance")
"""Kinds of causes that must not become the new normal."""
PROBABLE = 0.2
"""Probability of one of them from which on nothing is learned."""
_PRICE = 4.0
"""Price of each size of a hypothesis in the log-likelihood."""
_FEWEST = 2


class NothingLearned(BadInput):
    """A baseline is not learned anew from these windows; the message says why."""


def refuse_recalibration(baseline: Baseline, records: Sequence[Record]) -> None:
    """Raise NothingLearned where a sensor's fault, an actuator's, a load or a new effect is probable in the windows."""
    probabilities = shared_causes(baseline, records)
    blamed = {name: p for name, (kind, p) in probabilities.items() if kind in REFUSED}
    if (total := sum(blamed.values())) < PROBABLE:
        return
    likeliest = max(blamed, key=lambda name: blamed[name])
    raise NothingLearned(
        f"the model is not learned anew: these {len(records)} windows together show {likeliest} (probability {total:.0%} of a "
        "fault or a new effect), and it would become the new normal; mend it first, or, if it was always there, add it to the "
        "model with `residuum improve`"
    )


def shared_causes(baseline: Baseline, records: Sequence[Record]) -> dict[str, tuple[str, float]]:
    """Kind and probability of each hypothesis over all windows that can be judged; empty where fewer than two can."""
    judged = []
    for record in records:
        try:
            judged.append(followed(baseline, record).judged)
        except NotAssessable:
            continue
    if len(judged) < _FEWEST:
        return {}
    score = np.sum([j.score for j in judged], axis=0)
    information = np.sum([j.information for j in judged], axis=0)
    doubt = 1.0 + len(judged) / baseline.scatter.windows
    groups = baseline.groups
    worth = np.array([_worth(score, information, list(group.sizes), doubt) for group in groups]) - np.log(len(groups))
    posterior = np.exp(worth - max(0.0, float(np.max(worth))))
    posterior /= posterior.sum() + np.exp(-max(0.0, float(np.max(worth))))
    found: dict[str, tuple[str, float]] = {}
    for hypothesis, p in zip(baseline.hypotheses, posterior.tolist(), strict=True):
        name = f"{hypothesis.kind} {hypothesis.name}" + (f" of {hypothesis.place}" if hypothesis.place else "")
        found[name] = (hypothesis.kind, found.get(name, ("", 0.0))[1] + p)
    return found


def _worth(score: Array, information: Array, sizes: list[int], doubt: float) -> float:
    """Half of χ² less the price of the sizes."""
    own = information[np.ix_(sizes, sizes)]
    d = np.sqrt(np.maximum(np.diag(own), 1e-300))
    z = score[sizes] / d
    chi_square = float(z @ np.linalg.pinv(own / d[:, None] / d, rcond=1e-9, hermitian=True) @ z)
    return 0.5 * chi_square / doubt - _PRICE * len(sizes)
