"""Which cause: the costs of all hypotheses compared, their probabilities counted over resampled
blocks of the window, and what cannot be told apart in one group.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.hypotheses import Hypothesis, Trial, try_hypotheses
from residuum.diagnosis.model_based.policy import (
    CAUSES_LISTED,
    FIT_STEPS,
    FITTED_PAIRS,
    LEAST_UNKNOWN,
    ONSETS_FOLLOWED,
    PAIR_STEPS,
    PAIRED,
    PARTS,
    SCREENING_STEPS,
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
    """Two hypotheses in one fit.

    Attributes
    ----------
    both : tuple of Hypothesis
    fit : Fit
    own : tuple of tuple of str
        Parameters of the model that are sizes of each.
    sizes : tuple of list of int
        Places of each one's sizes in `fit.own`.
    """

    both: tuple[Hypothesis, Hypothesis]
    fit: Fit
    own: tuple[tuple[str, ...], tuple[str, ...]]
    sizes: tuple[list[int], list[int]]

    @property
    def labels(self) -> set[str]:
        """Of both hypotheses."""
        return {h.label for h in self.both}


def pairs(baseline: Baseline, fitter: WindowFitter, singles: Iterable[Trial]) -> list[Pair]:
    """The best pairs of the likeliest hypotheses and of all values and offsets: what one alone
    hides shows beside another.
    """
    ranked = sorted(
        filter(_combines, singles),
        key=lambda t: fitter.cost(t.fit) + baseline.usual_gain(t.hypothesis),
    )
    # values and offsets join however little they gain alone: one can make up for the other
    plain = [
        t
        for t in ranked[PAIRED:]
        if t.hypothesis.kind == "parameter" or t.hypothesis.name == "offset"
    ]
    screened = []
    for a, b in combinations([*ranked[:PAIRED], *plain], 2):
        if set(a.fit.variant.own) & set(b.fit.variant.own):
            continue  # both move one value: no pair
        first, second = _ended(a.fit), b.fit.variant
        fit = fitter.fit(combined(fitter.model, first, second), PAIR_STEPS, beside=a.fit)
        if fit is None:
            continue
        own, sizes = (first.own, second.own), _whose(first, second)
        screened.append(Pair((a.hypothesis, b.hypothesis), fit, own, sizes))
    screened.sort(key=lambda pair: fitter.cost(pair.fit))
    return [_fitted(fitter, pair) for pair in screened[:FITTED_PAIRS]]


def _combines(trial: Trial) -> bool:
    """Whether a hypothesis may be one of a pair: it acts all window long, and not through what is
    left of the healthy fit alone.
    """
    h = trial.hypothesis
    return (
        h.in_residual is None
        and h.begin is None
        and h.kind != "disturbance"
        and not trial.fit.onset
    )


def _fitted(fitter: WindowFitter, pair: Pair) -> Pair:
    """The pair fitted to the end; as it was where that diverges or costs more."""
    fit = fitter.fit(pair.fit.variant, begin=pair.fit)
    if fit is None or fitter.cost(fit) > fitter.cost(pair.fit):
        return pair
    return replace(pair, fit=fit)


def _ended(fit: Fit) -> Variant:
    """The fit's variant, beginning where the fit ended."""
    variant, p = fit.variant, len(fit.variant.own)
    model = variant.model.with_values(dict(zip(variant.own, fit.own[:p].tolist(), strict=True)))
    return replace(variant, model=model, sizes=tuple(fit.own[p:].tolist()))


def combined(model: PhysicalModel, first: Variant, second: Variant) -> Variant:
    """One variant that does both at once: the effects of both, and the second edit of inputs and
    readings after the first. `model` is the healthy one.
    """
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
    """Places of each variant's sizes in those of their combination, which are ordered (parameters of
    the first, of the second, edits of the first, of the second).
    """
    p, q, n = len(first.own), len(second.own), len(first.sizes)
    return (
        [*range(p), *range(p + q, p + q + n)],
        [*range(p, p + q), *range(p + q + n, p + q + n + len(second.sizes))],
    )


_RANK = {"parameter": 0, "sensor": 1, "actuator": 1, "effect": 2, "disturbance": 3}
"""Order of what cannot be told apart: what changed before what is new."""
_LAST_RANK = 9  # after every one of them

