"""Which cause: all hypotheses weighed in nats, their probabilities counted over resampled blocks,
what is alike in one group.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.hypotheses import Hypothesis, Tried, tried
from residuum.diagnosis.model_based.policy import (
    BEGINNINGS_FOLLOWED,
    FIT_STEPS,
    FITTED_PAIRS,
    LEAST_UNKNOWN,
    LOOK_STEPS,
    PAIR_STEPS,
    PAIRED,
    PARTS,
    TOLD,
    UNEXPLAINED,
    WINDOW_PARTS,
)
from residuum.diagnosis.model_based.variant import Edit, Variant
from residuum.diagnosis.model_based.window_fit import Fit, WindowFitter, information
from residuum.identification.physics import Experiment, PhysicalModel
from residuum.identification.unseen_blocks.policy import BLOCKS, DRAWS, TIE

# Two things that happened at once, tried where one alone leaves more than is usual.


@dataclass(frozen=True, eq=False)
class Pair:
    """Two hypotheses in one fit; of each its parameters of the model, and which of the fit's sizes
    are its own.
    """

    both: tuple[Hypothesis, Hypothesis]
    fit: Fit
    own: tuple[tuple[str, ...], tuple[str, ...]]
    sizes: tuple[list[int], list[int]]


def pairs(baseline: Baseline, fitter: WindowFitter, singles: Iterable[Tried]) -> list[Pair]:
    """The best pairs of the likeliest hypotheses and of all values and offsets: what one alone
    hides shows beside another.
    """
    ranked = sorted(
        filter(_combines, singles),
        key=lambda t: fitter.nats(t.fit) + baseline.usual_gain(t.hypothesis),
    )
    plain = [
        t
        for t in ranked[PAIRED:]
        if t.hypothesis.kind == "parameter" or t.hypothesis.name == "offset"
    ]
    looks = []
    for a, b in combinations([*ranked[:PAIRED], *plain], 2):
        if set(a.fit.variant.own) & set(b.fit.variant.own):
            continue
        first, second = _ended(a.fit), b.fit.variant
        fit = fitter.fit(beside(fitter.model, first, second), PAIR_STEPS, beside=a.fit)
        if fit is not None:
            looks.append(
                Pair(
                    (a.hypothesis, b.hypothesis),
                    fit,
                    (first.own, second.own),
                    _whose(first, second),
                )
            )
    looks.sort(key=lambda pair: fitter.nats(pair.fit))
    return [_fitted(fitter, pair) for pair in looks[:FITTED_PAIRS]]


def _combines(tried: Tried) -> bool:
    h = tried.hypothesis
    return h.seen is None and h.begin is None and h.kind != "disturbance" and not tried.fit.onset


def _fitted(fitter: WindowFitter, pair: Pair) -> Pair:
    fit = fitter.fit(pair.fit.variant, begin=pair.fit)
    return (
        pair if fit is None or fitter.nats(fit) > fitter.nats(pair.fit) else replace(pair, fit=fit)
    )


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
            larger = larger.with_effect(
                *use.key, {name: p.value for name, p in use.parameters.items()}
            )
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

    def edit(signals: FloatArray, sizes: FloatArray) -> FloatArray:
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


_RANK = {"parameter": 0, "sensor": 1, "actuator": 1, "effect": 2, "disturbance": 3}
"""Order of what cannot be told apart: what changed before what is new."""

_NOTHING = 1e-3
"""Share of its standard deviation below which a size is zero."""
_LARGEST = 1e100
"""Information that can be inverted."""


@dataclass(frozen=True, eq=False)
class Cause:
    """A hypothesis (None: `unknown`), its probability, sizes, their standard deviations, where it
    began, what is alike, and what happened beside it.
    """

    hypothesis: Hypothesis | None
    probability: float
    size: FloatArray
    std: FloatArray
    onset: int
    alike: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()


def causes(baseline: Baseline, window: Experiment, features: FloatArray) -> list[Cause]:
    """The likeliest first; none of size zero."""
    return of_some_size(_causes(baseline, window, features))


def of_some_size(listed: Sequence[Cause]) -> list[Cause]:
    """Without causes of size zero, which leave the window as it is: what they were said to explain
    has an unknown cause.
    """
    none = [cause for cause in listed if _is_of_size_zero(cause)]
    if not none:
        return list(listed)
    names = {cause.hypothesis.label for cause in none if cause.hypothesis is not None}
    unknown = sum(
        cause.probability for cause in listed if cause in none or cause.hypothesis is None
    )
    sized = [
        replace(
            cause,
            alike=tuple(name for name in cause.alike if name not in names),
            beside=tuple(name for name in cause.beside if name not in names),
        )
        for cause in listed
        if cause.hypothesis is not None and cause not in none
    ]
    nobody = Cause(None, min(unknown, 1.0), np.zeros(0), np.zeros(0), 0)
    first = not sized or unknown > sized[0].probability
    return [nobody, *sized] if first else [sized[0], nobody, *sized[1:]]


def _is_of_size_zero(cause: Cause) -> bool:
    """Whether what a cause adds is nothing. A changed parameter, or where a sensor sticks, may well
    be zero.
    """
    h = cause.hypothesis
    if (
        h is None
        or h.kind not in ("effect", "sensor", "actuator")
        or h.name == "stuck"
        or not len(cause.size)
    ):
        return False
    return bool(np.all(np.abs(cause.size) <= _NOTHING * np.nan_to_num(cause.std)))


def _causes(baseline: Baseline, window: Experiment, features: FloatArray) -> list[Cause]:
    fitter = baseline.fitter(window, features)
    healthy, trials = tried(fitter, baseline.hypotheses, baseline.usual_gain)
    if not trials:
        return [Cause(None, 1.0, np.zeros(0), np.zeros(0), 0)]
    best = _cheapest(baseline, fitter, trials.values())
    whole = list(trials.values())
    left = float(baseline.surprise(features, best.fit).max())
    # many sizes may stand for a beginning
    if best.hypothesis.seen is None and (left > UNEXPLAINED or len(best.fit.own) > 2):
        for label, beginning in begun(baseline, fitter, features).items():
            trials[label] = _cheapest(
                baseline, fitter, [beginning, *([trials[label]] if label in trials else [])]
            )
    listed = list(trials.values())
    weighed = _weighed(baseline, fitter, listed)
    best = _cheapest(baseline, fitter, listed)
    unknown = (
        0.0
        if best.hypothesis.seen is not None
        else _unknown(baseline, fitter, features, healthy, best.fit)
    )
    if not unknown:
        return weighed
    if (two := _two(baseline, fitter, whole, listed)) is not None:
        alone = 1.0 - two[2]
        weighed = [
            *two[1],
            *(
                replace(c, probability=alone * c.probability)
                for c in weighed
                if c.hypothesis not in two[0].both
            ),
        ]
        unknown = _unknown(baseline, fitter, features, healthy, two[0].fit)
    lead = 1 if two is None else 2
    scaled = [replace(c, probability=(1.0 - unknown) * c.probability) for c in weighed]
    nobody = [Cause(None, unknown, np.zeros(0), np.zeros(0), 0)] if unknown else []
    return (
        [*nobody, *scaled]
        if unknown > scaled[0].probability
        else [*scaled[:lead], *nobody, *scaled[lead:]]
    )


def _two(
    baseline: Baseline, fitter: WindowFitter, whole: Sequence[Tried], listed: Sequence[Tried]
) -> tuple[Pair, list[Cause], float] | None:
    """The best pair of causes that may have acted all window long, where it costs less than any
    single hypothesis. Beside it stands the probability of any pair; that of a cause is of all pairs
    which hold it.
    """
    candidates = pairs(baseline, fitter, whole)
    if not candidates:
        return None
    names = [{h.label for h in pair.both} for pair in candidates]
    fits = [*(pair.fit for pair in candidates), *(t.fit for t in listed)]
    logs = np.array([fitter.logs(fit) for fit in fits])
    usual = [sum(baseline.usual_gain(h) for h in pair.both) for pair in candidates]
    usual += [baseline.usual_gain(t.hypothesis) for t in listed]
    fixed = np.array([fitter.price(fit) for fit in fits]) + np.array(usual)
    total = logs.sum(axis=1) + fixed
    lead = int(np.argmin(total[: len(candidates)]))
    if total[lead] > total[len(candidates) :].min() - TIE:
        return None
    wins, near = _wins(logs, fixed), _near(logs, total, lead)
    rivals = [k for k in range(len(candidates)) if k != lead and near[k]]
    best, pair_causes = candidates[lead], []
    std = _open(fitter, best.fit)
    for k, (h, own, at) in enumerate(zip(best.both, best.own, best.sizes, strict=True)):
        partner = best.both[1 - k].label
        alike = tuple(
            name for j in rivals if partner in names[j] for name in names[j] - {partner, h.label}
        )
        p = sum(float(wins[j]) for j in range(len(candidates)) if h.label in names[j])
        doubt = np.sqrt(std[at] ** 2 + _scatter(baseline, fitter, h, own, len(at)))
        pair_causes.append(Cause(h, min(p, 1.0), best.fit.own[at], doubt, 0, alike, (partner,)))
    return best, pair_causes, float(wins[: len(candidates)].sum())


def _cheapest(baseline: Baseline, fitter: WindowFitter, fits: Iterable[Tried]) -> Tried:
    return min(fits, key=lambda t: fitter.nats(t.fit) + baseline.usual_gain(t.hypothesis))


def _unknown(
    baseline: Baseline, fitter: WindowFitter, features: FloatArray, healthy: Fit, best: Fit
) -> float:
    """Probability that something else is there too: the part of the excess that the best fit
    leaves; 0 where that is usual.

    Not asked of noise and lost readings: they are what is left, and take nothing away from it.
    """
    if baseline.surprise(features, best).max() <= UNEXPLAINED:
        return 0.0
    excess = fitter.nats(healthy) - fitter.healthy_logs()
    taken = fitter.nats(healthy) - fitter.nats(best)
    return float(np.clip(1.0 - taken / max(excess, 1e-12), LEAST_UNKNOWN, 1.0))


def _weighed(baseline: Baseline, fitter: WindowFitter, listed: Sequence[Tried]) -> list[Cause]:
    """Probability by how often each is the cheapest over resampled blocks; whoever is near the
    leading one, and no richer, is alike.
    """
    fits = [t.fit for t in listed]
    logs = np.array([fitter.logs(fit) for fit in fits])
    fixed = np.array([fitter.price(t.fit) + baseline.usual_gain(t.hypothesis) for t in listed])
    sizes = np.array([len(fit.own) + (fit.onset > 0) for fit in fits])
    total, wins = logs.sum(axis=1) + fixed, _wins(logs, fixed, sizes)
    lead = int(np.lexsort((total, -wins.round(2)))[0])
    group = _near(logs, total, lead) & (sizes <= sizes[lead])
    group[lead] = True
    changed = [
        0 if set(t.fit.variant.own) & set(baseline.free) else _RANK[t.hypothesis.kind]
        for t in listed
    ]
    same = total - total[group].min() < 0.5 * TIE
    order = np.lexsort(
        (total, np.where(group & same, changed, 9), -np.where(group, 1.0, wins), ~group)
    )
    names = [listed[k].hypothesis.label for k in order if group[k]]
    causes = []
    for k in order[:TOLD].tolist():
        look = listed[k]
        alike = tuple(n for n in names if n != look.hypothesis.label) if group[k] else ()
        causes.append(
            Cause(
                look.hypothesis,
                float(wins[k]),
                look.fit.own,
                _doubt(baseline, fitter, look),
                look.fit.onset,
                alike,
            )
        )
    return causes


def _wins(logs: FloatArray, fixed: FloatArray, sizes: FloatArray | None = None) -> FloatArray:
    """How often each is the cheapest over resampled blocks; those within a factor of twenty share a
    draw, of them the ones of fewest sizes.
    """
    rng, wins = np.random.default_rng(0), np.zeros(len(logs))
    for _ in range(DRAWS):
        cost = logs[:, rng.integers(0, BLOCKS, BLOCKS)].sum(axis=1) + fixed
        near = np.flatnonzero(cost < cost.min() + TIE)
        if sizes is not None:
            near = near[sizes[near] == sizes[near].min()]
        wins[near] += 1.0 / len(near) / DRAWS
    return wins


def _near(logs: FloatArray, total: FloatArray, lead: int) -> npt.NDArray[np.bool_]:
    """Whether each lies within the doubt of its difference to the leading one."""
    doubt = np.std(logs - logs[lead], axis=1, ddof=1) * np.sqrt(BLOCKS)
    return np.asarray(total - total[lead] < np.maximum(TIE, doubt))


def _doubt(baseline: Baseline, fitter: WindowFitter, tried: Tried) -> FloatArray:
    """Standard deviation of the sizes: what the window leaves open, and how the same sizes scatter
    in healthy windows.
    """
    fit, h = tried.fit, tried.hypothesis
    variance = _scatter(baseline, fitter, h, fit.variant.own, len(fit.own))
    return np.sqrt(variance) if h.seen is not None else np.sqrt(_open(fitter, fit) ** 2 + variance)


def _scatter(
    baseline: Baseline, fitter: WindowFitter, h: Hypothesis, own: Sequence[str], sizes: int
) -> FloatArray:
    """Variance of a hypothesis' sizes from one healthy window to the next, shape (sizes,)."""
    if own and own[0] in fitter.free:
        return np.diag(fitter.covariance)[[fitter.free.index(name) for name in own]]
    known = baseline.usual.get(h.label)
    variance = known.variance if known is not None else 0.0
    return np.broadcast_to(variance if np.size(variance) in (1, sizes) else 0.0, (sizes,))


