"""Which cause: all hypotheses weighed in nats, their probabilities counted over resampled blocks, what is alike in one group."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.hypotheses import Hypothesis
from residuum.diagnosis.model_based.onset import begun
from residuum.diagnosis.model_based.policy import LEAST_UNKNOWN, TOLD, UNEXPLAINED
from residuum.diagnosis.model_based.trying import Tried, tried
from residuum.diagnosis.model_based.window_fit import Fit, WindowFitter, information
from residuum.identification.physics import Experiment
from residuum.identification.unseen_blocks.policy import BLOCKS, DRAWS, TIE

Array = npt.NDArray[np.float64]
_RANK = {"parameter": 0, "sensor": 1, "actuator": 1, "effect": 2, "disturbance": 3}
"""Order of what cannot be told apart: what changed before what is new."""

_LARGEST = 1e100
"""Information that can be inverted."""


@dataclass(frozen=True, eq=False)
class Cause:
    """A hypothesis (None: `unknown`), its probability, sizes, their standard deviations, where it began, and what is alike."""

    hypothesis: Hypothesis | None
    probability: float
    size: Array
    std: Array
    onset: int
    alike: tuple[str, ...] = ()


def causes(baseline: Baseline, window: Experiment, features: Array) -> list[Cause]:
    """The likeliest first."""
    fitter = baseline.fitter(window, features)
    healthy, found = tried(fitter, baseline.hypotheses, baseline.usual_gain)
    if not found:
        return [Cause(None, 1.0, np.zeros(0), np.zeros(0), 0)]
    best = _cheapest(baseline, fitter, found.values())
    left = float(baseline.surprise(features, best.fit).max())
    if best.hypothesis.seen is None and (left > UNEXPLAINED or len(best.fit.own) > 2):  # many sizes may stand for a beginning
        for label, one in begun(baseline, fitter, features).items():
            found[label] = _cheapest(baseline, fitter, [one, *([found[label]] if label in found else [])])
    listed = list(found.values())
    told = _weighed(baseline, fitter, listed)
    best = _cheapest(baseline, fitter, listed)
    unknown = _unknown(baseline, fitter, features, healthy, best)
    if not unknown:
        return told
    others = [Cause(c.hypothesis, (1.0 - unknown) * c.probability, c.size, c.std, c.onset, c.alike) for c in told]
    nobody = Cause(None, unknown, np.zeros(0), np.zeros(0), 0)
    return [nobody, *others] if unknown > others[0].probability else [others[0], nobody, *others[1:]]


def _cheapest(baseline: Baseline, fitter: WindowFitter, fits: Iterable[Tried]) -> Tried:
    return min(fits, key=lambda t: fitter.nats(t.fit) + baseline.usual_gain(t.hypothesis))


def _unknown(baseline: Baseline, fitter: WindowFitter, features: Array, healthy: Fit, best: Tried) -> float:
    """Probability that something else is there too: the part of the excess that the best cause leaves; 0 where that is usual."""
    if best.hypothesis.seen is not None or baseline.surprise(features, best.fit).max() <= UNEXPLAINED:
        return 0.0  # noise and lost readings are what is left: they take nothing away from it
    excess = fitter.nats(healthy) - fitter.healthy_logs()
    taken = fitter.nats(healthy) - fitter.nats(best.fit)
    return float(np.clip(1.0 - taken / max(excess, 1e-12), LEAST_UNKNOWN, 1.0))


def _weighed(baseline: Baseline, fitter: WindowFitter, listed: Sequence[Tried]) -> list[Cause]:
    """Probability by how often each is the cheapest over resampled blocks; those within a factor of twenty and of fewest sizes
    share a draw. Whoever is within the doubt of the difference to the leading one, and no richer, is alike."""
    fits, rng = [t.fit for t in listed], np.random.default_rng(0)
    logs = np.array([fitter.logs(fit) for fit in fits])
    fixed = np.array([fitter.price(t.fit) + baseline.usual_gain(t.hypothesis) for t in listed])
    sizes = np.array([len(fit.own) + (fit.onset > 0) for fit in fits])
    total, wins = logs.sum(axis=1) + fixed, np.zeros(len(fits))
    for _ in range(DRAWS):
        cost = logs[:, rng.integers(0, BLOCKS, BLOCKS)].sum(axis=1) + fixed
        near = np.flatnonzero(cost < cost.min() + TIE)
        near = near[sizes[near] == sizes[near].min()]
        wins[near] += 1.0 / len(near) / DRAWS
    lead = int(np.lexsort((total, -wins.round(2)))[0])
    doubt = np.std(logs - logs[lead], axis=1, ddof=1) * np.sqrt(BLOCKS)
    group = (total - total[lead] < np.maximum(TIE, doubt)) & (sizes <= sizes[lead])
    group[lead] = True
    changed = [0 if set(t.fit.variant.own) & set(baseline.free) else _RANK[t.hypothesis.kind] for t in listed]
    same = total - total[group].min() < 0.5 * TIE
    order = np.lexsort((total, np.where(group & same, changed, 9), -np.where(group, 1.0, wins), ~group))
    names = [listed[k].hypothesis.label for k in order if group[k]]
    found = []
    for k in order[:TOLD].tolist():
        one = listed[k]
        alike = tuple(n for n in names if n != one.hypothesis.label) if group[k] else ()
        found.append(Cause(one.hypothesis, float(wins[k]), one.fit.own, _doubt(baseline, fitter, one), one.fit.onset, alike))
    return found


def _doubt(baseline: Baseline, fitter: WindowFitter, tried: Tried) -> Array:
    """Standard deviation of the sizes: what the window leaves open, and how the same sizes scatter in healthy windows."""
    fit, h = tried.fit, tried.hypothesis
    k, own = len(fit.others), fit.variant.own
    known = baseline.usual.get(h.label)
    variance = known.variance if known is not None else 0.0
    usual = np.broadcast_to(variance if np.size(variance) in (1, len(fit.own)) else 0.0, fit.own.shape)
    if h.seen is not None:
        return np.sqrt(usual)
    H = information(fit, k + len(fit.own))
    keep = [j for j, name in enumerate(fitter.free) if name not in own]
    H[:k, :k] += np.linalg.inv(fitter.covariance[np.ix_(keep, keep)])
    if not np.all(np.abs(H) < _LARGEST) or np.any(np.diag(H)[k:] < 1.0 / _LARGEST):
        return np.full(len(fit.own), np.nan)  # at sizes where the slopes overflow or vanish nothing is known of them
    scale = np.sqrt(np.maximum(np.diag(H), 1.0 / _LARGEST))
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    open_ = (np.sum(vectors**2 / np.maximum(values, 1e-12), axis=1) / scale**2)[k:]  # what nothing tells is wide open
    if own and own[0] in fitter.free:
        return np.sqrt(open_ + np.diag(fitter.covariance)[[fitter.free.index(name) for name in own]])
    return np.sqrt(open_ + usual)
