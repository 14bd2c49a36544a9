"""IdentifiedModel: what every identification method returns, a linear model that knows how far to
trust it.

Its file is written and read by `residuum.identification.linear_models.identified_model`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from scipy import signal, stats

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.schur import is_schur
from residuum.identification.linear_models.transfer_function import TransferFunction

_ARRAYS = (
    "impulse_response",
    "covariance",
    "numerator",
    "denominator",
    "parameter_covariance",
    "noise_numerator",
    "noise_denominator",
    "pointwise_std",
    "longer_response",
    "longer_covariance",
)


class Bands(Protocol):
    """Computes the standard deviations of single coefficients."""

    @property
    def std(self) -> FloatArray:
        """Shape (m,)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class IdentifiedModel:
    """A linear time-invariant model of one input and one output, with the covariance of its
    estimate.

    y(t) = Σ_{i=0}^{m−1} g_i u(t − delay − i) + offset + H e(t),  e ~ N(0, σ²)

    A parametric method also gives G(z) = numerator/denominator (delay included); frequency
    responses and random models are then taken from it, otherwise from the impulse response.

    Parameters
    ----------
    method : str
        Name of the method, e.g. `kernel-tc`, `oe`.
    sample_time : float
        Sample time [s].
    impulse_response : array, shape (m,)
        g [output unit / input unit]; `g[0]` acts at lag `delay`.
    covariance : array, shape (m, m)
        Covariance of the estimate of g (posterior covariance, or first-order from the parameters).
    noise_variance : float
        σ² of the innovation [output unit²].
    delay : int
        Lag of the first coefficient in samples: 0 = direct feedthrough, 1 = the usual sampled
        system.
    offset : float
        Output level at zero input [output unit].
    numerator, denominator : array or None
        Coefficients of G in descending powers of z.
    parameter_covariance : array or None, shape (p, p)
        Covariance of `[*numerator, *denominator[1:]]`, so p = len(numerator) + len(denominator) − 1
        and `denominator[0]` is 1; coefficients that were not estimated have zero rows.
    noise_numerator, noise_denominator : array or None
        Monic H in descending powers of z, of equal length; None = white output noise, H = 1.
    pointwise_std : array or None, shape (m,)
        Standard deviations of single coefficients that hold more than `covariance` does
        (hyper-parameters marginalised).
    longer_response, longer_covariance : array or None, shapes (M,) and (M, M), M ≥ m
        Estimate of a response of which g is cut off too early to say how far the plant may be from
        it: random models are drawn from this one, so that a bound on the error of g holds what g
        leaves out.
    bands : Bands or None
        What computes `pointwise_std` when it is first asked for; not kept in a file.
    hyper_parameters : mapping of name to float
        Of a kernel method: `alpha`, `scale`, …
    negative_log_likelihood : float
        −log p(y) of the data at the estimate (marginal likelihood for kernel methods).
    warnings : tuple of str
        What a reader must know before using the result, one sentence each.
    unfit : tuple of str
        Why no controller is promised for it, one sentence each that says what to record instead.
    integrates : bool
        Whether G has a pole at one that was not estimated; `covariance` then is of the summed
        coefficients of what is before it.
    provenance : mapping
        Records, number of samples used (`n`), seconds, and settings of the estimation.

    Raises
    ------
    BadModel
        Shapes that do not fit together, non-finite numbers, negative variance or delay,
        non-positive sample time.

    Examples
    --------
    >>> model = IdentifiedModel(method="by hand", sample_time=1.0, impulse_response=[0.6, -0.24],
    ...                         covariance=[[0.01, 0], [0, 0.01]], noise_variance=0.4)
    >>> model.simulate([1.0, 0.0, 0.0]).tolist()
    [0.0, 0.6, -0.24]
    >>> model.sample(3, seed=1).shape
    (3, 2)
    """

    method: str
    sample_time: float
    impulse_response: FloatArray
    covariance: FloatArray
    noise_variance: float
    input_name: str = "u"
    input_unit: str = ""
    output_name: str = "y"
    output_unit: str = ""
    delay: int = 1
    offset: float = 0.0
    numerator: FloatArray | None = None
    denominator: FloatArray | None = None
    parameter_covariance: FloatArray | None = None
    noise_numerator: FloatArray | None = None
    noise_denominator: FloatArray | None = None
    pointwise_std: FloatArray | None = None
    longer_response: FloatArray | None = None
    longer_covariance: FloatArray | None = None
    bands: Bands | None = field(default=None, repr=False)
    hyper_parameters: Mapping[str, float] = field(default_factory=dict)
    negative_log_likelihood: float = float("nan")
    aic: float | None = None
    bic: float | None = None
    warnings: tuple[str, ...] = ()
    unfit: tuple[str, ...] = ()
    integrates: bool = False
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _finite(getattr(self, name), name))
        m = self.impulse_response.shape[0] if self.impulse_response.ndim == 1 else 0
        _rule(m > 0, "impulse_response", "must be one-dimensional and not empty")
        _rule(
            self.covariance.shape == (m, m),
            "covariance",
            f"has shape {self.covariance.shape}; must be ({m}, {m})",
        )
        _rule(
            np.isfinite(self.sample_time) and self.sample_time > 0,
            "sample_time",
            "must be a positive number of seconds",
        )
        _rule(
            np.isfinite(self.noise_variance) and self.noise_variance >= 0,
            "noise_variance",
            "must be ≥ 0 and finite",
        )
        if self.pointwise_std is not None:
            known = self.pointwise_std.shape == (m,) and bool((self.pointwise_std >= 0).all())
            _rule(known, "pointwise_std", f"must be {m} numbers ≥ 0")
        self._check_longer_response(m)
        _rule(self.delay >= 0, "delay", f"is {self.delay}; must be a number of samples ≥ 0")
        _rule(np.isfinite(self.offset), "offset", "must be finite")
        self._check_parametric_part()
        object.__setattr__(self, "hyper_parameters", MappingProxyType(dict(self.hyper_parameters)))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))
        object.__setattr__(self, "warnings", tuple(self.warnings))
        object.__setattr__(self, "unfit", tuple(self.unfit))

    def _check_longer_response(self, m: int) -> None:
        both = self.longer_response, self.longer_covariance
        _rule(
            (both[0] is None) == (both[1] is None),
            "longer_response",
            "comes together with longer_covariance",
        )
        if self.longer_response is not None and self.longer_covariance is not None:
            _rule(
                self.longer_response.ndim == 1 and len(self.longer_response) >= m,
                "longer_response",
                f"must have at least {m}",
            )
            M = len(self.longer_response)
            _rule(
                self.longer_covariance.shape == (M, M),
                "longer_covariance",
                f"must have shape ({M}, {M})",
            )

    def _check_parametric_part(self) -> None:
        _rule(
            (self.numerator is None) == (self.denominator is None),
            "numerator",
            "comes together with denominator",
        )
        if self.numerator is not None and self.denominator is not None:
            TransferFunction(self.numerator, self.denominator, self.sample_time)
            _rule(self.denominator[0] == 1.0, "denominator", "must begin with 1")
            if self.parameter_covariance is not None:
                p = len(self.numerator) + len(self.denominator) - 1
                _rule(
                    self.parameter_covariance.shape == (p, p),
                    "parameter_covariance",
                    f"must have shape ({p}, {p})",
                )
        _rule(
            (self.noise_numerator is None) == (self.noise_denominator is None),
            "noise_numerator",
            "comes together with noise_denominator",
        )
        if self.noise_numerator is not None and self.noise_denominator is not None:
            monic = self.noise_numerator[0] == self.noise_denominator[0] == 1.0
            _rule(
                monic and len(self.noise_numerator) == len(self.noise_denominator),
                "noise_numerator",
                "must be monic, as long as noise_denominator",
            )

    @property
    def order(self) -> int:
        """Length m of the impulse response."""
        return len(self.impulse_response)

    @property
    def reach(self) -> int:
        """Length of the impulse responses that `sample_longer` draws."""
        return self.order if self.longer_response is None else len(self.longer_response)

    @property
    def std(self) -> FloatArray:
        """Standard deviation of each impulse-response coefficient, shape (m,): `pointwise_std`
        where it is known.
        """
        if self.pointwise_std is None and self.bands is not None:
            object.__setattr__(self, "pointwise_std", _finite(self.bands.std, "pointwise_std"))
        return self.conditional_std if self.pointwise_std is None else self.pointwise_std

    @property
    def conditional_std(self) -> FloatArray:
        """Standard deviations by `covariance`, shape (m,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def is_parametric(self) -> bool:
        """Whether G is given as numerator/denominator."""
        return self.numerator is not None

    @property
    def diverges(self) -> bool:
        """Whether its simulation grows without bound: a pole of the estimate on or outside the unit
        circle.
        """
        return (
            self.denominator is not None and not self.integrates and not is_schur(self.denominator)
        )

    def transfer_function(self) -> TransferFunction:
        """G(z): numerator/denominator, or the impulse response as a polynomial in z⁻¹."""
        if self.numerator is not None and self.denominator is not None:
            return TransferFunction(self.numerator, self.denominator, self.sample_time)
        denominator = np.zeros(self.delay + self.order)
        denominator[0] = 1.0
        return TransferFunction(self.impulse_response, denominator, self.sample_time)

    def one_sample_later(self) -> IdentifiedModel:
        """z⁻¹ G: what a controller meets that writes its signal one sample after the measurement
        that it answers.

        >>> at_once = IdentifiedModel(method="by hand", sample_time=1.0, impulse_response=[2.0], covariance=[[0.01]],
        ...                           noise_variance=0.1, delay=0)
        >>> at_once.one_sample_later().simulate([1.0, 0.0]).tolist()
        [0.0, 2.0]
        """
        denominator, covariance = self.denominator, self.parameter_covariance
        if denominator is not None:
            denominator = np.append(denominator, 0.0)
            covariance = None if covariance is None else np.pad(covariance, ((0, 1), (0, 1)))
        return replace(
            self, delay=self.delay + 1, denominator=denominator, parameter_covariance=covariance
        )

    def to_control(self) -> Any:
        """G as a python-control `TransferFunction` (needs the package `control`)."""
        return self.transfer_function().to_control()

    def frequency_response(self, omega: npt.ArrayLike) -> ComplexArray:
        """G(e^{jωTs}) at ω [rad/s], shape of `omega`."""
        omega = np.asarray(omega, dtype=float)
        if self.is_parametric:
            # a model that integrates has no static gain
            with np.errstate(divide="ignore", invalid="ignore"):
                return self.transfer_function().frequency_response(omega)
        return np.asarray(self._lag_phasors(omega) @ self.impulse_response)

    def frequency_covariance(self, omega: npt.ArrayLike) -> FloatArray:
        """Covariance of (Re G, Im G) at each ω [rad/s], shape (len(omega), 2, 2); (1.109) of the
        source, first order.
        """
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        gradient, covariance = self._frequency_gradient(omega)
        rows = np.stack([gradient.real, gradient.imag], axis=1)
        return np.asarray(rows @ covariance @ rows.transpose(0, 2, 1))

    def confidence_ellipses(
        self, omega: npt.ArrayLike, probability: float = 0.95, points: int = 64
    ) -> ComplexArray:
        """Boundaries of the Nyquist ellipses (1.113) that hold G with `probability` at each ω,
        shape (len(omega), points).
        """
        _rule(0 < probability < 1, "probability", f"is {probability}; must lie between 0 and 1")
        eigenvalues, axes = np.linalg.eigh(self.frequency_covariance(omega))
        angle = np.linspace(0.0, 2 * np.pi, points)
        circle = np.stack([np.cos(angle), np.sin(angle)])
        radius = np.sqrt(stats.chi2.ppf(probability, df=2))
        edge = radius * (axes * np.sqrt(np.maximum(eigenvalues, 0.0))[:, None, :]) @ circle
        return np.asarray(
            self.frequency_response(np.atleast_1d(omega))[:, None] + edge[:, 0] + 1j * edge[:, 1]
        )

    def sample(self, n: int, seed: int | np.random.Generator) -> FloatArray:
        """`n` impulse responses drawn from the distribution of the estimate, shape (n, m).

        Parametric models draw parameters and return their impulse responses; unstable draws are
        redrawn, because the distribution is conditioned on a stable system.
        """
        rng = np.random.default_rng(seed)
        if self.parameter_covariance is None:
            return (
                self.impulse_response
                + rng.standard_normal((n, self.order)) @ _square_root(self.covariance).T
            )
        impulse = np.zeros(self.delay + self.order)
        impulse[0] = 1.0
        drawn = zip(*self._sample_parameters(n, rng), strict=True)
        systems = (
            TransferFunction(numerator, denominator, self.sample_time)
            for numerator, denominator in drawn
        )
        return np.array([system.simulate(impulse)[self.delay :] for system in systems]).reshape(
            n, self.order
        )

    def sample_longer(self, n: int, seed: int | np.random.Generator) -> FloatArray:
        """`n` impulse responses as long as the data can tell, shape (n, `reach`); the same as
        `sample` where g has decayed.
        """
        if self.longer_response is None or self.longer_covariance is None:
            return self.sample(n, seed)
        rng = np.random.default_rng(seed)
        return (
            self.longer_response
            + rng.standard_normal((n, self.reach)) @ _square_root(self.longer_covariance).T
        )

    def sample_frequency_responses(
        self, n: int, omega: npt.ArrayLike, seed: int | np.random.Generator
    ) -> ComplexArray:
        """Frequency responses at ω [rad/s] of `n` random models of `sample_longer`, shape (n,
        len(omega)).
        """
        omega, rng = np.atleast_1d(np.asarray(omega, dtype=float)), np.random.default_rng(seed)
        if self.parameter_covariance is None:
            drawn = self._before_the_sum(self.sample_longer(n, rng))
            return np.asarray(drawn @ self._lag_phasors(omega, self.reach).T / self._sum_at(omega))
        z = np.exp(1j * omega * self.sample_time)
        numerators, denominators = self._sample_parameters(n, rng)
        return np.asarray(
            (numerators @ np.vander(z, numerators.shape[1]).T)
            / (denominators @ np.vander(z, denominators.shape[1]).T)
        )

    def polynomials(self) -> tuple[FloatArray, FloatArray]:
        """Numerator and denominator of G in ascending powers of z⁻¹, one row each."""
        if self.numerator is None or self.denominator is None:
            return np.r_[np.zeros(self.delay), self.impulse_response][None], np.ones((1, 1))
        lag = len(self.denominator) - len(self.numerator)
        return np.r_[np.zeros(lag), self.numerator][None], self.denominator[None]

    def sample_polynomials(
        self, n: int, seed: int | np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """The same of `n` random models of `sample_longer`, shapes (n, p) and (n, q) or (1, q)."""
        rng = np.random.default_rng(seed)
        if self.parameter_covariance is None:
            drawn = self._before_the_sum(self.sample_longer(n, rng))
            return np.hstack([np.zeros((n, self.delay)), drawn]), np.array(
                [[1.0, -1.0]] if self.integrates else [[1.0]]
            )
        numerators, denominators = self._sample_parameters(n, rng)
        return (
            np.hstack([np.zeros((n, denominators.shape[1] - numerators.shape[1])), numerators]),
            denominators,
        )

    def simulate(self, u: npt.ArrayLike) -> FloatArray:
        """Noise-free output for input `u`, shape (n,); the input before the first sample counts as
        zero.
        """
        u = _finite(u, "u")
        if self.is_parametric:
            return self.transfer_function().simulate(u) + self.offset
        delayed = np.concatenate([np.zeros(self.delay), u])[: len(u)]
        return np.asarray(signal.oaconvolve(delayed, self.impulse_response)[: len(u)] + self.offset)

    def simulation_std(self, u: npt.ArrayLike) -> FloatArray:
        """Standard deviation of `simulate(u)` that the uncertainty of g causes, shape (n,).

        √(φᵀ Σ_g φ) over the last m inputs φ, in single precision: its error is below 10⁻⁶ ‖φ‖ √λ, λ
        the largest eigenvalue.
        """
        u, m = _finite(u, "u"), self.order
        u, n = np.cumsum(u) if self.integrates else u, len(u)
        size = float(np.max(np.abs(u), initial=0.0)) or 1.0
        lags = np.zeros(n + 2 * m + self.delay, dtype=np.float32)
        lags[self.delay + m - 1 : self.delay + m - 1 + n] = u / size
        root = self._before_the_sum(_square_root(self.covariance).T).T[::-1]
        scale = float(np.abs(root).max()) or 1.0
        root = np.ascontiguousarray(root / scale, dtype=np.float32)
        std = np.empty(n)
        for first in range(min(m, n)):  # every m-th window: side by side in memory as they are
            windows = lags[first : first + -(-(n - first) // m) * m].reshape(-1, m)
            std[first::m] = np.linalg.norm(windows @ root, axis=1)
        return size * scale * std

    def predict(self, u: npt.ArrayLike, y: npt.ArrayLike) -> FloatArray:
        """One-step-ahead prediction of `y`, shape (n,): ŷ = H⁻¹G u + (1 − H⁻¹) y; `simulate(u)`
        when H = 1.

        Where H has the poles of G (arx, armax) they cancel, and the prediction of a plant that is
        not stable stays bounded.
        """
        y = _finite(y, "y")
        if self._poles_of_the_noise and self.numerator is not None and self.denominator is not None:
            u, lag = _finite(u, "u"), len(self.denominator) - len(self.numerator)
            _rule(len(y) == len(u), "y", f"has {len(y)} samples, u has {len(u)}; must be equal")
            of_input = signal.lfilter(np.r_[np.zeros(lag), self.numerator], self.noise_numerator, u)
            about = y - self.offset
            return np.asarray(
                of_input + y - signal.lfilter(self.noise_denominator, self.noise_numerator, about)
            )
        simulated = self.simulate(u)
        _rule(
            len(y) == len(simulated),
            "y",
            f"has {len(y)} samples, u has {len(simulated)}; must be equal",
        )
        if self.noise_numerator is None:
            return simulated
        return np.asarray(
            y - signal.lfilter(self.noise_denominator, self.noise_numerator, y - simulated)
        )

    @property
    def _poles_of_the_noise(self) -> bool:
        """Whether H and G divide by the same polynomial."""
        if (
            self.numerator is None
            or self.denominator is None
            or self.noise_denominator is None
            or self.integrates
        ):
            return False
        same = min(len(self.denominator), len(self.noise_denominator))
        longer = self.denominator[same:], self.noise_denominator[same:]
        return np.array_equal(self.denominator[:same], self.noise_denominator[:same]) and not any(
            map(np.any, longer)
        )

    def _before_the_sum(self, rows: FloatArray) -> FloatArray:
        """Impulse responses (rows, m) without the pole at one of a model that integrates; others as
        they are.
        """
        return np.diff(rows, prepend=0.0, axis=1) if self.integrates else rows

    def _sum_at(self, omega: FloatArray) -> ComplexArray:
        """1 − z⁻¹ of a model that integrates, which divides; else 1."""
        z = np.exp(1j * omega * self.sample_time)
        return np.asarray(1 - 1 / z if self.integrates else np.ones_like(z))

    def _lag_phasors(self, omega: FloatArray, length: int | None = None) -> ComplexArray:
        lags = self.delay + np.arange(self.order if length is None else length)
        return np.exp(-1j * self.sample_time * np.multiply.outer(omega, lags))

    def _frequency_gradient(self, omega: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """∂G/∂θ at each ω, shape (len(omega), p), and the covariance of θ."""
        if self.parameter_covariance is None or self.numerator is None or self.denominator is None:
            root = (
                self._before_the_sum(_square_root(self.covariance).T) if self.integrates else None
            )
            covariance = self.covariance if root is None else root.T @ root
            return self._lag_phasors(omega) / self._sum_at(omega)[:, None], covariance
        z = np.exp(1j * omega * self.sample_time)
        denominator = np.polyval(self.denominator, z)[:, None]
        by_numerator = np.vander(z, len(self.numerator)) / denominator
        by_denominator = (
            -np.vander(z, len(self.denominator))[:, 1:]
            * (by_numerator @ self.numerator)[:, None]
            / denominator
        )
        return np.hstack([by_numerator, by_denominator]), self.parameter_covariance

    def _sample_parameters(self, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Numerators and denominators of `n` random stable systems, shapes (n, …)."""
        if self.numerator is None or self.denominator is None or self.parameter_covariance is None:
            raise BadModel(f"IdentifiedModel {self.method!r}: has no parameters to draw from")
        theta = np.concatenate([self.numerator, self.denominator[1:]])
        root, p = _square_root(self.parameter_covariance), len(self.numerator)
        stable: list[FloatArray] = []
        for _ in range(20):
            drawn = theta + rng.standard_normal((n, len(theta))) @ root.T
            stable.extend(drawn[_stable(drawn[:, p:])])
            if len(stable) >= n:
                parameters = np.array(stable[:n])
                return parameters[:, :p], np.hstack([np.ones((n, 1)), parameters[:, p:]])
        raise BadModel(
            f"IdentifiedModel {self.method!r}: over 95 % of its random models are unstable; its"
            " covariance says nothing"
        )


def _stable(coefficients: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether zᵠ + c₁zᵠ⁻¹ + … has all roots inside the unit circle, row by row, shape (n,)."""
    n, degree = coefficients.shape
    companion = np.zeros((n, degree, degree))
    companion[:, :1, :] = -coefficients[:, None]
    companion[:, np.arange(1, degree), np.arange(degree - 1)] = 1.0
    return np.asarray((np.abs(np.linalg.eigvals(companion)) < 1).all(axis=1))


def _rule(holds: bool | np.bool_, quantity: str, rule: str) -> None:
    if not holds:
        raise BadModel(f"IdentifiedModel, {quantity}: {rule}")


def _finite(values: npt.ArrayLike, quantity: str) -> FloatArray:
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise BadModel(f"IdentifiedModel, {quantity}: is not an array of numbers") from None
    if not np.isfinite(array).all():
        raise BadModel(
            f"IdentifiedModel, {quantity}: has a missing or infinite value; all must be finite"
        )
    array.flags.writeable = False
    return array


def _square_root(covariance: FloatArray) -> FloatArray:
    """B with B Bᵀ = covariance; rounding may leave tiny negative eigenvalues, which count as
    zero.
    """
    eigenvalues, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(eigenvalues, 0.0)))