_NOTHING = 1e-3
"""Share of its standard deviation below which a size is zero."""
_LARGEST = 1e100
"""Information that can be inverted."""


@dataclass(frozen=True, eq=False)
class Cause:
    """What may have happened in a window.

    Attributes
    ----------
    hypothesis : Hypothesis or None
        None: a cause that no hypothesis names (`unknown`).
    probability : float
    size, std : array, shape (sizes,)
        Its sizes and their standard deviations.
    onset : int
        Sample at which it began; 0: before the window, or not known.
    alike, beside : tuple of str
        Labels of hypotheses that cannot be told from it, and of those that act at the same time.
    """

    hypothesis: Hypothesis | None
    probability: float
    size: FloatArray
    std: FloatArray
    onset: int
    alike: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()


def causes(baseline: Baseline, window: Experiment, features: FloatArray) -> list[Cause]:
    """Causes of what a window shows beyond healthy ones, the likeliest first; none of size zero."""
    return of_some_size(_causes(baseline, window, features))


def of_some_size(listed: Sequence[Cause]) -> list[Cause]:
    """Without causes of size zero, which leave the window as it is: what they were said to explain
    has an unknown cause.
    """
    zero = [cause for cause in listed if _is_of_size_zero(cause)]
    if not zero:
        return list(listed)
    names = {cause.hypothesis.label for cause in zero if cause.hypothesis is not None}
    unknown = sum(
        cause.probability for cause in listed if cause in zero or cause.hypothesis is None
    )
    sized = [
        _without_names(cause, names)
        for cause in listed
        if cause.hypothesis is not None and cause not in zero
    ]
    return _with_unknown(sized, unknown, lead=1)


def _without_names(cause: Cause, names: set[str]) -> Cause:
    """The cause with these hypotheses neither alike nor beside it."""
    return replace(
        cause,
        alike=tuple(name for name in cause.alike if name not in names),
        beside=tuple(name for name in cause.beside if name not in names),
    )


def _with_unknown(listed: Sequence[Cause], probability: float, lead: int) -> list[Cause]:
    """The causes and `unknown`, which stands first where it is the likeliest, else after the
    `lead` causes that are told together.
    """
    # zero causes of one pair each carry the pair's whole probability: their sum may pass 1
    unknown = Cause(None, min(probability, 1.0), np.zeros(0), np.zeros(0), 0)
    if not listed or probability > listed[0].probability:
        return [unknown, *listed]
    return [*listed[:lead], unknown, *listed[lead:]]


def _is_of_size_zero(cause: Cause) -> bool:
    """Whether what a cause adds is nothing. A changed parameter, or where a sensor sticks, may well
    be zero.
    """
    h = cause.hypothesis
    if h is None or not len(cause.size):
        return False
    if h.kind not in ("effect", "sensor", "actuator") or h.name == "stuck":
        return False
    return bool(np.all(np.abs(cause.size) <= _NOTHING * np.nan_to_num(cause.std)))


def _causes(baseline: Baseline, window: Experiment, features: FloatArray) -> list[Cause]:
    fitter = baseline.fitter(window, features)
    healthy, trials = try_hypotheses(fitter, baseline.hypotheses, baseline.usual_gain)
    if not trials:
        return _with_unknown([], 1.0, lead=0)
    all_window_long = list(trials.values())
    best = _cheapest(baseline, fitter, all_window_long)
    if _may_have_an_onset(baseline, features, best):
        for label, beginning in search_onsets(baseline, fitter, features).items():
            rivals = [beginning, trials[label]] if label in trials else [beginning]
            trials[label] = _cheapest(baseline, fitter, rivals)
    listed = list(trials.values())
    single_causes = _weighed(baseline, fitter, listed)
    best = _cheapest(baseline, fitter, listed)
    # noise and lost readings are what is left, so that nothing is left over beside them
    in_residual = best.hypothesis.in_residual is not None
    unknown = 0.0 if in_residual else _unknown(baseline, fitter, features, healthy, best.fit)
    if not unknown:
        return single_causes
    # one cause leaves more than is usual: two at once are dearer to try, so only now
    two = _two(baseline, fitter, all_window_long, listed)
    if two is None:
        return _with_unknown(_scaled(single_causes, 1.0 - unknown), unknown, lead=1)
    alone = [c for c in single_causes if c.hypothesis not in two.pair.both]
    causes = [*two.causes, *_scaled(alone, 1.0 - two.probability)]
    unknown = _unknown(baseline, fitter, features, healthy, two.pair.fit)
    causes = _scaled(causes, 1.0 - unknown)
    return _with_unknown(causes, unknown, lead=2) if unknown else causes


