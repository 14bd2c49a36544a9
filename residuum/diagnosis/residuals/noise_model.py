"""Noise model of a healthy residual: its colour (AR), its size σ and its tails (Gaussian, heavier
or lighter).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import linalg, optimize, signal, special, stats

from residuum.array_types import FloatArray
from residuum.diagnosis.thresholds.tails import HazardTail, differing_tail
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.kernel_based.gram import RegressionSums, regression_sums
from residuum.identification.linear_models.identified_model import IdentifiedModel

_HIGHEST_ORDER = 20  # of the autoregression
_FEWEST = 50  # samples in a row
_LIGHTEST_TAILS = 200.0  # degrees of freedom from which a Student t is called Gaussian
GAUSSIAN_SHAPE = 2.0
STEEPEST = 30.0  # β from which lighter tails are not told apart: nearly uniform
_NODES = 60  # of the Gauss–Hermite rule; its outermost lies 14 standard deviations out
_RAREST = -1e4  # ln of the smallest probability that is told apart, a score of 141
# Knots of the table of scores in |ε|: heavy tails reach far out, where light ones have long ended.
_TABLE = np.arcsinh(np.logspace(-3, 9, 400))
_LIGHT_TABLE = np.arcsinh(np.concatenate([np.linspace(0.01, 4.0, 400), np.logspace(0.61, 9, 200)]))
# ln of the probabilities at which a law is stood for by single values
_NATS, _APART = (np.arange(0.025, 40.0, 0.05), 0.05)
_SLIGHT = 1e-2  # σ, to take a slope over
# of a hazard's growth times a change of variance, below which the tail is as good as exponential
_STRAIGHT = 1e-6
_FURTHEST = 1e100
# sizes of the model error at which a limit is worked out; between them it is interpolated
_LEVELS = 25


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """e(t) + a₁ e(t−1) + … + a_p e(t−p) = σ ε(t), with ε independent, of unit scale and symmetric.

    Parameters
    ----------
    ar : array, shape (p + 1,)
        Whitening filter 1, a₁, …, a_p.
    sigma : float
        σ [unit of the residual]: standard deviation of the innovation for Gaussian noise, scale of
        Student's t otherwise.
    dof : float
        Degrees of freedom of Student's t; infinite where the tails are no heavier than Gaussian.
    n : int
        Healthy samples it was fitted on; 0 when taken from an identified model.
    shape : float
        β of exp(−|ε|^β/β): 2 is Gaussian, more are the lighter tails of noise with bounds
        (Subbotin's exponential power law).
    freedom : float
        Degrees of freedom of σ: it is as uncertain as the root of a mean of that many squared
        Gaussian samples; infinite = known.
    blur : float
        Standard deviation, in σ, of the model error that a residual carries besides its noise.
        Noise with bounds must allow for it: beyond the bound the noise alone has no probability
        left, and every small error would count as a fault.
    tail : HazardTail or None
        Of |ε| with that model error in it, where healthy samples contradict the form that `dof` and
        `shape` give.
    """

    ar: FloatArray
    sigma: float
    dof: float = float("inf")
    n: int = 0
    shape: float = 2.0
    freedom: float = float("inf")
    blur: float = 0.0
    tail: HazardTail | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "ar", np.ascontiguousarray(self.ar, dtype=float))
        if not (np.isfinite(self.sigma) and self.sigma > 0):
            raise BadInput(
                f"noise model, sigma: is {self.sigma!r}; must be positive (is the residual"
                " constant?)"
            )

    @property
    def is_gaussian(self) -> bool:
        """Whether the tails are Gaussian."""
        return bool(np.isinf(self.dof)) and self.shape == GAUSSIAN_SHAPE and self.tail is None

    @property
    def innovation_std(self) -> float:
        """Standard deviation of σ ε (of a Student t with dof ≤ 2, which has none, its scale)."""
        if np.isinf(self.dof):
            return self.sigma * float(self._law.std())
        if self.dof <= 2:
            return self.sigma
        return self.sigma * float(np.sqrt(self.dof / (self.dof - 2)))

    def limit(self, rate: float, error: npt.ArrayLike = 0.0) -> FloatArray:
        """|innovation plus model error| that is exceeded at `rate` per sample, both in standard
        deviations of the innovation.

        Parameters
        ----------
        error : array, any shape
            Standard deviation of the model error at each sample; it is Gaussian and independent of
            the noise.

        Gaussian noise gives q √(1 + error²), which also stands for noise with heavier tails. With
        lighter tails, or a tail of its own, the law that is known carries the error `blur`: what a
        sample carries beyond it is added by convolution,

            rate = mean over the law of Q((L − |ε|)/d) + Q((L + |ε|)/d),   d² = error² − blur²,

        and what it lacks is taken off as from a Gaussian tail: h/c (1 − √(1 + c d²)), h the hazard
        at L and c its growth.
        """
        unit = self.innovation_std / self.sigma
        error = np.asarray(error, dtype=float)
        if self.tail is None and (np.isfinite(self.dof) or self.is_gaussian):
            return np.asarray(float(self._law.isf(rate / 2.0)) / unit * np.hypot(1.0, error))
        # each limit is a root that is searched, far too much work for every sample
        errors = np.unique(np.linspace(error.min(), error.max(), _LEVELS))
        limits = [self._limit_with(rate, unit * size) / unit for size in errors]
        return np.asarray(np.interp(error, errors, limits))

    def _limit_with(self, rate: float, error: float) -> float:
        """|ε| exceeded at `rate` where the model error has this standard deviation, both in σ."""
        own = float(self._size_at(np.array([rate]))[0])
        further = error**2 - self.blur**2
        if further <= 0.0:
            return own + self._moved(own, further)
        # the law as single values, one for each twentieth of a nat of its tail
        sizes, spread = self._size_at(np.exp(-_NATS)), float(np.sqrt(further))
        shares = np.exp(-_NATS) * 2.0 * np.sinh(0.5 * _APART)

        def excess(level: float) -> float:
            exceeded = shares @ (
                special.ndtr((sizes - level) / spread) + special.ndtr(-(sizes + level) / spread)
            )
            return float(np.log(max(exceeded, np.finfo(float).tiny) / rate))

        return float(optimize.brentq(excess, 0.0, sizes[-1] + 40.0 * spread))

    def _moved(self, size: float, further: float) -> float:
        """How far the limit `size` moves when the model error's variance changes by `further` ≤
        0.
        """
        before, at, after = self.log_tail(size + _SLIGHT * np.array([-1.0, 0.0, 1.0]))
        # slope and curvature of −ln of the tail, by central differences
        hazard = float(before - after) / (2.0 * _SLIGHT)
        growth = float(2.0 * at - before - after) / _SLIGHT**2
        # h/c (√(1 + c d²) − 1) as c → 0, where its quotient loses all digits
        if growth * abs(further) < _STRAIGHT:
            return 0.5 * hazard * further
        return hazard / growth * (float(np.sqrt(max(1.0 + growth * further, 0.0))) - 1.0)

    def _size_at(self, probability: FloatArray) -> FloatArray:
        """|ε| that is exceeded with these probabilities."""
        knots, scores = self.score_table
        return np.asarray(np.sinh(np.interp(stats.norm.isf(probability / 2.0), scores, knots)))

    @property
    def samples(self) -> float:
        """Healthy samples it rests on; infinite when it was given."""
        return float(self.n or self.freedom)

    @property
    def level_variance(self) -> float:
        """Variance of the scores' mean by the error of an operating point taken from the same
        samples: 1/n if Gaussian.
        """
        return (self.score_slope * self.innovation_std / self.sigma) ** 2 / self.samples

    def allowing_for_size(self, b: float) -> float:
        """Limit for scores by an estimated σ that is exceeded as rarely, averaged over the
        estimates, as b by standard normals.

        Scores divided by an estimated σ have the tails of Student's t with its degrees of freedom.

        >>> round(NoiseModel(np.ones(1), 1.0, freedom=500.0).allowing_for_size(5.0), 3)
        5.066
        """
        if np.isinf(self.freedom):
            return b
        return float(stats.t.isf(stats.norm.sf(b), self.freedom))

    def rate_factor(self, b: float) -> float:
        """F: the real rate of crossings of b lies between 1/F and F times the chosen one for 95 %
        of all σ̂.

        ln φ(b σ̂/σ) changes by b² a relative error of σ̂, whose standard deviation is 1/√(2
        freedom).

        >>> round(NoiseModel(np.ones(1), 1.0, freedom=4000.0).rate_factor(5.0), 2)
        1.73
        """
        return float(np.exp(stats.norm.ppf(0.975) * b * b / np.sqrt(2.0 * self.freedom)))

    def output_std(self, post_filter: FloatArray) -> float:
        """Standard deviation of the noise after a filter with this impulse response [unit of the
        residual times its gain].
        """
        coloured = signal.lfilter(
            [1.0], self.ar, np.concatenate([post_filter, np.zeros(max(1000, len(post_filter)))])
        )
        return self.innovation_std * float(np.linalg.norm(coloured))

    def whiten(self, e: npt.ArrayLike) -> FloatArray:
        """ε, shape (n,); the first p samples lack their past and are NaN."""
        e = np.asarray(e, dtype=float)
        white = np.convolve(e, self.ar)[: len(e)] / self.sigma
        white[: len(self.ar) - 1] = np.nan
        return white

    def normal_scores(self, epsilon: FloatArray) -> FloatArray:
        """Φ⁻¹(F(ε)): standard normal when ε follows the model, so that Gaussian thresholds hold
        with any tails.
        """
        if self.is_gaussian:
            return epsilon
        knots, scores = self.score_table
        return np.asarray(np.sign(epsilon) * np.interp(np.arcsinh(np.abs(epsilon)), knots, scores))

    @cached_property
    def score_table(self) -> tuple[FloatArray, FloatArray]:
        """Knots in arcsinh|ε| and the normal scores there; computed in logarithms, so far tails
        keep their order.
        """
        knots = _LIGHT_TABLE if np.isinf(self.dof) else _TABLE
        scores = -special.ndtri_exp(np.minimum(self.log_tail(np.sinh(knots)), np.log(0.5)))
        return np.concatenate([[0.0], knots]), np.concatenate([[0.0], scores])

    @cached_property
    def score_slope(self) -> float:
        """E[ds/dε]: by how much a small shift of every ε moves the scores s on average; 1 for
        Gaussian noise.
        """
        if self.is_gaussian:
            return 1.0
        knots, scores = self.score_table
        return 2.0 * float(np.trapezoid(self._law.pdf(np.sinh(knots)), scores))

    @cached_property
    def _law(self) -> Any:
        """Distribution of ε."""
        return (
            stats.gennorm(self.shape, scale=_unit_scale(self.shape))
            if np.isinf(self.dof)
            else stats.t(self.dof)
        )

    def log_tail(self, epsilon: FloatArray) -> FloatArray:
        """ln P(ε' > ε) for ε ≥ 0, model error included: from `tail` where there is one, the law of
        `dof` and `shape` below it.
        """
        if self.tail is None:
            return self._blurred_log_tail(epsilon)
        # below its start the tail's law is the form's, scaled to leave it its share
        start, share = np.array([self.tail.start]), self.tail.share
        inside = 1.0 - 2.0 * np.exp(self._blurred_log_tail(np.minimum(epsilon, start)))
        inside *= (1.0 - share) / (1.0 - 2.0 * np.exp(self._blurred_log_tail(start)))
        outside = self.tail.log_probability(np.clip(epsilon, start, _FURTHEST))
        both = np.where(epsilon > start, outside, np.log1p(-inside)) - np.log(2.0)
        return np.asarray(np.maximum(both, _RAREST))

    def _blurred_log_tail(self, epsilon: FloatArray) -> FloatArray:
        """ln P(ε' + ξ > ε) with ξ ~ N(0, blur²), for ε ≥ 0; heavier tails than Gaussian drown
        it.
        """
        if self.blur == 0.0 or np.isfinite(self.dof):
            return self._log_tail(epsilon)
        # the mean over ξ by Gauss and Hermite's rule, in logarithms: far tails underflow else
        nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
        at = epsilon[:, None] - self.blur * nodes
        tails = self._log_tail(np.abs(at))
        both = np.where(at >= 0.0, tails, np.log1p(-np.exp(np.minimum(tails, np.log(0.5)))))
        return np.asarray(
            np.maximum(special.logsumexp(both, axis=1, b=weights / weights.sum()), _RAREST)
        )

    def _log_tail(self, epsilon: FloatArray) -> FloatArray:
        """ln P(ε' > ε) for ε ≥ 0."""
        if np.isfinite(self.dof):
            return np.asarray(np.maximum(stats.t.logsf(epsilon, self.dof), _RAREST))
        # ½ Γ(1/β, |ε|^β/β) / Γ(1/β); beyond y = 500, before it underflows, the first
        # term of its asymptotic series
        a, y = 1.0 / self.shape, np.minimum(epsilon, -_RAREST) ** self.shape / self.shape
        far = -y + (a - 1.0) * np.log(np.maximum(y, 1.0)) - special.gammaln(a)
        near = np.log(np.maximum(special.gammaincc(a, y), np.finfo(float).tiny))
        return np.asarray(np.maximum(np.log(0.5) + np.where(y > 500.0, far, near), _RAREST))


def _unit_scale(shape: float) -> float:
    """The scale at which scipy's exp(−|x/scale|^β) is exp(−|x|^β/β)."""
    return float(shape ** (1.0 / shape))


def fit_noise_model(
    residuals: Sequence[npt.ArrayLike], *, highest_order: int = _HIGHEST_ORDER
) -> NoiseModel:
    """Noise model of healthy residuals, one array an experiment; NaN marks samples that are
    missing.

    AR order by BIC over least-squares fits up to `highest_order`; tails by maximum likelihood of
    Student's t and of the exponential power law, kept only where their BIC beats the Gaussian's.

    Raises
    ------
    BadInput
        Fewer than 50 usable samples in a row, or a residual that does not vary.

    Examples
    --------
    >>> e = signal.lfilter([1.0], [1.0, -0.6], np.random.default_rng(1).standard_normal(5000))
    >>> model = fit_noise_model([e])
    >>> len(model.ar) - 1, round(float(model.ar[1]), 1), model.is_gaussian
    (1, -0.6, True)
    """
    stretches = [
        stretch
        for residual in residuals
        for stretch in _unbroken(np.asarray(residual, dtype=float))
    ]
    stretches = [stretch for stretch in stretches if len(stretch) >= _FEWEST]
    if not stretches:
        raise BadInput(
            f"noise model: no stretch of {_FEWEST} healthy residual samples without a gap; record"
            " more"
        )
    n = sum(map(len, stretches))
    if max(float(np.ptp(stretch)) for stretch in stretches) == 0.0:
        raise BadInput(
            "noise model: the healthy residual does not vary; a noise size cannot be taken from it"
        )
    # twenty samples a coefficient at least
    ar = _autoregression(stretches, min(highest_order, n // 20))
    p = len(ar) - 1
    innovations = np.concatenate(
        [np.convolve(stretch, ar)[p : len(stretch)] for stretch in stretches]
    )
    # noise has heavier tails than Gaussian, or lighter ones, never both
    sigma, dof = _heavy_tails(innovations)
    if np.isfinite(dof):
        return NoiseModel(ar, sigma, dof, n)
    sigma, shape = _light_tails(innovations)
    return NoiseModel(ar, sigma, n=n, shape=shape)


def _unbroken(residual: FloatArray) -> list[FloatArray]:
    good = np.isfinite(residual)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    return [residual[start:stop] for start, stop in edges.reshape(-1, 2)]


def _autoregression(stretches: list[FloatArray], highest_order: int) -> FloatArray:
    """Least-squares AR of each order on the same rows, the order by BIC; an unstable fit is passed
    over.
    """
    lagged = np.concatenate(
        [np.lib.stride_tricks.sliding_window_view(s, highest_order + 1)[:, ::-1] for s in stretches]
    )
    n = len(lagged)
    gram = lagged.T @ lagged
    best, least = np.ones(1), n * np.log(gram[0, 0] / n)
    for p in range(1, highest_order + 1):
        a = -linalg.solve(gram[1 : p + 1, 1 : p + 1], gram[1 : p + 1, 0], assume_a="sym")
        power = gram[0, 0] + a @ gram[1 : p + 1, 0]
        bic = n * np.log(max(power, np.finfo(float).tiny) / n) + p * np.log(n)
        polynomial = np.concatenate([[1.0], a])
        if bic < least and np.all(np.abs(np.roots(polynomial)) < 1.0):
            best, least = polynomial, bic
    return best


def _light_tails(innovations: FloatArray) -> tuple[float, float]:
    """σ and β; β = 2 where lighter tails do not beat the Gaussian's BIC. For each β, σ^β = mean
    |e|^β is the best σ.
    """
    size = np.abs(innovations) / float(np.sqrt(np.mean(innovations**2)))

    def cost(shape: float) -> float:
        """−ln p per sample, σ at its best."""
        scale = np.log(np.mean(size**shape)) / shape
        return float(
            scale
            + np.log(2.0 * _unit_scale(shape))
            + special.gammaln(1.0 + 1.0 / shape)
            + 1.0 / shape
        )

    best = optimize.minimize_scalar(
        cost, bounds=(2.0, STEEPEST), method="bounded", options={"xatol": 1e-3}
    )
    n = len(innovations)
    shape = float(best.x) if n * (cost(2.0) - best.fun) > 0.5 * np.log(n) else 2.0
    return float(np.mean(np.abs(innovations) ** shape) ** (1.0 / shape)), shape


def _heavy_tails(innovations: FloatArray) -> tuple[float, float]:
    """σ and degrees of freedom of Student's t; infinite where heavier tails do not beat the
    Gaussian's BIC.
    """
    sigma = float(np.sqrt(np.mean(innovations**2)))
    x = innovations / sigma

    def cost(parameters: FloatArray) -> float:
        scale, dof = np.exp(parameters)
        constant = (
            special.gammaln((dof + 1) / 2)
            - special.gammaln(dof / 2)
            - 0.5 * np.log(dof * np.pi)
            - parameters[0]
        )
        return -float(len(x) * constant - (dof + 1) / 2 * np.sum(np.log1p((x / scale) ** 2 / dof)))

    start = np.log([float(np.median(np.abs(x))) / 0.75 + 1e-3, 6.0])
    # 20 000 samples tell a shape; the evidence of the others is counted by `weight`
    sparse = x if len(x) <= 20000 else x[:: len(x) // 20000]
    x, weight = sparse, len(x) / len(sparse)
    fitted = optimize.minimize(
        cost, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-2, "maxiter": 200}
    )
    gaussian = 0.5 * float(np.sum(x**2) + len(x) * np.log(2 * np.pi))
    scale, dof = np.exp(fitted.x)
    if dof > _LIGHTEST_TAILS or weight * (gaussian - fitted.fun) < 0.5 * np.log(weight * len(x)):
        return sigma, float("inf")
    return sigma * float(scale), float(dof)


# Size of the innovations of a healthy residual, freed of what the identified model took from, or
# added to, these samples.

_NEGLIGIBLE = 1e-10  # of the largest eigenvalue: directions that the input does not excite
_BINS, _NODES_OF_SHAPES = 300, 60  # of the residual's histogram, and of the Gauss–Hermite rule
_MOST = 4  # samples at least for each direction that is fitted


def with_unbiased_size(
    noise: NoiseModel,
    inputs: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
    model: IdentifiedModel,
) -> NoiseModel:
    """The noise model with σ corrected for the model's error on these records, and with the degrees
    of freedom it rests on.

    On the records a model was identified from its residual is too small by the k directions it was
    fitted in, on others too large by its error: e = v − Φ δ with v correlated with δ, or not. What
    the best impulse response leaves over does not depend on δ, so

        σ̂² = min_δ ‖A (e − Φ δ)‖² / (n − k − p − 1)

    is unbiased for both, k being the directions of Φ that the input excites (the model's most
    uncertain ones, where there are more than n/4), p the order of A and 1 for the operating point.
    Heavier tails than Gaussian keep their shape; of lighter ones the shape is found anew without
    the model's error, which rounds off the bounds. The scale is corrected in the same proportion,
    and its degrees of freedom count by the Fisher information of a scale.

    Parameters
    ----------
    inputs, residuals : sequences of arrays, shape (n,)
        u less its mean and the primary residual of each record; NaN = missing or not valid.

    Without a stretch longer than the model's memory nothing is corrected.
    """
    try:
        sums = _sums(noise, inputs, residuals, model)
    except NotIdentifiable:
        return replace(noise, freedom=_scale_freedom(noise, float(noise.n)))
    centred = sums.centred()
    explained, k = _explained(centred, model, sums.rows // _MOST)
    # σ̂² of the docstring, as a factor on the size that the residual itself has
    left = centred.degrees_of_freedom - k - (len(noise.ar) - 1)
    power = (centred.energy - explained) / left
    size = float(np.sqrt(power / (sums.energy / sums.rows)))
    error = float(np.sqrt(np.sum(centred.gram * model.covariance) / sums.rows / power))
    sharp = noise
    if noise.shape > GAUSSIAN_SHAPE:
        sharp = replace(noise, shape=shape_without(error, noise, residuals))
    unit = sharp.innovation_std / sharp.sigma
    sigma = size * noise.innovation_std / unit
    return replace(
        sharp, sigma=sigma, freedom=_scale_freedom(sharp, float(left)), blur=error * unit
    )


def shape_without(error: float, noise: NoiseModel, residuals: Sequence[FloatArray]) -> float:
    """β of the noise alone, by maximum likelihood, where the residual also carries a Gaussian model
    error `error` σ large.
    """
    white = np.concatenate([np.convolve(e, noise.ar)[: len(e)] for e in residuals])
    white = np.abs(white[np.isfinite(white)])
    counts, edges = np.histogram(white / np.sqrt(np.mean(white**2)), bins=_BINS)
    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES_OF_SHAPES)
    at = 0.5 * (edges[1:] + edges[:-1])[:, None] - error * nodes

    def cost(shape: float) -> float:
        law = stats.gennorm(shape)
        scale = float(np.sqrt(max(1.0 - error**2, _NEGLIGIBLE))) / float(law.std())
        density = law.pdf(at / scale) @ weights / scale
        return -float(counts @ np.log(np.maximum(density, np.finfo(float).tiny)))

    return float(
        optimize.minimize_scalar(cost, bounds=(GAUSSIAN_SHAPE, STEEPEST), method="bounded").x
    )


def _sums(
    noise: NoiseModel,
    inputs: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
    model: IdentifiedModel,
) -> RegressionSums:
    """Sums of the regression of the whitened residual on the whitened input's lags, over all
    records.
    """
    whitened = [
        (np.convolve(u, noise.ar)[: len(u)], np.convolve(e, noise.ar)[: len(e)])
        for u, e in zip(inputs, residuals, strict=True)
    ]
    parts = []
    for u, e in whitened:
        try:
            parts.append(regression_sums([u], e, model.order, model.delay))
        except NotIdentifiable:
            continue
    if not parts:
        raise NotIdentifiable("no record is longer than the model's memory")
    return reduce(add, parts)


def _explained(sums: RegressionSums, model: IdentifiedModel, most: int) -> tuple[float, int]:
    """Energy that an error of the impulse response in its `most` most uncertain directions
    explains; how many are excited.
    """
    _, vectors = np.linalg.eigh(model.covariance)
    basis = vectors[:, ::-1][:, : max(most, 1)]
    eigenvalues, directions = np.linalg.eigh(basis.T @ sums.gram @ basis)
    excited = eigenvalues > _NEGLIGIBLE * eigenvalues[-1]
    along = directions[:, excited].T @ (basis.T @ sums.cross)
    return float(np.sum(along**2 / eigenvalues[excited])), int(excited.sum())


def _scale_freedom(noise: NoiseModel, samples: float) -> float:
    """Gaussian samples that would tell σ as well: the Fisher information of ln σ is 2 for those, 2
    ν/(ν + 3) and β for ours.
    """
    return samples * (
        noise.dof / (noise.dof + 3.0) if np.isfinite(noise.dof) else noise.shape / 2.0
    )


# What healthy samples say of the tails: of the whitened innovations, and of the robust residual a
# single sample is judged by.


def with_healthy_tail(noise: NoiseModel, residuals: Sequence[FloatArray]) -> NoiseModel:
    """The noise model with a tail of its own where healthy samples contradict the form of its law.

    A model's error on its own records shrinks the innovations, on others it widens them: for
    lighter tails than exponential they are scaled to the power that new ones have, σ² and the
    model's error. To the samples of a linear fit this does what leaving each out of it does: its
    residual over 1 − h, h its leverage, here the mean one.

    Parameters
    ----------
    noise : NoiseModel
        With its size freed of the fit and its `blur`.
    residuals : sequence of arrays, shape (n,)
        Primary residual of each healthy record; NaN = missing or not valid.
    """
    bare = replace(noise, tail=None)
    white = np.concatenate([bare.whiten(e) for e in residuals])
    sizes = np.abs(white[np.isfinite(white)])
    if np.isinf(noise.dof):
        sizes *= float(
            np.hypot(noise.innovation_std / noise.sigma, noise.blur) / np.sqrt(np.mean(sizes**2))
        )
    return replace(noise, tail=differing_tail(sizes, lambda x: np.log(2.0) + bare.log_tail(x)))


def single_sample_law(
    residuals: Sequence[FloatArray], spread: float, errors: FloatArray
) -> NoiseModel:
    """The law of the noise in one sample of a filtered residual, found on the residual itself; its
    `ar` is 1.

    A filter mixes many innovations into one sample, so that noise with bounds, or with heavy tails,
    comes out nearer to Gaussian.

    Parameters
    ----------
    residuals : sequence of arrays, shape (n,)
        Filtered residual of each healthy record; NaN = missing or not valid.
    spread : float
        Standard deviation of its noise, in its unit.
    errors : array, shape (samples,)
        Standard deviation of the model error in each of its samples, in its unit.

    Raises
    ------
    BadInput
        Fewer than 50 samples in a row, or residuals that do not vary.
    """
    law, error = fit_noise_model(residuals, highest_order=0), float(np.sqrt(np.mean(errors**2)))
    if np.isinf(law.dof):
        if law.shape > GAUSSIAN_SHAPE:
            law = replace(law, shape=shape_without(error / spread, law, residuals))
        # the form is the residual's own, the size the one that the innovations lead to
        law = replace(law, sigma=law.sigma * spread / law.innovation_std)
    return with_healthy_tail(replace(law, blur=error / law.sigma), residuals)
