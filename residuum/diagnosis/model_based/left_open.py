r"""What a model may lack without healthy windows having told for sure, and how far that can lead a size astray.

An effect that the model lacks is made up for by the values of healthy windows, as far as these can: with β what they take over of
a unit of it, E − J Z β is left. A fault brings the machine to where no healthy window has been, the effect there is another, and
the size of the fault is told too large or too small by

.. math:: \frac{C^T Σ^{-1} (E - J Z β)}{C^T Σ^{-1} C}

times the effect's size, C the slopes by the fault's own. That size is b with variance v, as all healthy windows together tell it,
beside a prior that holds its term to a twentieth of its balance's largest (variance v₀). Which effect it is they seldom tell, so
nothing is corrected. At most one is lacking, as probable beforehand as none is; with the Bayes factor √(v/v₀) exp(b²/2v) each has
the probability p, and p (b² + v) times the square above, over all effects, is added to the size's variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.filtered_window import Filtered, TrackingFilter
from residuum.diagnosis.model_based.healthy_scatter import HealthyScatter
from residuum.diagnosis.model_based.hypotheses import Hypothesis, Signals
from residuum.diagnosis.model_based.window_statistics import WindowStatistics

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_SMALL = 0.05
"""Share of its balance's largest term that an effect left out has at most, about (one standard deviation)."""
_APART = 1e-6
"""Share of its information that an effect must have beside the model's values."""


@dataclass(frozen=True, eq=False)
class LeftOpen:
    """Effects that the model may lack, in units of the scatter's scale.

    Attributes
    ----------
    sizes : array of int, shape (e,)
        Which sizes they are.
    absorbed : array, shape (p, e)
        β: what the scatter's coefficients take over of a unit of each.
    size : array, shape (e,)
        √(p (b² + v)) of each.
    """

    sizes: Integers
    absorbed: Array
    size: Array


def left_open(
    windows: Sequence[WindowStatistics], scatter: HealthyScatter, listed: Sequence[Hypothesis], largest: Array
) -> LeftOpen:
    """Of healthy windows; `largest` is a standard deviation of each size beforehand, in its unit (infinite: not asked for)."""
    columns = [h.kind for h in listed for _ in h.columns]
    asked = [
        k
        for k, kind in enumerate(columns)
        if kind in ("effect", "disturbance") and np.isfinite(largest[k]) and k not in scatter.own
    ]
    at, own, D = np.array(asked, dtype=np.int64), scatter.own, np.diag(scatter.variance)
    p, e = len(scatter.moving), len(asked)
    H, B, left_over = np.zeros((p, p)), np.zeros((p, e)), np.zeros(p)
    information, raw, score = np.zeros(e), np.zeros(e), np.zeros(e)
    for w in windows:
        s, Z = w.scaled(scatter.scale), scatter.design(w.conditions)
        A, AE = s.A[np.ix_(own, own)], s.A[np.ix_(own, at)]
        weights = np.linalg.solve(np.eye(len(own)) + D @ A, D)
        left = Z.T @ (np.eye(len(own)) - A @ weights)
        H, B = H + left @ A @ Z, B + left @ AE
        rest = s.g - s.A @ scatter.mean(w.conditions)
        left_over += left @ rest[own]
        raw += np.diag(s.A)[at]
        information += np.diag(s.A)[at] - np.einsum("ie,ij,je->e", AE, weights, AE)
        score += rest[at] - AE.T @ weights @ rest[own]
    absorbed = np.asarray(np.linalg.lstsq(H, B, rcond=1e-12)[0], dtype=np.float64)
    information, score = information - np.einsum("pe,pe->e", absorbed, B), score - absorbed.T @ left_over
    apart = information > _APART * raw  # what does the same as a value of the model is that value by another name
    at, absorbed, score = at[apart], absorbed[:, apart], score[apart]
    before = (largest[at] / scatter.scale[at]) ** 2
    variance = 1.0 / (information[apart] + 1.0 / before)
    mean = variance * score
    size = np.sqrt(_probabilities(0.5 * np.log(variance / before) + 0.5 * mean**2 / variance) * (mean**2 + variance))
    return LeftOpen(at, absorbed, size)


def _probabilities(log_factors: Array) -> Array:
    """Of each effect, at most one of which is there, from the logarithms of their Bayes factors against none."""
    top = max(float(np.max(log_factors, initial=0.0)), 0.0)
    factors = np.exp(log_factors - top) / max(len(log_factors), 1)
    return np.asarray(factors / (np.exp(-top) + np.sum(factors)))


def largest_sizes(tracking: TrackingFilter, windows: Sequence[Filtered], listed: Sequence[Hypothesis]) -> Array:
    """Size with which each term of a balance is a twentieth of the balance's largest; infinite for what is no such term."""
    signals = Signals(tracking.model, listed)
    of_terms = dict.fromkeys(tracking.model.balances, 0.0)
    of_signals = np.zeros(sum(len(h.columns) for h in listed))
    for w in windows:
        X = tracking.states(w)
        look = tracking.simulator.look(w.experiment, X)
        of_signals = np.maximum(of_signals, np.sqrt(np.mean(signals.of(w, X) ** 2, axis=0)))
        for name, balance in tracking.model.balances.items():
            of_terms[name] = max(of_terms[name], *(float(np.sqrt(np.mean(look[f"{name}.{t}"] ** 2))) for t in balance.terms))
    found = []
    for column, own in zip([c for h in listed for c in h.columns], of_signals, strict=True):
        kind, _, name = column.acts_on.partition(":")
        found.append(_SMALL * of_terms[name] / own if kind == "balance" and own > 0.0 and of_terms[name] > 0.0 else np.inf)
    return np.array(found)