def _may_have_an_onset(baseline: Baseline, features: FloatArray, best: Trial) -> bool:
    """Whether beginnings within the window are worth their work: the best cause that acts all
    window long leaves much, or has many sizes, which may stand for a beginning.
    """
    if best.hypothesis.in_residual is not None:
        return False
    left = float(baseline.error_excess(features, best.fit).max())
    return left > UNEXPLAINED or len(best.fit.own) > 2


def _scaled(causes: Iterable[Cause], share: float) -> list[Cause]:
    """The causes with their probabilities times `share`."""
    return [replace(cause, probability=share * cause.probability) for cause in causes]


@dataclass(frozen=True, eq=False)
class _TwoCauses:
    """The best pair, its two causes, and the probability that any pair is right."""

    pair: Pair
    causes: list[Cause]
    probability: float


def _two(
    baseline: Baseline, fitter: WindowFitter, whole: Sequence[Trial], listed: Sequence[Trial]
) -> _TwoCauses | None:
    """The best pair of causes that may have acted all window long, where it costs less than any
    single hypothesis. The probability of one of its causes is that of all pairs which hold it.
    """
    candidates = pairs(baseline, fitter, whole)
    if not candidates:
        return None
    count = len(candidates)
    block_costs, fixed = _costs(baseline, fitter, candidates, listed)
    total = block_costs.sum(axis=1) + fixed
    lead = int(np.argmin(total[:count]))
    if total[lead] > total[count:].min() - TIE:
        return None
    frequencies, near = (
        _selection_frequencies(block_costs, fixed),
        _within_doubt(block_costs, total, lead),
    )
    rivals = [pair for k, pair in enumerate(candidates) if k != lead and near[k]]
    best = candidates[lead]
    std = _open(fitter, best.fit)
    pair_causes = []
    for h, partner, own, at in zip(best.both, best.both[::-1], best.own, best.sizes, strict=True):
        holding = [j for j, pair in enumerate(candidates) if h.label in pair.labels]
        probability = min(sum(float(frequencies[j]) for j in holding), 1.0)
        doubt = np.sqrt(std[at] ** 2 + _scatter(baseline, fitter, h, own, len(at)))
        alike, beside = _alike_beside(partner.label, h, rivals), (partner.label,)
        pair_causes.append(Cause(h, probability, best.fit.own[at], doubt, 0, alike, beside))
    return _TwoCauses(best, pair_causes, float(frequencies[:count].sum()))


def _costs(
    baseline: Baseline, fitter: WindowFitter, candidates: Sequence[Pair], listed: Sequence[Trial]
) -> tuple[FloatArray, FloatArray]:
    """[nat] What each pair and then each single hypothesis costs: its error in each block, shape
    (trials, blocks), and what does not depend on blocks, shape (trials,).
    """
    fits = [*(pair.fit for pair in candidates), *(t.fit for t in listed)]
    usual = [sum(baseline.usual_gain(h) for h in pair.both) for pair in candidates]
    usual += [baseline.usual_gain(t.hypothesis) for t in listed]
    block_costs = np.array([fitter.block_costs(fit) for fit in fits])
    return block_costs, np.array([fitter.penalty(fit) for fit in fits]) + np.array(usual)


def _alike_beside(partner: str, h: Hypothesis, rivals: Iterable[Pair]) -> tuple[str, ...]:
    """What might stand in place of a hypothesis beside its partner: the other one of each rival
    pair that holds the partner.
    """
    beside_partner = [pair.labels for pair in rivals if partner in pair.labels]
    return tuple(name for labels in beside_partner for name in labels - {partner, h.label})


def _cheapest(baseline: Baseline, fitter: WindowFitter, fits: Iterable[Trial]) -> Trial:
    return min(fits, key=lambda t: fitter.cost(t.fit) + baseline.usual_gain(t.hypothesis))


