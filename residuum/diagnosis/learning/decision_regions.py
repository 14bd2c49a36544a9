"""Which class a classifier of two features gives at each place of their plane (Fig. 87 of the source)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator

from residuum.identification.errors import BadInput

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


def decision_regions(classifier: BaseEstimator, points: npt.ArrayLike, resolution: int = 150) -> DecisionRegions:
    """Regions of a fitted classifier of two features, over the span of `points` and a margin of 5 %.

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
    >>> regions = decision_regions(SVC(kernel="linear").fit(points, ["left", "left", "right", "right"]), points)
    >>> regions.classes, round(regions.share("left"), 2)
    (('left', 'right'), 0.5)
    """
    held = np.asarray(points, dtype=float)
    if held.ndim != 2 or held.shape[1] != 2 or held.shape[0] == 0:
        raise BadInput(f"decision regions, points: have shape {held.shape}; must be (n, 2), n at least 1")
    if resolution < 2:
        raise BadInput(f"decision regions, resolution: is {resolution}; must be at least 2")
    low, high = held.min(axis=0), held.max(axis=0)
    margin = _MARGIN * (high - low)
    x, y = (np.linspace(low[k] - margin[k], high[k] + margin[k], resolution) for k in (0, 1))
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    classes = tuple(str(label) for label in classifier.classes_)
    said = np.asarray(classifier.predict(grid.reshape(-1, 2)))
    return DecisionRegions(x, y, classes, np.searchsorted(np.asarray(classifier.classes_), said).reshape(grid.shape[:2]))
