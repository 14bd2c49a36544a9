"""Uncertainty weight W_T: from the distribution of an identified model to a bound on its relative
error (Algorithm 1).

Random models are drawn from the distribution of the estimate, Ω(ω) is the largest error among them
at each frequency (2.21), and a stable proper transfer function is fitted above it (2.22), (2.23).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.error_bounds.error_models import (
    FORMS,
    DrawnErrors,
    refined_grid,
)
from residuum.identification.linear_models.error_bounds.magnitude_fit import fit_magnitude
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.transfer_function import TransferFunction

# A bound on drawn errors over a weight at *every* frequency of an interval, not only at those
# that were looked at.
# Over an interval of half-width h about c a polynomial F(θ) = Σ a_k e^{−j(k−k₀)θ} obeys Taylor's
# theorem,
# |F(c + t) − F(c) − t F'(c)| ≤ ½ h² Σ (k − k₀)² |a_k|, |t| ≤ h,
# so that |A_i| is bounded from above by the ends of a line, and |B_i| from below by that line's
# distance from zero. |W| changes over the arc by the distances to its zeros and poles, which are
# known exactly. Intervals whose bound is not good enough are halved (branch and bound).

ABOVE_THE_SEEN = 0.005
"""By how much the bound may lie above the largest value that was seen, in parts."""
# halvings of the intervals between frequencies, and intervals that are open at a time
_MOST_ROUNDS, _MOST_INTERVALS = 40, 200_000
_VALUES_AT_ONCE = 1_000_000  # which bounds the memory
_ROUNDING = 1e-9  # relative, by which a bound is raised


@dataclass(frozen=True)
class Certificate:
    """Where the largest error over the weight lies on a whole band: `seen` ≤ sup_ω max_i |A_i|/|B_i
    W| ≤ `bound`.

    `proven` tells whether the search ended; otherwise `bound` is infinite, and nothing is promised
    between the points.
    """

    seen: float
    bound: float
    proven: bool


def largest_excess(
    errors: DrawnErrors, weight: TransferFunction, omega: npt.ArrayLike
) -> Certificate:
    """Bound the largest error over |weight| on the whole band that the grid `omega` [rad/s] spans.

    Parameters
    ----------
    errors : DrawnErrors
    weight : TransferFunction
        Discrete-time, without zeros on the unit circle.
    omega : array
        Increasing; its intervals are where the search begins.
    """
    angle = np.asarray(omega, dtype=float) * errors.sample_time
    left, right = angle[:-1], angle[1:]
    attained, finished = 0.0, 0.0
    for _ in range(_MOST_ROUNDS):
        at_centre, bound = _bounds(errors, weight, left, right)
        attained = max(attained, float(at_centre.max(initial=0.0)))
        enough = bound <= max(1.0, attained) * (1.0 + ABOVE_THE_SEEN)
        finished = max(finished, float(bound[enough].max(initial=0.0)))
        if enough.all():
            return Certificate(attained, finished * (1.0 + _ROUNDING), True)
        left, right = left[~enough], right[~enough]
        if 2 * len(left) > _MOST_INTERVALS:
            break
        middle = 0.5 * (left + right)
        left, right = np.concatenate([left, middle]), np.concatenate([middle, right])
    return Certificate(attained, np.inf, False)


def _bounds(
    errors: DrawnErrors, weight: TransferFunction, left: FloatArray, right: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Of each interval of angles: the ratio at its centre, and a bound on it within."""
    at_centre, bound = np.empty(len(left)), np.empty(len(left))
    step = max(1, _VALUES_AT_ONCE // len(errors.numerators))
    for first in range(0, len(left), step):
        part = slice(first, first + step)
        centre, half = 0.5 * (left[part] + right[part]), 0.5 * (right[part] - left[part])
        W = np.abs(weight.frequency_response(centre / errors.sample_time))
        least_W = W * _least_change(weight, left[part], right[part], centre)
        highest, above = _above(errors.numerators, centre, half)
        lowest, below = _below(errors.denominators, centre, half)
        with np.errstate(divide="ignore"):
            at_centre[part] = (above / below).max(axis=0) / W
            bound[part] = (highest / np.maximum(lowest, 0.0)).max(axis=0) / least_W
    return at_centre, bound


def _line(
    rows: FloatArray, centre: FloatArray, half: FloatArray
) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """F(c), h F'(c) and ½ h² Σ (k − k₀)² |a_k| of each row and interval."""
    k = np.arange(rows.shape[1]) - 0.5 * (rows.shape[1] - 1)
    phase = np.multiply.outer(k, centre)
    cosine, sine = np.cos(phase), np.sin(phase)
    turned = rows * k
    value = rows @ cosine - 1j * (rows @ sine)
    slope = -1j * (turned @ cosine) - turned @ sine
    return value, slope * half, np.multiply.outer(np.abs(rows) @ k**2, 0.5 * half**2)


def _above(rows: FloatArray, centre: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(bound from above, value at the centre) of |F|."""
    value, change, remainder = _line(rows, centre, half)
    # of a line the ends are furthest from zero
    ends = np.maximum(np.abs(value + change), np.abs(value - change))
    return ends + remainder, np.abs(value)


def _below(rows: FloatArray, centre: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(bound from below, value at the centre) of |F|."""
    value, change, remainder = _line(rows, centre, half)
    along = (change.conj() * value).real
    nearest = np.clip(-along / np.maximum(np.abs(change) ** 2, 1e-300), -1.0, 1.0)
    return np.abs(value + nearest * change) - remainder, np.abs(value)


def _least_change(
    weight: TransferFunction, left: FloatArray, right: FloatArray, centre: FloatArray
) -> FloatArray:
    """Bound from below of |W|/|W(c)| over the arc: each zero's least distance and each pole's
    largest one, over those from c.
    """
    least = np.ones(len(centre))
    for root in weight.zeros:
        cosine = np.maximum(np.cos(left - np.angle(root)), np.cos(right - np.angle(root)))
        cosine[(left <= np.angle(root)) & (np.angle(root) <= right)] = 1.0
        least *= _distance(root, cosine) / _distance(root, np.cos(centre - np.angle(root)))
    for root in weight.poles:
        opposite = np.angle(root) + np.pi
        cosine = np.minimum(np.cos(left - np.angle(root)), np.cos(right - np.angle(root)))
        cosine[(left <= opposite) & (opposite <= right)] = -1.0
        least *= _distance(root, np.cos(centre - np.angle(root))) / _distance(root, cosine)
    return least


def _distance(root: complex, cosine: FloatArray) -> FloatArray:
    """|e^{jθ} − r| from the cosine of the angle between them."""
    size = abs(root)
    return np.asarray(np.sqrt(np.maximum((1.0 - size) ** 2 + 2.0 * size * (1.0 - cosine), 1e-300)))


WEIGHT_ORDER = 2
"""Order of W_T where nothing else is asked for, as in the source."""
# a pole turns as sharply as so many lags
_LAGS_A_POLE = 20


@dataclass(frozen=True, eq=False)
class UncertaintyWeight:
    """W_T above the sampled error magnitudes Ω, and what the number of samples promises.

    Attributes
    ----------
    weight : TransferFunction
        Stable, proper, minimum phase; |weight| ≥ Ω at every ω, and on straight lines between them.
    omega, magnitude : array, shape (k,)
        ω [rad/s] and Ω(ω); dimensionless, or [output unit/input unit] for additive uncertainty.
    form : {"multiplicative", "additive", "inverse-multiplicative"}
        G = G₀(1 + Δ W), G₀ + Δ W, or G₀/(1 − Δ W) with |Δ| ≤ 1.
    n_samples : int
    promise : str
        What n_samples guarantees, in one sentence.
    certified : bool
        Whether |weight| ≥ Ω was proven at *every* frequency from the first of the grid to π/Ts
        (`weight_certificate`).
    """

    weight: TransferFunction
    omega: FloatArray
    magnitude: FloatArray
    form: str
    n_samples: int
    promise: str
    certified: bool = False

    @property
    def critical_frequency(self) -> float | None:
        """First frequency [rad/s] from which |weight| ≥ 1; None when it stays below."""
        crossed = np.flatnonzero(np.abs(self.weight.frequency_response(self.omega)) >= 1.0)
        return float(self.omega[crossed[0]]) if len(crossed) else None


def chernoff_samples(accuracy: float, confidence: float) -> int:
    """n ≥ ln(2/ζ)/(2ε²) with ε = `accuracy`, ζ = 1 − `confidence`; (2.24), (2.28), Hoeffding's
    inequality.

    Promises that the *fraction* of random models with any property fixed beforehand differs from
    its probability by less than ε, with confidence 1 − ζ. The source reads it as a bound on the gap
    between Ŵ_T and W_T; it is not.

    >>> chernoff_samples(0.05, 0.95), chernoff_samples(0.01, 0.95)
    (738, 18445)
    """
    _check_levels(accuracy, confidence)
    return math.ceil(math.log(2 / (1 - confidence)) / (2 * accuracy**2) - 1e-9)


def worst_case_samples(accuracy: float, confidence: float) -> int:
    """n ≥ ln(1/ζ)/ln(1/(1−ε)); Tempo, Bai, Dabbene, Systems & Control Letters 30 (1997) 237–242.

    Promises that one more random model exceeds the largest value among n with probability at most
    ε, with confidence 1 − ζ: the bound that suits Ω(ω), at each single frequency.

    >>> worst_case_samples(0.05, 0.95)
    59
    """
    _check_levels(accuracy, confidence)
    return math.ceil(math.log(1 / (1 - confidence)) / math.log(1 / (1 - accuracy)) - 1e-9)


def worst_case_accuracy(n_samples: int, confidence: float) -> float:
    """The ε that n samples promise for a worst case: 1 − ζ^{1/n}."""
    return -math.expm1(math.log(1 - confidence) / n_samples)


SAMPLE_SIZE_RULES: dict[str, Callable[[float, float], int]] = {
    "chernoff": chernoff_samples,
    "worst-case": worst_case_samples,
}


def design_uncertainty_weight(
    model: IdentifiedModel,
    *,
    omega: npt.ArrayLike | None = None,
    accuracy: float = 0.05,
    confidence: float = 0.95,
    rule: str = "chernoff",
    form: str = "multiplicative",
    order: int | None = None,
    seed: int = 0,
) -> UncertaintyWeight:
    """W_T(z) of an identified model (Algorithm 1).

    Parameters
    ----------
    model : IdentifiedModel
        Nominal model Ĝ₀ and the distribution that random models are drawn from.
    omega : array or None
        Frequencies [rad/s], increasing, up to π/Ts, that Ω is wanted at; None: over five and a half
        decades below π/Ts. The fit adds points until the envelope hides nothing between them
        (`refined_grid`), and the weight is then raised until it is proven above Ω between the
        points too (`largest_excess`).
    accuracy, confidence : float
        ε and 1 − ζ of the sample-size rule.
    rule : {"chernoff", "worst-case"}
        See `chernoff_samples` and `worst_case_samples`.
    form : {"multiplicative", "additive", "inverse-multiplicative"}
    order : int or None
        Order of the fitted weight; None: chosen by `fit_magnitude`.
    seed : int

    Raises
    ------
    BadModel
        The nominal response (or a random one, for the inverse form) is zero at a frequency, where a
        relative error means nothing.

    Examples
    --------
    >>> model = IdentifiedModel(method="by hand", sample_time=1.0, impulse_response=[1.0, 0.5],
    ...                         covariance=[[1e-4, 0], [0, 1e-4]], noise_variance=0.1)
    >>> weight = design_uncertainty_weight(model, rule="worst-case", order=1)
    >>> weight.n_samples, weight.promise
    (59, 'a further random model exceeds Ω at a given frequency with probability at most 0.05, with confidence 0.95')
    """
    if rule not in SAMPLE_SIZE_RULES or form not in FORMS:
        raise BadInput(
            f"uncertainty weight: rule {rule!r} must be one of {list(SAMPLE_SIZE_RULES)}, form"
            f" {form!r} one of {list(FORMS)}"
        )
    n_samples = SAMPLE_SIZE_RULES[rule](accuracy, confidence)
    errors = drawn_errors(model, n_samples, form=form, seed=seed)
    asked = None if omega is None else np.asarray(omega, dtype=float)
    frequencies, magnitude = refined_grid(
        errors.envelope, model.frequency_response, _lags(model), model.sample_time, asked
    )
    weight, proven = weight_above(errors, frequencies, magnitude, order)
    if asked is not None:
        frequencies, magnitude = asked, magnitude[np.searchsorted(frequencies, asked)]
    promise = _promise(rule, accuracy, confidence, n_samples)
    return UncertaintyWeight(weight, frequencies, magnitude, form, n_samples, promise, proven)


def weight_above(
    errors: DrawnErrors, omega: FloatArray, magnitude: FloatArray, order: int | None
) -> tuple[TransferFunction, bool]:
    """The weight fitted above Ω on a grid, raised until it is above the errors between the points
    too; whether that is proven.
    """
    weight = fit_magnitude(
        omega, magnitude, order=order, bound="above", sample_time=errors.sample_time
    )
    certificate = largest_excess(errors, weight, omega)
    factor = max(1.0, certificate.bound if certificate.proven else certificate.seen)
    return replace(weight, num=weight.num * factor), certificate.proven


def _lags(model: IdentifiedModel) -> int:
    """The highest power of z in the model's responses."""
    if model.is_parametric:
        transfer = model.transfer_function()
        return max(len(transfer.num), len(transfer.den)) * _LAGS_A_POLE
    return model.reach + model.delay


def drawn_errors(
    model: IdentifiedModel,
    n_samples: int,
    *,
    form: str = "multiplicative",
    seed: int | np.random.Generator = 0,
) -> DrawnErrors:
    """The errors of `n_samples` random models against the model itself."""
    return DrawnErrors.of(
        model.sample_polynomials(n_samples, seed), model.polynomials(), model.sample_time, form
    )


def _promise(rule: str, accuracy: float, confidence: float, n_samples: int) -> str:
    confident = f"with confidence {confidence:g}"
    if rule == "worst-case":
        return (
            "a further random model exceeds Ω at a given frequency with probability at most"
            f" {accuracy:g}, {confident}"
        )
    implied = worst_case_accuracy(n_samples, confidence)
    return (
        f"the fraction of random models with a property fixed beforehand is within {accuracy:g} of"
        f" its probability, {confident}; for Ω at a given frequency: exceeded with probability at"
        f" most {implied:.2g}"
    )


def _check_levels(accuracy: float, confidence: float) -> None:
    for name, value in (("accuracy", accuracy), ("confidence", confidence)):
        if not 0 < value < 1:
            raise BadInput(f"{name}: is {value}; must lie between 0 and 1")
