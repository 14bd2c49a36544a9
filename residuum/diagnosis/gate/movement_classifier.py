"""Which fault a movement shows: class probabilities, and `unknown` for what fits no class."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.model_selection import StratifiedGroupKFold
from sklearn.pipeline import Pipeline

from residuum.diagnosis.residuals.fault_isolation import HEALTHY, RayDistances, isolation_classifier
from residuum.identification.errors import NotIdentifiable

Matrix = npt.NDArray[np.float64]
_OUTSIDE = 1.5  # times the distance of the furthest held-out movement of a class is outside that class
_FOLDS = 5
_FEWEST = 3  # movements a class


@dataclass(frozen=True)
class Isolation:
    """How probable any fault is, and each class's probability and distance."""

    fault_probability: float
    probabilities: Mapping[str, float]
    distances: Mapping[str, float]
    fits_none: bool


@dataclass(frozen=True)
class MovementClassifier:
    """Logistic regression on log-features with an open set of classes.

    A movement fits none when it is half as far again from every class as the furthest held-out movement of that class;
    held out means of exemplars that were not trained, when `groups` name the exemplars.

    Attributes
    ----------
    pipeline : Pipeline
        Gives P(class | features).
    rays : RayDistances
    distance_limits : mapping of class to float
    """

    pipeline: Pipeline
    rays: RayDistances
    distance_limits: Mapping[str, float]

    @classmethod
    def fit(cls, X: Matrix, y: Sequence[str], groups: Sequence[object]) -> MovementClassifier:
        """Train on log-features X (n, n_features), classes y, and the exemplar (or any group) of each movement."""
        labels = np.asarray(y)
        _refuse_few(labels)
        folds = list(_folds(labels, groups).split(X, labels, groups))
        own = _held_out_distances(X, labels, folds)
        limits = {str(label): _OUTSIDE * float(np.max(own[labels == label])) for label in np.unique(labels)}
        return cls(isolation_classifier().fit(X, labels), RayDistances(origin=HEALTHY).fit(X, labels), limits)

    def isolate(self, x: Matrix) -> Isolation:
        """Isolate the fault in the log-features of one movement, shape (n_features,)."""
        classes = [str(label) for label in self.rays.classes_]
        distances = dict(zip(classes, map(float, self.rays.transform(x[None])[0]), strict=True))
        probabilities = dict(zip(classes, map(float, self.pipeline.predict_proba(x[None])[0]), strict=True))
        fits_none = all(distances[label] > limit for label, limit in self.distance_limits.items())
        return Isolation(1.0 - probabilities[HEALTHY], probabilities, distances, fits_none)


def _held_out_distances(X: Matrix, labels: npt.NDArray[Any], folds: Sequence[tuple[Matrix, Matrix]]) -> Matrix:
    """Distance of each movement to its own class when that class was learned without it, shape (n,)."""
    own = np.empty(len(labels))
    for train, test in folds:
        rays = RayDistances(origin=HEALTHY).fit(X[train], labels[train])
        own[test] = rays.transform(X[test])[np.arange(len(test)), np.searchsorted(rays.classes_, labels[test])]
    return own


def _refuse_few(labels: npt.NDArray[Any]) -> None:
    for label in sorted({HEALTHY, *map(str, labels)}):
        count = int(np.count_nonzero(labels == label))
        if count < _FEWEST:
            raise NotIdentifiable(f"class {label!r} has {count} movements to train on; at least {_FEWEST} are needed")


def _folds(labels: npt.NDArray[Any], groups: Sequence[object]) -> StratifiedGroupKFold:
    """As many folds as every class has groups, at most five."""
    counts = [len({group for group, label in zip(groups, labels, strict=True) if label == each}) for each in set(labels)]
    return StratifiedGroupKFold(max(2, min(_FOLDS, *counts)))
