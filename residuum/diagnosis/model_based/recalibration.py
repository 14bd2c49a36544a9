"""Whether windows may be used to learn a baseline anew: never where a sensor's fault or a new effect is probable in them.

A fault too small for the limit of one window is judged healthy again and again; learned from, it would become the new normal.
So the windows are held together against those of the training: for each hypothesis the mean of its sizes in both (Welch's test,
Bonferroni over hypotheses). A value that has changed may become the new normal: where a value tells the windows as well as a
fault does, they are learned from.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from residuum.array_types import FloatArray
from residuum.diagnosis.model_based.assessment import NotAssessable, seen_window
from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.hypotheses import UNKNOWN_LOAD
from residuum.diagnosis.model_based.policy import CALIBRATED, LEARNED_FALSELY
from residuum.diagnosis.model_based.trying import tried
from residuum.identification.blas_threads import one_thread
from residuum.identification.errors import BadInput
from residuum.identification.physics import Key
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.policy import TIE

_FEWEST = 2


class NothingLearned(BadInput):
    """A baseline is not learned anew from these windows; the message says why."""


@one_thread()
def refuse_recalibration(baseline: Baseline, records: Sequence[Record], accepted: Sequence[Key] = ()) -> None:
    """Raise NothingLearned where a sensor's fault, an actuator's, a load or a new effect is probable in the windows.

    An effect that the user has `accepted` is none of them.
    """
    chosen = np.unique(np.linspace(0, len(records) - 1, min(CALIBRATED, len(records))).astype(int))
    sizes: dict[str, list[FloatArray]] = {}
    gains: dict[str, float] = {}
    for k in chosen:
        try:
            seen = seen_window(baseline, records[k])
        except NotAssessable:
            continue
        fitter = baseline.fitter(seen.window, seen.features)
        healthy, found = tried(fitter, baseline.hypotheses, baseline.usual_gain)
        for label, one in found.items():
            sizes.setdefault(label, []).append(one.fit.own)
            gains[label] = (
                gains.get(label, 0.0) + fitter.nats(healthy) - fitter.nats(one.fit) - baseline.usual_gain(one.hypothesis)
            )
    if max(map(len, sizes.values()), default=0) < _FEWEST:
        return
    p = {h.label: _chance(baseline, h.label, sizes.get(h.label, [])) for h in baseline.hypotheses}
    shifted = [h for h in baseline.hypotheses if p[h.label] * len(p) < LEARNED_FALSELY]
    free = [h for h in shifted if h.label in baseline.free or h.key in accepted]
    blamed = [h for h in shifted if h not in free and h.name != UNKNOWN_LOAD]
    if not blamed:
        return
    likeliest = max(blamed, key=lambda h: (gains[h.label], -p[h.label]))
    values = [gains[h.label] for h in free]
    if values and max(values) > max(gains[likeliest.label] - TIE, 0.0):
        return
    place = f" of {likeliest.place}" if likeliest.place else ""
    chance = min(1.0, p[likeliest.label] * len(p))
    raise NothingLearned(
        f"the model is not learned anew: these {len(records)} windows together show {likeliest.kind} {likeliest.name}{place} "
        f"(chance that they are healthy: {chance:.1g}), and it would become the new normal; mend it first, or, if it was always "
        "there, add it to the model with `residuum improve`"
    )


def _chance(baseline: Baseline, label: str, sizes: Sequence[FloatArray]) -> float:
    """That healthy windows' first size lies so far from that of the training's."""
    usual = baseline.usual.get(label)
    if usual is None or len(usual.sizes) < _FEWEST or len(sizes) < _FEWEST:
        return 1.0
    here, there = np.array([s[0] for s in sizes]), usual.sizes[:, 0]
    least = (1e-9 * float(np.max(np.abs([*here, *there])))) ** 2 + 1e-300  # sizes that are alike to rounding
    a, b = (max(float(x.var(ddof=1)), least) / len(x) for x in (here, there))
    t = float(here.mean() - there.mean()) / np.sqrt(a + b)
    share = a / (a + b)
    freedom = 1.0 / (share**2 / (len(here) - 1) + (1.0 - share) ** 2 / (len(there) - 1))
    return float(2.0 * stats.t.sf(abs(t), freedom))