def _unknown(
    baseline: Baseline, fitter: WindowFitter, features: FloatArray, healthy: Fit, best: Fit
) -> float:
    """Probability that something else is there too: the share of the window's excess cost over a
    healthy one that the best fit does not take away; 0 where its error is as usual.

    Not asked of noise and lost readings: they are what is left, and take nothing away from it.
    """
    if baseline.error_excess(features, best).max() <= UNEXPLAINED:
        return 0.0
    excess = fitter.cost(healthy) - fitter.healthy_cost()
    taken = fitter.cost(healthy) - fitter.cost(best)
    return float(np.clip(1.0 - taken / max(excess, 1e-12), LEAST_UNKNOWN, 1.0))


def _weighed(baseline: Baseline, fitter: WindowFitter, listed: Sequence[Trial]) -> list[Cause]:
    """Causes with their probabilities: how often each costs least over resampled blocks. Those whose
    cost lies within doubt of the leading one's, and which have no more sizes, are told as alike.
    """
    block_costs = np.array([fitter.block_costs(t.fit) for t in listed])
    fixed = np.array([fitter.penalty(t.fit) + baseline.usual_gain(t.hypothesis) for t in listed])
    sizes = np.array([len(t.fit.own) + (t.fit.onset > 0) for t in listed])
    total, frequencies = (
        block_costs.sum(axis=1) + fixed,
        _selection_frequencies(block_costs, fixed, sizes),
    )
    # Shares of draws are compared to a hundredth: beyond it the draws decide, not the window, and
    # the lower cost does.
    lead = int(np.lexsort((total, -frequencies.round(2)))[0])
    group = _within_doubt(block_costs, total, lead) & (sizes <= sizes[lead])
    group[lead] = True
    # The group first, in it those that cost the same to half a tie by what changed before what is
    # new, then the lowest cost; outside of it the likeliest.
    rank = np.array([_rank(baseline, t) for t in listed])
    same = total - total[group].min() < 0.5 * TIE
    order = np.lexsort(
        (
            total,
            np.where(group & same, rank, _LAST_RANK),
            -np.where(group, 1.0, frequencies),
            ~group,
        )
    )
    names = [listed[k].hypothesis.label for k in order if group[k]]
    causes = []
    for k in order[:CAUSES_LISTED].tolist():
        h, fit = listed[k].hypothesis, listed[k].fit
        alike = tuple(name for name in names if name != h.label) if group[k] else ()
        doubt = _doubt(baseline, fitter, listed[k])
        causes.append(Cause(h, float(frequencies[k]), fit.own, doubt, fit.onset, alike))
    return causes


def _rank(baseline: Baseline, trial: Trial) -> int:
    """Place of a hypothesis among those that cannot be told apart; a value of the healthy model
    stands first, whatever kind of hypothesis moves it.
    """
    moves_a_value = set(trial.fit.variant.own) & set(baseline.free)
    return 0 if moves_a_value else _RANK[trial.hypothesis.kind]


def _selection_frequencies(
    block_costs: FloatArray, fixed: FloatArray, sizes: FloatArray | None = None
) -> FloatArray:
    """How often each trial costs least over resampled blocks (bootstrap), shape (trials,); those
    within `TIE` (a likelihood ratio of twenty) share a draw, of them the ones of fewest sizes.
    """
    # one seed for all windows: the same window is always told the same
    rng, frequencies = np.random.default_rng(0), np.zeros(len(block_costs))
    for _ in range(DRAWS):
        cost = block_costs[:, rng.integers(0, BLOCKS, BLOCKS)].sum(axis=1) + fixed
        near = np.flatnonzero(cost < cost.min() + TIE)
        if sizes is not None:
            near = near[sizes[near] == sizes[near].min()]
        frequencies[near] += 1.0 / len(near) / DRAWS
    return frequencies


def _within_doubt(block_costs: FloatArray, total: FloatArray, lead: int) -> npt.NDArray[np.bool_]:
    """Whether each trial costs no more than the leading one but for the doubt of their difference,
    shape (trials,).
    """
    # the difference is a sum over blocks: what it scatters by from block to block
    doubt = np.std(block_costs - block_costs[lead], axis=1, ddof=1) * np.sqrt(BLOCKS)
    return np.asarray(total - total[lead] < np.maximum(TIE, doubt))


