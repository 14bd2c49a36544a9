"""Every hypothesis tried on one window: all are looked at, the best are fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from residuum.diagnosis.model_based.hypotheses import Hypothesis
from residuum.diagnosis.model_based.policy import GRID, HYPOTHESES_FITTED, LOOK_STEPS
from residuum.diagnosis.model_based.variant import Variant
from residuum.diagnosis.model_based.window_fit import Fit, WindowFitter
from residuum.identification.errors import BadRecord


@dataclass(frozen=True, eq=False)
class Tried:
    """A hypothesis and its best fit."""

    hypothesis: Hypothesis
    fit: Fit


def tried(
    fitter: WindowFitter, listed: Sequence[Hypothesis], usual_gain: Callable[[Hypothesis], float]
) -> tuple[Fit, dict[str, Tried]]:
    """The healthy fit, and the best fit of each hypothesis by its label.

    Raises
    ------
    BadRecord
        The healthy model cannot be simulated along the window.
    """
    healthy = fitter.fit(Variant(fitter.model))
    if healthy is None:
        raise BadRecord(
            f"record {fitter.window.source!r}: the model diverges along it; `residuum compare` shows how far off it is"
        )
    X, looks = fitter.states(healthy), []
    for h in listed:
        if h.seen is not None:
            each = [h.seen(fitter, healthy)]
        else:
            each = [fitter.fit(v, LOOK_STEPS, beside=healthy) for v in h.variants(fitter.window, X)]
        if known := [fit for fit in each if fit is not None]:
            looks.append(Tried(h, min(known, key=fitter.nats)))
    looks.sort(key=lambda t: fitter.nats(t.fit) + usual_gain(t.hypothesis))
    looks[:HYPOTHESES_FITTED] = [_fitted(fitter, healthy, t) for t in looks[:HYPOTHESES_FITTED]]
    return healthy, {t.hypothesis.label: t for t in looks}


def _fitted(fitter: WindowFitter, healthy: Fit, look: Tried) -> Tried:
    """Fitted fully, and where its beginning is a size, that halved in."""
    h, best = look.hypothesis, look.fit
    if h.seen is not None:
        return look
    steps = fitter.window.n // GRID if h.begin is not None else 0
    known = [fit for fit in (best, fitter.fit(best.variant, begin=best)) if fit is not None]
    best = min(known, key=fitter.nats)
    while h.begin is not None and (steps := steps // 2):
        beside = [t for t in (best.onset - steps, best.onset + steps) if 0 <= t < fitter.window.n - 2]
        others = [fitter.fit(h.begin(fitter.window, t), LOOK_STEPS, beside=healthy) for t in beside]
        best = min([best, *(fit for fit in others if fit is not None)], key=fitter.nats)
    return Tried(h, best)
