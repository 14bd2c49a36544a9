"""Things that began within a window: healthy up to a sample, and from the states there on with the hypothesis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.hypotheses import Hypothesis
from residuum.diagnosis.model_based.policy import BEGINNINGS_FOLLOWED, FIT_STEPS, LOOK_STEPS, PARTS, WINDOW_PARTS
from residuum.diagnosis.model_based.trying import Tried
from residuum.diagnosis.model_based.variant import Variant
from residuum.diagnosis.model_based.window_fit import WindowFitter

Array = npt.NDArray[np.float64]
_SHORTEST = 10
"""[samples] Before and after a beginning."""


def begun(baseline: Baseline, fitter: WindowFitter, features: Array) -> dict[str, Tried]:
    """The best beginning of each hypothesis, found on a coarse grid; those that promise most halved in."""
    window, found = fitter.window, dict[str, Tried]()
    listed = [h for h in baseline.hypotheses if not (h.seen or h.begin or h.kind == "disturbance")]
    for part in range(1, PARTS):
        _keep(found, _beginning_at(baseline, fitter, features, window.n * part // PARTS, listed, LOOK_STEPS), fitter)
    steps = window.n // PARTS
    while (steps := steps // 2) > window.n // WINDOW_PARTS:
        ranked = sorted(found.values(), key=lambda t: fitter.nats(t.fit) + baseline.usual_gain(t.hypothesis))
        for t in ranked[:BEGINNINGS_FOLLOWED]:
            for at in (t.fit.onset - steps, t.fit.onset, t.fit.onset + steps):
                _keep(found, _beginning_at(baseline, fitter, features, at, [t.hypothesis], FIT_STEPS), fitter)
    return found


def _keep(found: dict[str, Tried], new: Sequence[Tried], fitter: WindowFitter) -> None:
    for t in new:
        old = found.get(t.hypothesis.label)
        if old is None or fitter.nats(t.fit) < fitter.nats(old.fit):
            found[t.hypothesis.label] = t


def _beginning_at(
    baseline: Baseline, fitter: WindowFitter, features: Array, at: int, listed: Sequence[Hypothesis], steps: int
) -> list[Tried]:
    window = fitter.window
    if not _SHORTEST < at < window.n - _SHORTEST:
        return []
    before = baseline.fitter(window.window(0, at + 1), features)
    head = before.fit(Variant(before.model))
    if head is None:
        return []
    end = before.states(head)[-1]
    rest = replace(window.window(at, window.n), known=dict(zip(before.model.states, end.tolist(), strict=False)))
    after, X, found = baseline.fitter(rest, features), np.repeat(end[None], rest.n, axis=0), []
    for h in listed:
        for variant in h.variants(rest, X):
            fit = after.fit(variant, steps)
            if fit is None:
                continue
            white = np.concatenate([head.white[:-1], fit.white])
            error = np.concatenate([head.error[:-1], fit.error])
            paid = fit.paid + head.paid
            found.append(Tried(h, replace(fit, white=white, error=error, power=fitter.blocks(white), paid=paid, onset=at)))
    return found