def _doubt(baseline: Baseline, fitter: WindowFitter, trial: Trial) -> FloatArray:
    """Standard deviation of the sizes: what the window leaves open, and how the same sizes scatter
    in healthy windows.
    """
    fit, h = trial.fit, trial.hypothesis
    variance = _scatter(baseline, fitter, h, fit.variant.own, len(fit.own))
    return (
        np.sqrt(variance)
        if h.in_residual is not None
        else np.sqrt(_open(fitter, fit) ** 2 + variance)
    )


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
    k, own = len(fit.values), fit.variant.own
    H = information(fit, k + len(fit.own))
    keep = [j for j, name in enumerate(fitter.free) if name not in own]
    # the other values are known from healthy windows: their prior adds to what the window tells
    H[:k, :k] += np.linalg.inv(fitter.covariance[np.ix_(keep, keep)])
    if not np.all(np.abs(H) < _LARGEST) or np.any(np.diag(H)[k:] < 1.0 / _LARGEST):
        # at sizes where the slopes overflow or vanish nothing is known of them
        return np.full(len(fit.own), np.nan)
    # scaled to unit diagonal, so that the floor on eigenvalues means the same in any unit
    scale = np.sqrt(np.maximum(np.diag(H), 1.0 / _LARGEST))
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))  # what nothing tells is wide open
    return np.asarray(
        np.sqrt(np.sum(vectors**2 / np.maximum(values, 1e-12), axis=1) / scale**2)[k:]
    )


# Things that began within a window: healthy up to a sample, and from the states there on with the
# hypothesis.

_SHORTEST = 10
"""[samples] Before and after a beginning."""


def search_onsets(
    baseline: Baseline, fitter: WindowFitter, features: FloatArray
) -> dict[str, Trial]:
    """The best onset of each hypothesis by its label: from a coarse grid over the window, then, for
    the hypotheses that cost least, by halving the steps about their onsets.
    """
    # Noise and lost readings have no state to begin from, a stuck signal carries its beginning as a
    # size, and a load's knots bend wherever it begins.
    window, beginnings = fitter.window, dict[str, Trial]()
    listed = [
        h for h in baseline.hypotheses if not (h.in_residual or h.begin or h.kind == "disturbance")
    ]
    for part in range(1, PARTS):
        _keep(
            beginnings,
            _fits_from(
                baseline, fitter, features, window.n * part // PARTS, listed, SCREENING_STEPS
            ),
            fitter,
        )
    steps = window.n // PARTS
    while (steps := steps // 2) > window.n // WINDOW_PARTS:
        ranked = sorted(
            beginnings.values(),
            key=lambda t: fitter.cost(t.fit) + baseline.usual_gain(t.hypothesis),
        )
        for t in ranked[:ONSETS_FOLLOWED]:
            for at in (t.fit.onset - steps, t.fit.onset, t.fit.onset + steps):
                _keep(
                    beginnings,
                    _fits_from(baseline, fitter, features, at, [t.hypothesis], FIT_STEPS),
                    fitter,
                )
    return beginnings


def _keep(cheapest: dict[str, Trial], new: Sequence[Trial], fitter: WindowFitter) -> None:
    for t in new:
        old = cheapest.get(t.hypothesis.label)
        if old is None or fitter.cost(t.fit) < fitter.cost(old.fit):
            cheapest[t.hypothesis.label] = t


def _fits_from(
    baseline: Baseline,
    fitter: WindowFitter,
    features: FloatArray,
    at: int,
    listed: Sequence[Hypothesis],
    steps: int,
) -> list[Trial]:
    window = fitter.window
    if not _SHORTEST < at < window.n - _SHORTEST:
        return []
    # The healthy model up to the beginning; its states there, which that fit estimates, start the
    # hypothesis. The sample in common is counted once, in the later part.
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
            prior_cost = fit.prior_cost + head.prior_cost
            trials.append(
                Trial(
                    h,
                    replace(
                        fit,
                        white=white,
                        error=error,
                        power=fitter.blocks(white),
                        prior_cost=prior_cost,
                        onset=at,
                    ),
                )
            )
    return trials
