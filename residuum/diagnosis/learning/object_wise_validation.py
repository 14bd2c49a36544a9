"""How well a classifier does on an object it has never seen: object-wise cross-validation beside the usual folds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import beta
from sklearn.base import BaseEstimator, clone
from sklearn.model_selection import LeaveOneGroupOut, StratifiedKFold, cross_val_predict

from residuum.identification.errors import BadInput

Labels = npt.NDArray[Any]
Matrix = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Validation:
    """Held-out predictions and what follows from them.

    Attributes
    ----------
    truth, predicted : arrays of labels, shape (n,)
    objects : array, shape (n,)
        The object (exemplar) that each observation comes from.
    """

    truth: Labels
    predicted: Labels
    objects: npt.NDArray[Any]

    @property
    def accuracy(self) -> float:
        """Share of right predictions; 1 − OCV of (A.7) with the 0–1 loss, when the predictions are object-wise."""
        return float(np.mean(self.truth == self.predicted))

    @property
    def balanced_accuracy(self) -> float:
        """Mean over the true classes of the share that was found."""
        return balanced_accuracy(self.truth, self.predicted)

    def confusion(self, labels: Sequence[str]) -> npt.NDArray[np.int_]:
        """Counts, rows predicted and columns true (as the source's Table 7), in the order of `labels`."""
        rows = [[int(np.sum((self.predicted == said) & (self.truth == true))) for true in labels] for said in labels]
        return np.asarray(rows, dtype=int)

    def interval(
        self, score: Callable[[Labels, Labels], float], confidence: float = 0.95, repeats: int = 1000, seed: int = 0
    ) -> tuple[float, float]:
        """Interval of `score(truth, predicted)` by drawing whole objects with replacement.

        Movements of one object resemble each other, so drawing them one by one would promise too much. Fails (too narrow) for
        fewer than about ten objects.
        """
        rng = np.random.default_rng(seed)
        names = np.unique(self.objects)
        rows = {name: np.flatnonzero(self.objects == name) for name in names}
        scores = []
        for _ in range(repeats):
            drawn = np.concatenate([rows[name] for name in rng.choice(names, len(names))])
            scores.append(score(self.truth[drawn], self.predicted[drawn]))
        low, high = np.quantile(scores, [(1 - confidence) / 2, (1 + confidence) / 2])
        return float(low), float(high)


def balanced_accuracy(truth: Labels, predicted: Labels) -> float:
    """Mean over the true classes of the share that was found; predictions may hold classes that the truth has not (`unknown`)."""
    return float(np.mean([np.mean(predicted[truth == label] == label) for label in np.unique(truth)]))


def object_wise(estimator: BaseEstimator, X: Matrix, y: Sequence[str], objects: Sequence[object]) -> Validation:
    """Object-wise cross-validation (A.7): each object is predicted by an estimator trained on all others.

    Raises BadInput with fewer than two objects.
    """
    names = np.asarray(objects)
    if np.unique(names).shape[0] < 2:
        raise BadInput("object-wise validation: all observations come from one object; at least two are needed")
    predicted = cross_val_predict(estimator, X, np.asarray(y), groups=names, cv=LeaveOneGroupOut())
    return Validation(np.asarray(y), predicted, names)


def mixed_folds(
    estimator: BaseEstimator, X: Matrix, y: Sequence[str], objects: Sequence[object], folds: int = 10, seed: int = 0
) -> Validation:
    """Stratified random folds, as the source validates: every object is in training and test, which flatters new objects."""
    cv = StratifiedKFold(folds, shuffle=True, random_state=seed)
    return Validation(np.asarray(y), cross_val_predict(estimator, X, np.asarray(y), cv=cv), np.asarray(objects))


def learning_curve(
    estimator: BaseEstimator,
    X: Matrix,
    y: Sequence[str],
    objects: Sequence[object],
    sizes: Sequence[int],
    repeats: int = 10,
    seed: int = 0,
) -> list[tuple[int, float, float]]:
    """(objects trained on, mean, standard deviation of the balanced accuracy on all other objects) for each size."""
    rng = np.random.default_rng(seed)
    labels, names = np.asarray(y), np.asarray(objects)
    curve = []
    for size in sizes:
        scores = []
        for _ in range(repeats):
            train = np.isin(names, rng.choice(np.unique(names), size, replace=False))
            predicted = clone(estimator).fit(X[train], labels[train]).predict(X[~train])
            scores.append(balanced_accuracy(labels[~train], predicted))
        curve.append((size, float(np.mean(scores)), float(np.std(scores))))
    return curve


def proportion_interval(events: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Clopper–Pearson interval of a proportion: covers at least at its confidence, whatever the proportion.

    >>> low, high = proportion_interval(0, 3000)
    >>> low, round(high, 5)
    (0.0, 0.00123)
    """
    tail = (1 - confidence) / 2
    low = 0.0 if events == 0 else float(beta.ppf(tail, events, trials - events + 1))
    high = 1.0 if events == trials else float(beta.isf(tail, events + 1, trials - events))
    return low, high
