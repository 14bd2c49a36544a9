"""Which class the gate actuator's trained classifiers give at each place of a plane of two features
(Fig. 87 of the source).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator

from residuum.diagnosis.gate.gate_baseline import GateBaseline
from residuum.diagnosis.gate.movement_features import FEATURES, SOURCE_FEATURES
from residuum.identification.errors import BadInput

# Which class a classifier of two features gives at each place of their plane (Fig. 87 of the
# source).

Matrix = npt.NDArray[np.float64]
_MARGIN = 0.05  # of the span, beyond the outermost point


@dataclass(frozen=True, eq=False)
class DecisionRegions:
    """The plane on an even grid.

    Attributes
    ----------
    x, y : arrays, shape (resolution,)
        First and second feature, in their own unit.
    classes : tuple of str
    region : array of int, shape (resolution, resolution)
        Index into `classes`; rows go along y, columns along x.
    """

    x: Matrix
    y: Matrix
    classes: tuple[str, ...]
    region: npt.NDArray[np.int_]

    def share(self, label: str) -> float:
        """Part of the shown plane that belongs to a class."""
        return float(np.mean(self.region == self.classes.index(label)))


def decision_regions(
    classifier: BaseEstimator, points: npt.ArrayLike, resolution: int = 150
) -> DecisionRegions:
    """Regions of a fitted classifier of two features, over the span of `points` and a margin of 5
    %.

    Parameters
    ----------
    classifier : scikit-learn classifier or pipeline, fitted on two features
    points : array, shape (n, 2)
        Feature pairs that the plane is to hold.
    resolution : int
        Grid points along each axis.

    Raises
    ------
    BadInput
        `points` has another shape, or the resolution is below 2.

    >>> from sklearn.svm import SVC
    >>> points = np.array([[0.0, 0.0], [0.1, 1.0], [1.0, 0.0], [0.9, 1.0]])
    >>> classifier = SVC(kernel="linear").fit(points, ["left", "left", "right", "right"])
    >>> regions = decision_regions(classifier, points)
    >>> regions.classes, round(regions.share("left"), 2)
    (('left', 'right'), 0.5)
    """
    held = np.asarray(points, dtype=float)
    if held.ndim != 2 or held.shape[1] != 2 or held.shape[0] == 0:
        raise BadInput(
            f"decision regions, points: have shape {held.shape}; must be (n, 2), n at least 1"
        )
    if resolution < 2:
        raise BadInput(f"decision regions, resolution: is {resolution}; must be at least 2")
    low, high = held.min(axis=0), held.max(axis=0)
    margin = _MARGIN * (high - low)
    x, y = (np.linspace(low[k] - margin[k], high[k] + margin[k], resolution) for k in (0, 1))
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    classes = tuple(str(label) for label in classifier.classes_)
    predicted = np.asarray(classifier.predict(grid.reshape(-1, 2)))
    return DecisionRegions(
        x,
        y,
        classes,
        np.searchsorted(np.asarray(classifier.classes_), predicted).reshape(grid.shape[:2]),
    )


_LEAST = 1e-12  # features are positive; the margin of a plane may reach beyond


def plane_features(baseline: GateBaseline) -> tuple[str, ...]:
    """The features that planes can be made of; none when only healthy movements were trained."""
    return () if baseline.classifier is None else FEATURES


def classifier_plane(
    baseline: GateBaseline,
    features: Mapping[str, float],
    x: str,
    y: str,
    points: npt.ArrayLike,
    resolution: int = 80,
) -> DecisionRegions:
    """Regions in the plane of features x and y.

    In the plane of F₁ and F₂ these are the regions of the source's support vector machine, which
    knows no other features. Any other plane is a cut through the regions of the classifier of all
    features: the other features stay as they are `features`.

    Parameters
    ----------
    baseline : GateBaseline
        Trained with faults.
    features : mapping of feature to value
        Of one movement.
    x, y : str
        Two of FEATURES.
    points : array, shape (n, 2)
        Feature pairs that the plane is to hold.

    Raises
    ------
    BadInput
        Unknown or equal features, a feature that `features` lacks, a baseline of healthy movements
        alone.
    """
    known = plane_features(baseline)
    if baseline.classifier is None or baseline.source is None:
        raise BadInput(
            "gate-actuator: was trained on healthy movements alone, so there are no regions"
        )
    if x not in known or y not in known or x == y:
        raise BadInput(
            f"gate-actuator, plane of {x[:40]!r} and {y[:40]!r}: needs two of {', '.join(known)}"
        )
    if {x, y} == set(SOURCE_FEATURES):
        return decision_regions(
            _Turned(baseline.source, x != SOURCE_FEATURES[0]), points, resolution
        )
    if missing := [name for name in known if not features.get(name, np.nan) > 0]:
        raise BadInput(f"gate-actuator, plane: the movement has no positive {missing[0]}")
    return decision_regions(_Cut(baseline.classifier.pipeline, features, x, y), points, resolution)


class _Turned(BaseEstimator):
    """The source's classifier of (F₁, F₂), asked with (F₂, F₁) when `turned`."""

    def __init__(self, classifier: BaseEstimator, turned: bool) -> None:
        self.classifier, self.turned = classifier, turned
        self.classes_ = classifier.classes_

    def predict(self, points: Matrix) -> npt.NDArray[np.str_]:
        return np.asarray(self.classifier.predict(points[:, ::-1] if self.turned else points))


class _Cut(BaseEstimator):
    """A classifier of all log-features as one of two features, the others held."""

    def __init__(
        self, classifier: BaseEstimator, fixed: Mapping[str, float], x: str, y: str
    ) -> None:
        self.classifier, self.fixed, self.x, self.y = classifier, fixed, x, y
        self.classes_ = classifier.classes_

    def predict(self, points: Matrix) -> npt.NDArray[np.str_]:
        features = np.tile([self.fixed[name] for name in FEATURES], (len(points), 1))
        features[:, [FEATURES.index(self.x), FEATURES.index(self.y)]] = points
        return np.asarray(self.classifier.predict(np.log(np.maximum(features, _LEAST))))
