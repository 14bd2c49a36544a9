"""From features to a class: the source's linear support vector machine, a better classifier, and `unknown`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.covariance import LedoitWolf
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data

Matrix = npt.NDArray[np.float64]
HEALTHY, PINION_OR_GEAR, RACK, UNKNOWN = "healthy", "pinion-or-gear", "rack", "unknown"


def source_classifier() -> Pipeline:
    """The reference: F₁ and F₂ scaled, then a linear support vector machine (Valceschini, section 7.5.2, decision logic)."""
    return make_pipeline(StandardScaler(), SVC(kernel="linear"))


def isolation_classifier(C: float = 10.0) -> Pipeline:
    """Multinomial logistic regression on scaled log-features: linear, so it extrapolates to faults larger than trained.

    Its probabilities come true on exemplars that were not trained as long as the faults are of the sizes that were trained: the
    expected calibration error is about 0.02 then, and neither temperature nor sigmoid scaling lowers it. A classifier that was
    shown gross faults alone calls small ones healthy, and is wrong to (benchmarks/results/gate_actuator.md).
    """
    return make_pipeline(StandardScaler(), LogisticRegression(C=C, max_iter=2000))


class RayDistances(TransformerMixin, BaseEstimator):
    r"""Distance of a point to each class, where a class is a ray from the origin class through the class's mean.

    .. math:: d_c(x) = \min_{t \ge 0} \lVert x - \mu_0 - t(\mu_c - \mu_0) \rVert_{\Sigma^{-1}}

    μ₀ is the mean of the origin class, Σ the pooled covariance within classes, shrunk after Ledoit and Wolf
    (2004); the origin's own distance has t = 0. A larger fault of a known kind goes further along its ray and stays near
    it; what is far from every ray fits no known kind. Fails when a class's features do not move along a line with the
    size of the fault.

    Parameters
    ----------
    origin : label or None
        The class that the rays start from; None takes the first class in sorted order.

    Attributes
    ----------
    classes_ : array, shape (n_classes,)
    means_ : array, shape (n_classes, n_features)
    precision_ : array, shape (n_features, n_features)
        Σ⁻¹.
    """

    def __init__(self, origin: object = None) -> None:
        self.origin = origin

    @classmethod
    def of(cls, classes: npt.NDArray[np.str_], means: Matrix, precision: Matrix, origin: object) -> RayDistances:
        """A fitted one from what `fit` learned (for files)."""
        rays = cls(origin)
        rays.classes_, rays.means_, rays.precision_ = classes, means, precision
        rays.n_features_in_ = means.shape[1]
        return rays

    def fit(self, X: npt.ArrayLike, y: npt.ArrayLike) -> RayDistances:
        """Learn means and pooled covariance; X (n, n_features), y (n,)."""
        points, labels = validate_data(self, X, y, dtype=np.float64)
        check_classification_targets(labels)
        self.classes_, index = np.unique(labels, return_inverse=True)
        if self.origin is not None and self.origin not in self.classes_:
            raise ValueError(f"RayDistances, origin {self.origin!r}: is none of the classes {list(self.classes_)}")
        self.means_ = np.array([points[index == k].mean(axis=0) for k in range(self.classes_.shape[0])])
        within = points - self.means_[index]
        self.precision_ = np.linalg.pinv(LedoitWolf(assume_centered=True).fit(within).covariance_, hermitian=True)
        return self

    def transform(self, X: npt.ArrayLike) -> Matrix:
        """Distances, shape (n, n_classes), in the order of `classes_`."""
        check_is_fitted(self)
        points = validate_data(self, X, reset=False, dtype=np.float64)
        origin = 0 if self.origin is None else int(np.flatnonzero(self.classes_ == self.origin)[0])
        from_origin = points - self.means_[origin]
        return np.column_stack([self._to_ray(from_origin, mean - self.means_[origin]) for mean in self.means_])

    def get_feature_names_out(self, input_features: object = None) -> npt.NDArray[np.object_]:
        """One name a class."""
        check_is_fitted(self)
        return np.array([f"distance_{label}" for label in self.classes_], dtype=object)

    def _to_ray(self, from_origin: Matrix, ray: Matrix) -> Matrix:
        length = float(ray @ self.precision_ @ ray)
        t = np.maximum(from_origin @ self.precision_ @ ray / length, 0.0) if length > 0 else np.zeros(from_origin.shape[0])
        off = from_origin - t[:, None] * ray
        return np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", off, self.precision_, off), 0.0))
