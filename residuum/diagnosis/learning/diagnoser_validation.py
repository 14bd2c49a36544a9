"""How well a kind of diagnoser does on objects not trained on: object-wise cross-validation and the
.632+ bootstrap.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import beta
from sklearn.base import BaseEstimator, clone
from sklearn.model_selection import LeaveOneGroupOut, StratifiedKFold, cross_val_predict

from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.validation import weighed
from residuum.identification.record import Record

# How well a classifier does on an object it has never seen: object-wise cross-validation beside the
# usual folds.

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
        """Share of right predictions; 1 − OCV of (A.7) with the 0–1 loss, when the predictions are
        object-wise.
        """
        return float(np.mean(self.truth == self.predicted))

    @property
    def balanced_accuracy(self) -> float:
        """Mean over the true classes of the share that was found."""
        return balanced_accuracy(self.truth, self.predicted)

    def confusion(self, labels: Sequence[str]) -> npt.NDArray[np.int_]:
        """Counts, rows predicted and columns true (as the source's Table 7), in the order of
        `labels`.
        """
        rows = [
            [int(np.sum((self.predicted == predicted) & (self.truth == true))) for true in labels]
            for predicted in labels
        ]
        return np.asarray(rows, dtype=int)

    def interval(
        self,
        score: Callable[[Labels, Labels], float],
        confidence: float = 0.95,
        repeats: int = 1000,
        seed: int = 0,
    ) -> tuple[float, float]:
        """Interval of `score(truth, predicted)` by drawing whole objects with replacement.

        Movements of one object resemble each other, so drawing them one by one would promise too
        much. Fails (too narrow) for fewer than about ten objects.
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
    """Mean over the true classes of the share that was found; predictions may hold classes that the
    truth has not (`unknown`).
    """
    return float(
        np.mean([np.mean(predicted[truth == label] == label) for label in np.unique(truth)])
    )


def object_wise(
    estimator: BaseEstimator, X: Matrix, y: Sequence[str], objects: Sequence[object]
) -> Validation:
    """Object-wise cross-validation (A.7): each object is predicted by an estimator trained on all
    others.

    Raises BadInput with fewer than two objects.
    """
    names = np.asarray(objects)
    if np.unique(names).shape[0] < 2:
        raise BadInput(
            "object-wise validation: all observations come from one object; at least two are needed"
        )
    predicted = cross_val_predict(estimator, X, np.asarray(y), groups=names, cv=LeaveOneGroupOut())
    return Validation(np.asarray(y), predicted, names)


def mixed_folds(
    estimator: BaseEstimator,
    X: Matrix,
    y: Sequence[str],
    objects: Sequence[object],
    folds: int = 10,
    seed: int = 0,
) -> Validation:
    """Stratified random folds, as the source validates: every object is in training and test, which
    flatters new objects.
    """
    cv = StratifiedKFold(folds, shuffle=True, random_state=seed)
    return Validation(
        np.asarray(y), cross_val_predict(estimator, X, np.asarray(y), cv=cv), np.asarray(objects)
    )


def learning_curve(
    estimator: BaseEstimator,
    X: Matrix,
    y: Sequence[str],
    objects: Sequence[object],
    sizes: Sequence[int],
    repeats: int = 10,
    seed: int = 0,
) -> list[tuple[int, float, float]]:
    """(objects trained on, mean, standard deviation of the balanced accuracy on all other objects)
    for each size.
    """
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
    """Clopper–Pearson interval of a proportion: covers at least at its confidence, whatever the
    proportion.

    >>> low, high = proportion_interval(0, 3000)
    >>> low, round(high, 5)
    (0.0, 0.00123)
    """
    tail = (1 - confidence) / 2
    low = 0.0 if events == 0 else float(beta.ppf(tail, events, trials - events + 1))
    high = 1.0 if events == trials else float(beta.isf(tail, events + 1, trials - events))
    return low, high


Fit = Callable[[Sequence[int]], Diagnoser]
"""Trains a fresh diagnoser on the records of these numbers."""


def validate_object_wise(
    fit: Fit, records: Sequence[Record], labels: Sequence[str], objects: Sequence[str]
) -> Validation:
    """Object-wise cross-validation (A.7) of any diagnoser: each object's records are judged by one
    trained on all others.

    Raises BadInput with fewer than two objects, and what training raises.
    """
    names = np.asarray(objects)
    if len(np.unique(names)) < 2:
        raise BadInput("validation: all records come from one object; at least two are needed")
    predicted = np.empty(len(records), dtype=object)
    for name in np.unique(names):
        judge = fit([int(k) for k in np.flatnonzero(names != name)])
        for k in map(int, np.flatnonzero(names == name)):
            predicted[k] = judged_class(judge, records[k])
    return Validation(np.asarray(labels), predicted.astype(str), names)


@dataclass(frozen=True)
class Bootstrap:
    """The .632+ estimate of the error on new objects, and what it is made of; all are shares of
    records.

    Attributes
    ----------
    error : float
        (1 − w) apparent + w out_of_bag, w = .632/(1 − .368 R).
    apparent, out_of_bag : float
        Error on the records trained on, and on objects that a bootstrap sample lacks.
    no_information : float
        γ, the error if records and labels had nothing to do with each other.
    overfitting : float
        R = (out_of_bag − apparent)/(γ − apparent), between 0 and 1.
    samples : int
        Bootstrap samples that could be trained on.
    """

    error: float
    apparent: float
    out_of_bag: float
    no_information: float
    overfitting: float
    samples: int


def bootstrap_632_plus(
    fit: Fit,
    records: Sequence[Record],
    labels: Sequence[str],
    objects: Sequence[str],
    repeats: int = 25,
    seed: int = 0,
) -> Bootstrap:
    """Efron and Tibshirani, J. Amer. Stat. Assoc. 92 (1997) 548–560, whole objects drawn instead of
    records; A.2 of the source.

    A sample that lacks what training needs (a class, enough records) is left out.

    Raises BadInput with fewer than two objects, or where no sample can be trained on.
    """
    truth, names = np.asarray(labels), np.asarray(objects)
    if len(np.unique(names)) < 2:
        raise BadInput("bootstrap: all records come from one object; at least two are needed")
    judge = fit(range(len(records)))
    own = np.array([judged_class(judge, record) for record in records])
    wrong: list[list[bool]] = [[] for _ in records]
    trained = 0
    for drawn, left in _drawn_objects(names, repeats, seed):
        try:
            judge = fit(drawn)
        except BadInput:
            continue
        trained += 1
        for k in left:
            wrong[k].append(judged_class(judge, records[k]) != truth[k])
    # a record counts once, however many samples lack its object
    counted = [float(np.mean(misses)) for misses in wrong if misses]
    if not counted:
        raise BadInput(
            "bootstrap: no sample of objects could be trained on; more objects of every class are"
            " needed"
        )
    return _combined(truth, own, float(np.mean(counted)), trained)


def _drawn_objects(
    names: npt.NDArray[Any], repeats: int, seed: int
) -> Iterator[tuple[list[int], list[int]]]:
    """Records of objects drawn with replacement, and those of the objects that the draw lacks;
    draws that lack none are left out.
    """
    rng = np.random.default_rng(seed)
    every = np.unique(names)
    for _ in range(repeats):
        objects = rng.choice(every, len(every))
        drawn = [int(k) for name in objects for k in np.flatnonzero(names == name)]
        left = [int(k) for k in np.flatnonzero(~np.isin(names, objects))]
        if left:
            yield drawn, left


def judged_class(judge: Diagnoser, record: Record) -> str:
    """The class that a diagnoser gives a record: `healthy`, the fault's, or the verdict where there
    is no class.
    """
    finding = judge.score(record)
    return finding.fault_class or str(finding.verdict.value)


def _combined(
    truth: Labels, own: npt.NDArray[np.str_], out_of_bag: float, trained: int
) -> Bootstrap:
    apparent = float(np.mean(own != truth))
    classes = np.unique(np.concatenate([truth, own]))
    shares = [(float(np.mean(truth == name)), float(np.mean(own == name))) for name in classes]
    no_information = sum(p * (1.0 - q) for p, q in shares)
    error, overfitting = weighed(apparent, out_of_bag, no_information)
    return Bootstrap(error, apparent, out_of_bag, no_information, overfitting, trained)
