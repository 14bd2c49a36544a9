"""From features to a class: the source's linear support vector machine, a better classifier, and
`unknown`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import linalg, stats
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.covariance import LedoitWolf
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.generators.residual_generator import ResidualGenerator

# How each kind of fault shows in the primary residual M y − N u, per unit of its size.


@dataclass(frozen=True, eq=False)
class FaultContext:
    """What a signature is computed from: the generator and the record's input as deviation from the
    operating point.
    """

    generator: ResidualGenerator
    u: FloatArray

    def path(self, y: FloatArray, u: FloatArray) -> FloatArray:
        """M y − N u from rest."""
        generator = self.generator
        if generator.taps is not None:
            return y - np.convolve(u, generator.taps)[: len(u)] if np.any(u) else y
        if generator.observer is None:
            return y
        return generator.observer.simulate(np.column_stack([y, u]))[0][:, 0]

    def after(self, onset: int) -> FloatArray:
        """1 from sample `onset` on, 0 before."""
        return (np.arange(len(self.u)) >= onset).astype(float)


@dataclass(frozen=True)
class FaultKind:
    """One kind of fault.

    `signature(context, onset)` is the change of the primary residual for size 1, shape (n,). `per`
    says what the size is counted in: `output`, `input`, `output/s` or `` (a fraction). `shape` is
    that of the size over time: a step or a ramp.
    """

    meaning: str
    per: str
    signature: Callable[[FaultContext, int], FloatArray]
    shape: str = "step"


def _sensor_offset(context: FaultContext, onset: int) -> FloatArray:
    return context.path(context.after(onset), np.zeros_like(context.u))


def _sensor_drift(context: FaultContext, onset: int) -> FloatArray:
    elapsed = np.maximum(np.arange(len(context.u)) - onset + 1, 0) * context.generator.sample_time
    return context.path(elapsed, np.zeros_like(context.u))


def _sensor_gain(context: FaultContext, onset: int) -> FloatArray:
    """The healthy output is N u here (M = 1); an unstable plant's own output is not known, so its
    nominal one is taken.
    """
    healthy = -context.path(np.zeros_like(context.u), context.u) + context.generator.output_mean
    return context.path(healthy * context.after(onset), np.zeros_like(context.u))


def _actuator_gain(context: FaultContext, onset: int) -> FloatArray:
    applied = (context.u + context.generator.input_mean) * context.after(onset)
    return context.path(np.zeros_like(context.u), applied)


def _actuator_offset(context: FaultContext, onset: int) -> FloatArray:
    return -context.path(np.zeros_like(context.u), context.after(onset))


# The commoner kind first: where the data cannot tell two apart, the first is named and the other
# mentioned.
FAULT_KINDS: dict[str, FaultKind] = {
    "sensor-offset": FaultKind("y reads this much too high", "output", _sensor_offset),
    "actuator-gain": FaultKind("this fraction of the input's effect is lost", "", _actuator_gain),
    "sensor-drift": FaultKind(
        "y runs away at this rate from the onset on", "output/s", _sensor_drift, "ramp"
    ),
    "sensor-gain": FaultKind("y is multiplied by 1 + this", "", _sensor_gain),
    "actuator-offset": FaultKind(
        "the plant gets this much more input than is recorded", "input", _actuator_offset
    ),
}


# Fault estimation and identification: which kind of fault, since when, how large, with its band.

STUCK, PLANT_CHANGE = "stuck-sensor", "plant-change"
_INDISTINCT = 3.0  # log likelihood units within which two kinds are not told apart
_ONSETS = 24
_SCALE_SLACK = 1.1  # σ was itself estimated
_GUARD = 12.0  # squared standard deviations of signature that the onset's own uncertainty may span


@dataclass(frozen=True)
class FaultEstimate:
    """One kind of fault fitted to the residual.

    Parameters
    ----------
    kind : str
        Key of `FAULT_KINDS`, `stuck-sensor` or `plant-change`.
    value, std : float
        Size and its standard deviation, in `unit`; the model's own uncertainty is part of `std`.
    unit : str
    onset : int
        Sample at which the fault began.
    log_likelihood_ratio : float
        log p(residual | this fault) − log p(residual | healthy).
    indistinguishable_from : tuple of str
        Kinds that explain the residual as well, within 3 units of log likelihood; of these, `kind`
        is the one that stands first in `FAULT_KINDS`, the commoner one.
    adequate : bool
        Whether what the fault leaves over is as small as a healthy residual (χ² at 10⁻⁴).
    """

    kind: str
    value: float
    std: float
    unit: str
    onset: int
    log_likelihood_ratio: float
    indistinguishable_from: tuple[str, ...] = ()
    adequate: bool = True

    @property
    def shape(self) -> str:
        """How the size goes over time: `step`, `ramp`, or what the kind's own name says
        (`stuck-sensor`, `plant-change`).
        """
        return FAULT_KINDS[self.kind].shape if self.kind in FAULT_KINDS else self.kind

    def moved(self, samples: int) -> FaultEstimate:
        """The same with its onset counted from `samples` earlier."""
        return replace(self, onset=self.onset + samples)

    def band(self, probability: float = 0.95) -> tuple[float, float]:
        """Interval that holds the size with `probability`."""
        half = float(stats.norm.ppf(0.5 + probability / 2)) * self.std
        return self.value - half, self.value + half


class FaultEstimator:
    """Fits every fault kind to the residual of one stretch of data without gap.

    The whitened residual is Φ δ + f s(t; onset) + ε, with the model error δ ~ N(0, Σ_g) and Φ the
    whitened input at the model's lags, and a constant of variance 1/n beside them for the operating
    point taken from n healthy samples, so its covariance is C = I + Φ Σ_g Φᵀ (Σ_g with that
    variance as its last entry). For each kind and onset the size is the generalised least-squares
    f̂ = sᵀ C⁻¹ r/sᵀ C⁻¹ s, the log likelihood ratio ½ (sᵀ C⁻¹ r)²/sᵀ C⁻¹ s (Basseville and
    Nikiforov, Detection of Abrupt Changes, 1993, ch. 7), and the onset is the one of the largest
    ratio. A stuck sensor is one whose reading does not move at all. When no kind leaves a residual
    as small as a healthy one, the plant itself has changed.

    It fails for two faults at once, and cannot tell apart kinds that the input of this stretch
    makes look the same; these it names. The size is estimated on samples after the onset's own
    uncertainty, which would bias it.

    Parameters
    ----------
    generator : ResidualGenerator
    covariance, delay : array of shape (m, m), int
        Of the identified impulse response.
    units : tuple of str
        Of input and output.
    """

    def __init__(
        self,
        generator: ResidualGenerator,
        covariance: FloatArray,
        delay: int,
        units: tuple[str, str] = ("", ""),
    ) -> None:
        self.generator = generator
        self.covariance = covariance
        self.delay = delay
        eigenvalues, vectors = np.linalg.eigh(covariance)
        large = eigenvalues > eigenvalues[-1] * 1e-9 if eigenvalues[-1] > 0 else eigenvalues > 0
        self.root: FloatArray = vectors[:, large] * np.sqrt(eigenvalues[large])
        self.units = {
            "output": units[1],
            "input": units[0],
            "output/s": f"({units[1]})/s" if units[1] else "1/s",
            "": "",
        }

    def estimate(self, u: npt.ArrayLike, y: npt.ArrayLike, alarm: int) -> FaultEstimate | None:
        """The fault that best explains u, y (shape (n,), no gap), begun before sample `alarm`.

        An onset of 0 or less means that the fault was there before the stretch began. None when the
        stretch is shorter than the generator's memory.
        """
        u, y = np.asarray(u, dtype=float), np.asarray(y, dtype=float)
        first = self.generator.warm_up
        if len(u) <= first + 1 or alarm < first:
            return None
        fit = _Fit(self, u, y)
        if (stuck := self._stuck(fit, y, alarm)) is not None:
            return stuck
        fits = [fit.best(kind, alarm) for kind in FAULT_KINDS]
        largest = max(item.log_likelihood_ratio for item in fits)
        best, *rivals = [
            item for item in fits if item.log_likelihood_ratio >= largest - _INDISTINCT
        ]
        alike = tuple(item.kind for item in rivals)
        adequate, left = fit.leaves_healthy(best)
        if not adequate and left > 0.5:
            return FaultEstimate(
                PLANT_CHANGE, left, 0.0, "", best.onset, best.log_likelihood_ratio, (), False
            )
        return FaultEstimate(
            best.kind,
            best.value,
            best.std,
            best.unit,
            best.onset,
            best.log_likelihood_ratio,
            alike,
            adequate,
        )

    def _stuck(self, fit: _Fit, y: FloatArray, alarm: int) -> FaultEstimate | None:
        """A reading that repeats itself exactly up to the alarm, and longer than chance and
        quantisation allow.
        """
        still = np.flatnonzero(np.diff(y[: alarm + 1]) != 0.0)
        onset = int(still[-1]) + 1 if len(still) else 0
        end = alarm + 1
        while end < len(y) and y[end] == y[end - 1]:
            end += 1
        longest = _longest_repeat(y[:onset]) if onset else 1
        if end - onset < max(8, 4 * longest):
            return None
        energy = float(np.sum(fit.white[max(onset, fit.first) : end] ** 2))
        return FaultEstimate(STUCK, float(y[onset]), 0.0, self.units["output"], onset, energy / 2)


class _Fit:
    """The whitened residual of one stretch, and the generalised least-squares fit of one kind at
    one onset.
    """

    def __init__(self, estimator: FaultEstimator, u: FloatArray, y: FloatArray) -> None:
        generator = estimator.generator
        self.estimator, self.first = estimator, generator.warm_up
        du = u - generator.input_mean
        self.context = FaultContext(generator, du)
        self.ar = generator.noise.ar / generator.noise.innovation_std
        primary = self.context.path(y - generator.output_mean, du)
        primary[: self.first - len(self.ar) + 1] = 0.0
        self.white = self._whiten(primary)
        self.white[: self.first] = 0.0
        m, delay = len(estimator.covariance), estimator.delay
        self._padded = np.concatenate([np.zeros(m - 1 + delay), self._whiten(du)])[: len(u) + m - 1]
        self._shrink = self._shrinkage()
        self._error = self._on_lags(self.white)
        self.energy = float(self.white @ self.white - self._error @ self._shrink @ self._error)

    def _whiten(self, x: FloatArray) -> FloatArray:
        return np.convolve(x, self.ar)[: len(x)]

    def _shrinkage(self) -> FloatArray:
        """K of (I + Φ Σ_g Φᵀ)⁻¹ = I − Φ K Φᵀ: K = B (I + Bᵀ Φᵀ Φ B)⁻¹ Bᵀ with Σ_g = B Bᵀ
        (Woodbury).
        """
        phi = np.lib.stride_tricks.sliding_window_view(
            self._padded, len(self.estimator.covariance)
        )[self.first :, ::-1]
        B = linalg.block_diag(
            self.estimator.root, np.sqrt(1.0 / self.estimator.generator.noise.samples)
        )
        scaled = np.column_stack([phi @ self.estimator.root, np.full(len(phi), B[-1, -1])])
        return np.asarray(B @ np.linalg.solve(np.eye(B.shape[1]) + scaled.T @ scaled, B.T))

    def _on_lags(self, s: FloatArray) -> FloatArray:
        """Φᵀ s: the part of a signal that an error of the impulse response, or of the operating
        point, could explain.
        """
        start = int(np.argmax(s != 0.0))
        m = len(self.estimator.covariance)
        lags = np.correlate(self._padded[start : len(s) + m - 1], s[start:], "valid")[::-1]
        return np.append(lags, np.sum(s))

    def fit(self, columns: list[FloatArray]) -> tuple[FloatArray, FloatArray, float]:
        """Sizes, their covariance and the log likelihood ratio of signatures X: f̂ = (Xᵀ C⁻¹ X)⁻¹
        Xᵀ C⁻¹ ε.
        """
        X = np.column_stack(columns)
        W = np.column_stack([self._on_lags(column) for column in columns])
        information = X.T @ X - W.T @ self._shrink @ W
        score = X.T @ self.white - W.T @ self._shrink @ self._error
        if np.linalg.matrix_rank(information) < len(columns):
            return np.zeros(len(columns)), np.full((len(columns), len(columns)), np.inf), 0.0
        covariance: FloatArray = np.linalg.inv(information).astype(float)
        sizes = covariance @ score
        return sizes, covariance, float(score @ sizes) / 2.0

    def signature(self, kind: str, onset: int) -> FloatArray:
        """Whitened signature, zero where the residual is not judged."""
        s = self._whiten(FAULT_KINDS[kind].signature(self.context, onset))
        s[: self.first] = 0.0
        return s

    def columns(self, kind: str, onset: int) -> list[FloatArray]:
        """The signature; with a constant when it is a drift that had run on for an unknown time
        before the stretch.
        """
        first = [self.signature(kind, onset)]
        return (
            [*first, self.signature("sensor-offset", 0)]
            if kind == "sensor-drift" and onset < self.first
            else first
        )

    def ratio(self, kind: str, onset: int) -> float:
        """Log likelihood ratio, less the price of a second parameter."""
        columns = self.columns(kind, onset)
        return self.fit(columns)[2] - 0.5 * (len(columns) - 1) * float(np.log(len(self.white)))

    def best(self, kind: str, alarm: int) -> FaultEstimate:
        """Onset of the largest ratio (coarse grid, then finer between its neighbours), and the size
        there.
        """
        candidates = self._onsets(alarm)
        onset, ratio = int(candidates[0]), -1.0
        for _ in range(12):
            values = [self.ratio(kind, int(candidate)) for candidate in candidates]
            k = int(np.argmax(values))
            onset, ratio = int(candidates[k]), values[k]
            low, high = (
                int(candidates[max(k - 1, 0)]),
                int(candidates[min(k + 1, len(candidates) - 1)]),
            )
            if high - low <= 2 or onset == 0:
                break
            candidates = np.unique(np.linspace(max(low, self.first), high, 9).round().astype(int))
        value, std = self._size(kind, onset)
        return FaultEstimate(
            kind, value, std, self.estimator.units[FAULT_KINDS[kind].per], onset, ratio
        )

    def _onsets(self, alarm: int) -> npt.NDArray[np.int64]:
        """Coarse grid; 0 stands for a fault that was there before the stretch."""
        inside = np.linspace(self.first, alarm, _ONSETS)
        near = alarm - np.geomspace(1, max(alarm - self.first, 1), _ONSETS)
        grid = np.unique(np.concatenate([[0.0], inside, near]).round().astype(np.int64))
        return grid[(grid == 0) | (grid >= self.first)]

    def _size(self, kind: str, onset: int) -> tuple[float, float]:
        """Size from a little after the onset on: the samples that placed the onset would flatter
        it.
        """
        columns = self.columns(kind, onset)
        rough = float(self.fit(columns)[0][0])
        strength = np.cumsum((rough * columns[0]) ** 2)
        if kind == "sensor-drift" and onset >= self.first:
            # The slope is as uncertain as the onset makes it: only what no constant since the onset
            # explains counts.
            columns.append(self.signature("sensor-offset", onset))
        if onset >= self.first and strength[-1] > 2 * _GUARD:
            guard = int(np.argmax(strength > _GUARD))
            columns = [np.where(np.arange(len(s)) >= guard, s, 0.0) for s in columns]
            saved = self.white[onset:guard].copy()
            self.white[onset:guard] = 0.0
            error, self._error = self._error, self._on_lags(self.white)
            sizes, covariance, _ = self.fit(columns)
            self.white[onset:guard], self._error = saved, error
        else:
            sizes, covariance, _ = self.fit(columns)
        return float(sizes[0]), float(np.sqrt(covariance[0, 0]))

    def leaves_healthy(self, estimate: FaultEstimate) -> tuple[bool, float]:
        """Whether what the fault leaves over is as small as a healthy residual, and its share when
        it is not.
        """
        n = len(self.white) - self.first
        left = self.energy - 2.0 * self.fit(self.columns(estimate.kind, estimate.onset))[2]
        return left <= _SCALE_SLACK * float(stats.chi2.isf(1e-4, n)), (left - n) / max(
            self.energy - n, 1e-12
        )


def _longest_repeat(y: FloatArray) -> int:
    """Length of the longest run of equal readings."""
    changes = np.flatnonzero(np.diff(y) != 0.0)
    return int(np.max(np.diff(np.concatenate([[-1], changes, [len(y) - 1]]))))


Matrix = npt.NDArray[np.float64]
HEALTHY, PINION_OR_GEAR, RACK, UNKNOWN = "healthy", "pinion-or-gear", "rack", "unknown"


def source_classifier() -> Pipeline:
    """The reference: F₁ and F₂ scaled, then a linear support vector machine (Valceschini, section
    7.5.2, decision logic).
    """
    return make_pipeline(StandardScaler(), SVC(kernel="linear"))


def isolation_classifier(C: float = 10.0) -> Pipeline:
    """Multinomial logistic regression on scaled log-features: linear, so it extrapolates to faults
    larger than trained.

    Its probabilities come true on exemplars that were not trained as long as the faults are of the
    sizes that were trained: the expected calibration error is about 0.02 then, and neither
    temperature nor sigmoid scaling lowers it. A classifier that was shown gross faults alone calls
    small ones healthy, and is wrong to (benchmarks/results/gate_actuator.md).
    """
    return make_pipeline(StandardScaler(), LogisticRegression(C=C, max_iter=2000))


class RayDistances(TransformerMixin, BaseEstimator):
    r"""Distance of a point to each class, where a class is a ray from the origin class through the
    class's mean.

    .. math:: d_c(x) = \min_{t \ge 0} \lVert x - \mu_0 - t(\mu_c - \mu_0) \rVert_{\Sigma^{-1}}

    μ₀ is the mean of the origin class, Σ the pooled covariance within classes, shrunk after Ledoit
    and Wolf (2004); the origin's own distance has t = 0. A larger fault of a known kind goes
    further along its ray and stays near it; what is far from every ray fits no known kind. Fails
    when a class's features do not move along a line with the size of the fault.

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
    def of(
        cls, classes: npt.NDArray[np.str_], means: Matrix, precision: Matrix, origin: object
    ) -> RayDistances:
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
            raise ValueError(
                f"RayDistances, origin {self.origin!r}: is none of the classes"
                f" {list(self.classes_)}"
            )
        self.means_ = np.array(
            [points[index == k].mean(axis=0) for k in range(self.classes_.shape[0])]
        )
        within = points - self.means_[index]
        self.precision_ = np.linalg.pinv(
            LedoitWolf(assume_centered=True).fit(within).covariance_, hermitian=True
        )
        return self

    def transform(self, X: npt.ArrayLike) -> Matrix:
        """Distances, shape (n, n_classes), in the order of `classes_`."""
        check_is_fitted(self)
        points = validate_data(self, X, reset=False, dtype=np.float64)
        origin = 0 if self.origin is None else int(np.flatnonzero(self.classes_ == self.origin)[0])
        from_origin = points - self.means_[origin]
        return np.column_stack(
            [self._to_ray(from_origin, mean - self.means_[origin]) for mean in self.means_]
        )

    def get_feature_names_out(self, input_features: object = None) -> npt.NDArray[np.object_]:
        """One name a class."""
        check_is_fitted(self)
        return np.array([f"distance_{label}" for label in self.classes_], dtype=object)

    def _to_ray(self, from_origin: Matrix, ray: Matrix) -> Matrix:
        length = float(ray @ self.precision_ @ ray)
        t = (
            np.maximum(from_origin @ self.precision_ @ ray / length, 0.0)
            if length > 0
            else np.zeros(from_origin.shape[0])
        )
        off = from_origin - t[:, None] * ray
        return np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", off, self.precision_, off), 0.0))
