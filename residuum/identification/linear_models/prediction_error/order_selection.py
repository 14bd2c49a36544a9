"""Choice of the order: information criteria of the estimation data, or the error on data that the
fit has not seen.

    AIC = −2 log p + 2 d,   BIC = −2 log p + d log n
    CV  = (1/n) Σ_j (y_j − ŷ^{−δ(j)}(j))²,   δ(j) the fold of sample j                     — (A.7) of the source

The folds are contiguous blocks of every record (`k-fold`), or whole records, each from an item of
its own (`record-wise`: the source's object-wise cross-validation, which shows what an unseen item
will cost). Random folds would lie: neighbours in time share their noise.

When the choice fails: cross-validation and AIC take too high an order now and then, since a
superfluous coefficient costs a long record next to nothing; BIC finds the true order of long
records, if there is one.

References
----------
C. Bergmeir, J. M. Benítez, *On the use of cross-validation for time series predictor evaluation*,
Information Sciences 191 (2012): blocks. (A.3)–(A.7) of the source.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import NotIdentifiable
from residuum.identification.linear_models.prediction_error.criterion import Criterion, Orders
from residuum.identification.linear_models.prediction_error.data import Signals
from residuum.identification.linear_models.prediction_error.search import Minimum, rough_fit
from residuum.identification.linear_models.prediction_error.starts import FirstValues, Structure

Pair = tuple[FloatArray, FloatArray]

CRITERIA = ("bic", "aic", "k-fold", "record-wise")
_WARM_UP = 4


@dataclass(frozen=True, eq=False)
class Fold:
    """What a fit learns from, and what it is judged on.

    Attributes
    ----------
    training : Signals
        All else; a record with a block taken out has become two records.
    judged : tuple of ((u, y), start)
        Signals up to the end of the held-out block. Samples from `start` on are judged, those
        before only fix the state.
    """

    training: Signals
    judged: tuple[tuple[Pair, int], ...]

    def allows(self, orders: Orders) -> bool:
        """Whether five samples a parameter are left to learn from, and enough precede the judged
        ones to fix the state.
        """
        memory = max(orders.memory, 2 * orders.nf)
        return (
            self.training.n >= 5 * orders.count and min(start for _, start in self.judged) >= memory
        )


def block_folds(data: Signals, count: int) -> list[Fold]:
    """Fold k leaves the k-th of `count` contiguous blocks out of every record.

    NotIdentifiable when a record has fewer than ten samples a block.
    """
    shortest = min(len(y) for _, y in data.pairs)
    if count < 2 or shortest < 10 * count:
        raise NotIdentifiable(
            f"k-fold: {count} blocks of a record of {shortest} samples; at least 2 blocks of 10 are"
            " needed"
        )
    folds = []
    for k in range(count):
        training: list[Pair] = []
        judged = []
        for u, y in data.pairs:
            start, stop = k * len(y) // count, (k + 1) * len(y) // count
            training += [
                (u[part], y[part]) for part in (slice(start), slice(stop, None)) if len(y[part])
            ]
            judged.append(((u[:stop], y[:stop]), start or stop // _WARM_UP))
        folds.append(Fold(replace(data, pairs=tuple(training)), tuple(judged)))
    return folds


def record_folds(data: Signals) -> list[Fold]:
    """Fold k leaves record k out; its first quarter fixes its state, the rest is judged.
    NotIdentifiable for one record.
    """
    if len(data.pairs) < 2:
        raise NotIdentifiable(
            "record-wise: has one record; leaving one out needs at least two (k-fold does with one)"
        )
    return [
        Fold(
            replace(data, pairs=data.pairs[:k] + data.pairs[k + 1 :]),
            ((pair, len(pair[1]) // _WARM_UP),),
        )
        for k, pair in enumerate(data.pairs)
    ]


def cross_validation(
    structure: Structure,
    folds: Sequence[Fold],
    candidates: Sequence[Orders],
    *,
    offset: bool = True,
) -> FloatArray:
    """Mean square of the one-step prediction errors on held-out samples, (A.7), shape
    (len(candidates),), data's unit².

    Level and polynomials come from the training part, the state at the block's beginning from the
    samples before it. Every fold must allow every candidate.
    """
    total = np.zeros(len(candidates))
    for fold in folds:
        first = FirstValues(
            fold.training, candidates[0].delay, max(max(o.nf, o.na, o.nb) for o in candidates)
        )
        for number, orders in enumerate(candidates):
            fit = rough_fit(structure, fold.training, orders, first, offset=offset)
            total[number] += sum(
                _squared_error(fit, orders, fold.training, part, offset) for part in fold.judged
            )
    samples = sum(len(pair[1]) - start for fold in folds for pair, start in fold.judged)
    return total / samples * folds[0].training.y_scale ** 2


def information(fit: Minimum, orders: Orders, n: int) -> dict[str, float]:
    """AIC and BIC of a fit for `n` samples, nuisance parameters (level, free responses) not
    counted.

    One `n` for all candidates: each loses as many first samples as its regressor reaches back, and
    sums over unequal numbers of samples must not be compared.
    """
    likelihood = negative_log_likelihood(fit, n)
    return {
        "aic": 2 * likelihood + 2 * orders.count,
        "bic": 2 * likelihood + np.log(n) * orders.count,
    }


def negative_log_likelihood(fit: Minimum, n: int) -> float:
    """−log p of `n` Gaussian innovations of the variance that the fit leaves."""
    return 0.5 * n * (np.log(2 * np.pi * max(fit.normal.cost / fit.normal.n, 1e-300)) + 1.0)


def _squared_error(
    fit: Minimum, orders: Orders, training: Signals, part: tuple[Pair, int], offset: bool
) -> float:
    """Σ e² over the judged samples of one part."""
    (u, y), start = part
    shared = orders.count + int(offset)
    before = Criterion(replace(training, pairs=((u[:start], y[:start]),)), orders, level=offset)
    x = np.concatenate([fit.x[:shared], np.zeros(before.free)])
    # e is linear in the free response: one Gauss–Newton step is its least-squares estimate
    if before.free:
        normal = before.normal(x)
        x[shared:] = np.linalg.lstsq(
            normal.gram[shared:, shared:], normal.gradient[shared:], rcond=1e-12
        )[0]
    whole = Criterion(replace(training, pairs=((u, y),)), orders, level=offset)
    e = whole.innovations(x)[0][-(len(y) - start) :]
    return float(e @ e)