def _open(fitter: WindowFitter, fit: Fit) -> FloatArray:
    """Standard deviation of the sizes that the window leaves open; NaN where nothing can be said of
    it.
    """
    k, own = len(fit.others), fit.variant.own
    H = information(fit, k + len(fit.own))
    keep = [j for j, name in enumerate(fitter.free) if name not in own]
    H[:k, :k] += np.linalg.inv(fitter.covariance[np.ix_(keep, keep)])
    if not np.all(np.abs(H) < _LARGEST) or np.any(np.diag(H)[k:] < 1.0 / _LARGEST):
        # at sizes where the slopes overflow or vanish nothing is known of them
        return np.full(len(fit.own), np.nan)
    scale = np.sqrt(np.maximum(np.diag(H), 1.0 / _LARGEST))
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))  # what nothing tells is wide open
    return np.asarray(
        np.sqrt(np.sum(vectors**2 / np.maximum(values, 1e-12), axis=1) / scale**2)[k:]
    )


# Things that began within a window: healthy up to a sample, and from the states there on with the
# hypothesis.

_SHORTEST = 10
"""[samples] Before and after a beginning."""


def begun(baseline: Baseline, fitter: WindowFitter, features: FloatArray) -> dict[str, Tried]:
    """The best beginning of each hypothesis, found on a coarse grid; those that promise most halved
    in.
    """
    window, beginnings = fitter.window, dict[str, Tried]()
    listed = [h for h in baseline.hypotheses if not (h.seen or h.begin or h.kind == "disturbance")]
    for part in range(1, PARTS):
        _keep(
            beginnings,
            _beginning_at(baseline, fitter, features, window.n * part // PARTS, listed, LOOK_STEPS),
            fitter,
        )
    steps = window.n // PARTS
    while (steps := steps // 2) > window.n // WINDOW_PARTS:
        ranked = sorted(
            beginnings.values(),
            key=lambda t: fitter.nats(t.fit) + baseline.usual_gain(t.hypothesis),
        )
        for t in ranked[:BEGINNINGS_FOLLOWED]:
            for at in (t.fit.onset - steps, t.fit.onset, t.fit.onset + steps):
                _keep(
                    beginnings,
                    _beginning_at(baseline, fitter, features, at, [t.hypothesis], FIT_STEPS),
                    fitter,
                )
    return beginnings


def _keep(cheapest: dict[str, Tried], new: Sequence[Tried], fitter: WindowFitter) -> None:
    for t in new:
        old = cheapest.get(t.hypothesis.label)
        if old is None or fitter.nats(t.fit) < fitter.nats(old.fit):
            cheapest[t.hypothesis.label] = t


def _beginning_at(
    baseline: Baseline,
    fitter: WindowFitter,
    features: FloatArray,
    at: int,
    listed: Sequence[Hypothesis],
    steps: int,
) -> list[Tried]:
    window = fitter.window
    if not _SHORTEST < at < window.n - _SHORTEST:
        return []
    before = baseline.fitter(window.window(0, at + 1), features)
    head = before.fit(Variant(before.model))
    if head is None:
        return []
    end = before.states(head)[-1]
    tail = replace(
        window.window(at, window.n),
        known=dict(zip(before.model.states, end.tolist(), strict=False)),
    )
    after, X, trials = baseline.fitter(tail, features), np.repeat(end[None], tail.n, axis=0), []
    for h in listed:
        for variant in h.variants(tail, X):
            fit = after.fit(variant, steps)
            if fit is None:
                continue
            white = np.concatenate([head.white[:-1], fit.white])
            error = np.concatenate([head.error[:-1], fit.error])
            paid = fit.paid + head.paid
            trials.append(
                Tried(
                    h,
                    replace(
                        fit,
                        white=white,
                        error=error,
                        power=fitter.blocks(white),
                        paid=paid,
                        onset=at,
                    ),
                )
            )
    return trials
