"""Two things that happened at once, tried where one alone leaves more than is usual."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.hypotheses import Hypothesis
from residuum.diagnosis.model_based.policy import FITTED_PAIRS, PAIR_STEPS, PAIRED
from residuum.diagnosis.model_based.trying import Tried
from residuum.diagnosis.model_based.variant import Edit, Variant
from residuum.diagnosis.model_based.window_fit import Fit, WindowFitter
from residuum.identification.physics import PhysicalModel

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pair:
    """Two hypotheses in one fit; of each its parameters of the model, and which of the fit's sizes are its own."""

    both: tuple[Hypothesis, Hypothesis]
    fit: Fit
    own: tuple[tuple[str, ...], tuple[str, ...]]
    sizes: tuple[list[int], list[int]]


def pairs(baseline: Baseline, fitter: WindowFitter, singles: Iterable[Tried]) -> list[Pair]:
    """The best pairs of the likeliest hypotheses and of all values and offsets: what one alone hides shows beside another."""
    ranked = sorted(filter(_combines, singles), key=lambda t: fitter.nats(t.fit) + baseline.usual_gain(t.hypothesis))
    plain = [t for t in ranked[PAIRED:] if t.hypothesis.kind == "parameter" or t.hypothesis.name == "offset"]
    looks = []
    for a, b in combinations([*ranked[:PAIRED], *plain], 2):
        if set(a.fit.variant.own) & set(b.fit.variant.own):
            continue
        one, other = _ended(a.fit), b.fit.variant
        fit = fitter.fit(beside(fitter.model, one, other), PAIR_STEPS, beside=a.fit)
        if fit is not None:
            looks.append(Pair((a.hypothesis, b.hypothesis), fit, (one.own, other.own), _whose(one, other)))
    looks.sort(key=lambda pair: fitter.nats(pair.fit))
    return [_fitted(fitter, pair) for pair in looks[:FITTED_PAIRS]]


def _combines(tried: Tried) -> bool:
    h = tried.hypothesis
    return h.seen is None and h.begin is None and h.kind != "disturbance" and not tried.fit.onset


def _fitted(fitter: WindowFitter, pair: Pair) -> Pair:
    fit = fitter.fit(pair.fit.variant, begin=pair.fit)
    return pair if fit is None or fitter.nats(fit) > fitter.nats(pair.fit) else replace(pair, fit=fit)


def _ended(fit: Fit) -> Variant:
    """The fit's variant, beginning where the fit ended."""
    variant, p = fit.variant, len(fit.variant.own)
    model = variant.model.with_values(dict(zip(variant.own, fit.own[:p].tolist(), strict=True)))
    return replace(variant, model=model, sizes=tuple(fit.own[p:].tolist()))


def beside(model: PhysicalModel, first: Variant, second: Variant) -> Variant:
    """Both at once; `model` is the healthy one."""
    known, larger = {use.label for use in model.effects}, first.model
    for use in second.model.effects:
        if use.label not in known:
            larger = larger.with_effect(*use.key, {name: p.value for name, p in use.parameters.items()})
    n = len(first.sizes)
    return Variant(
        larger,
        first.own + second.own,
        first.sizes + second.sizes,
        first.lower + second.lower,
        _after(first.inputs, second.inputs, n),
        _after(first.reading, second.reading, n),
    )


def _after(first: Edit | None, second: Edit | None, n: int) -> Edit | None:
    """One edit after the other, the first of which has n sizes."""
    if first is None and second is None:
        return None

    def edit(signals: Array, sizes: Array) -> Array:
        out = signals if first is None else first(signals, sizes[:n])
        return out if second is None else second(out, sizes[n:])

    return edit


def _whose(first: Variant, second: Variant) -> tuple[list[int], list[int]]:
    """Places in (own of both, sizes of both)."""
    p, q, n = len(first.own), len(second.own), len(first.sizes)
    return (
        [*range(p), *range(p + q, p + q + n)],
        [*range(p, p + q), *range(p + q + n, p + q + n + len(second.sizes))],
    )
