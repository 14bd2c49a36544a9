"""Ridge, lasso and elastic-net regression of FIR and ARX models, the penalty chosen by blocked
cross-validation.

    ridge         θ̂ = arg min Σ (y − φᵀθ)² + λ ‖θ‖₂²
    lasso         θ̂ = arg min Σ (y − φᵀθ)² / (2n) + λ ‖θ‖₁
    elastic net   θ̂ = arg min Σ (y − φᵀθ)² / (2n) + λ (ρ ‖θ‖₁ + (1 − ρ)/2 ‖θ‖₂²),   ρ between .1 and .9 by cross-validation, too

Signals are scaled to unit power first, so that one λ serves all coefficients. (A.8)–(A.13) of the
source, appendix A.3.

A ridge treats the first lag like the last; the kernels (`identify_impulse_response`) know that a
stable response decays, and do better on FIR models. The lasso is for responses of which few lags
matter (pure delays, echoes, sparse couplings); of neighbouring lags that a slow input hardly tells
apart it keeps one at random, where the elastic net (H. Zou, T. Hastie, J. Royal Stat. Soc. B 67,
2005) keeps them together. All three shrink: where noise is small beside the response, least squares
is nearer to the truth.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import ElasticNet, ElasticNetCV, Lasso, LassoCV, Ridge, RidgeCV

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import one_thread_if_small
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.prediction_error.criterion import Orders, Polynomials
from residuum.identification.linear_models.prediction_error.data import Signals, signals
from residuum.identification.linear_models.prediction_error.order_selection import block_folds
from residuum.identification.linear_models.prediction_error.result import (
    description,
    identified_model,
)
from residuum.identification.linear_models.prediction_error.starts import regression
from residuum.identification.linear_models.prediction_error.structures import ARX, FIR
from residuum.identification.record import Record
from residuum.nearest_names import known_names

IntArray = npt.NDArray[np.intp]

PENALTIES = ("ridge", "lasso", "elastic-net")
# λ that cross-validation chooses from
_STRENGTHS = {
    "ridge": np.geomspace(1e-4, 1e6, 21),
    "lasso": np.geomspace(1e-6, 1.0, 49),
    "elastic-net": np.geomspace(1e-6, 1.0, 25),
}
# ρ that cross-validation chooses from
_MIXES = (0.1, 0.5, 0.9)
_SWEEPS = 20_000  # of coordinate descent, at most


@dataclass(frozen=True, eq=False)
class _Fit:
    """θ, level, λ, covariance over σ², degrees of freedom, warnings, ρ of an elastic net; in scaled
    units.
    """

    theta: FloatArray
    level: float
    strength: float
    covariance: FloatArray
    freedom: float
    warnings: tuple[str, ...]
    mix: float | None = None


def identify_regularised(
    records: Sequence[Record],
    input: str,
    output: str,
    *,
    orders: Orders,
    penalty: str = "ridge",
    strength: float | None = None,
    mix: float | None = None,
    offset: bool = True,
    folds: int = 5,
) -> IdentifiedModel:
    """Identify an FIR (`na` = 0) or ARX model by least squares with a penalty on its coefficients.

    Parameters
    ----------
    records : sequence of Record
        Complete; regressors do not reach across their seams.
    orders : Orders
        Of A and B only. More coefficients than samples are allowed: the penalty determines them.
    penalty : {"ridge", "lasso", "elastic-net"}
    strength : float or None
        λ for signals of unit power; None: the smallest mean square error on held-out blocks of
        time.
    mix : float or None
        ρ of the elastic net, 0 < ρ ≤ 1; None: chosen with the strength, .5 where that is given.
    offset : bool
        Estimate a constant level as well (it is not penalised).
    folds : int
        Contiguous blocks of each record; rows that share samples with the held-out block are left
        out of the fit.

    Returns
    -------
    IdentifiedModel
        `hyper_parameters` holds `strength` and `degrees_of_freedom`. Its covariance is, for the
        ridge, that of the posterior with the prior θ ~ N(0, σ²/λ); for the lasso, that of least
        squares on the coefficients it kept, and for the elastic net that of a ridge on them, as if
        they had been known beforehand: too small, and the model's warnings say so.

    Raises
    ------
    BadInput
        Unknown penalty, orders with F, C or D, a strength that is not positive, a mix outside (0,
        1] or of another penalty.
    BadRecord, NotIdentifiable
        As `identify`; records too short for the regressor or the folds.

    >>> rng = np.random.default_rng(0)
    >>> u = rng.normal(size=400)
    >>> y = 2.0 * np.r_[np.zeros(7), u[:-7]] + 0.1 * rng.normal(size=400)
    >>> record = Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0)
    >>> model = identify_regularised([record], "u", "y", orders=Orders(nb=30), penalty="lasso")
    >>> int(np.argmax(np.abs(model.impulse_response))) + model.delay
    7
    """
    started = time.perf_counter()
    _check(orders, penalty, strength, mix)
    data = signals(records, input, output, offset=offset)
    where = records[0].source or "record"
    if min(len(y) for _, y in data.pairs) < orders.memory + 10:
        raise NotIdentifiable(
            f"{where}: every record needs {orders.memory + 10} samples, ten beyond the reach of the"
            " regressor; record longer, or take a smaller order"
        )
    phi, target = regression(data, orders)
    splits = _splits(data, orders, folds) if strength is None else []
    with one_thread_if_small(phi.shape[1]):
        if penalty == "elastic-net":
            fit = _elastic_net(phi, target, splits, strength, mix, offset)
        else:
            fit = (_ridge if penalty == "ridge" else _lasso)(phi, target, splits, strength, offset)
    residual = target - phi @ fit.theta - fit.level
    n = len(target)
    variance = float(residual @ residual) / max(n - fit.freedom - int(offset), 1.0)
    described = description(ARX() if orders.na else FIR(), records, input, output, orders, n)
    described["method"] = f"{described['method']}-{penalty}"
    described["warnings"] = fit.warnings
    described["hyper_parameters"] = {"strength": fit.strength, "degrees_of_freedom": fit.freedom}
    if fit.mix is not None:
        described["hyper_parameters"]["mix"] = fit.mix
    described["provenance"] |= {"seconds": time.perf_counter() - started}
    # y = φᵀθ + level is A (y − y₀) = B u: y₀ = level / A(1)
    polynomials = Polynomials.from_vector(fit.theta, orders)
    return identified_model(
        polynomials,
        variance * fit.covariance,
        variance,
        fit.level / float(polynomials.a.sum()),
        data,
        described,
    )


def _check(orders: Orders, penalty: str, strength: float | None, mix: float | None) -> None:
    if penalty not in PENALTIES:
        raise BadInput(f"penalty {penalty!r}: {known_names(penalty, PENALTIES, 'must be one of')}")
    if orders.nb == 0 or (orders.nf, orders.nc, orders.nd) != (0, 0, 0):
        raise BadInput(
            f"regularised regression: orders are {orders}; must have B, may have A, nothing else"
        )
    if strength is not None and not (np.isfinite(strength) and strength > 0):
        raise BadInput(f"strength {strength!r}: must be a positive number")
    if mix is not None and not (penalty == "elastic-net" and 0 < mix <= 1):
        raise BadInput(f"mix {mix!r}: belongs to the elastic net, and must lie between 0 and 1")


def _splits(data: Signals, orders: Orders, count: int) -> list[tuple[IntArray, IntArray]]:
    """(training rows, held-out rows) of each fold; a training row shares no sample with the
    held-out block.
    """
    reach = orders.memory
    # sample that each row explains, record by record
    row = [np.arange(reach, len(y)) for _, y in data.pairs]
    splits = []
    block_folds(data, count)  # refuses blocks that are too short
    for k in range(count):
        held_out, training = [], []
        for samples, (_, y) in zip(row, data.pairs, strict=True):
            start, stop = k * len(y) // count, (k + 1) * len(y) // count
            held_out.append((samples >= start) & (samples < stop))
            training.append((samples < start) | (samples >= stop + reach))
        splits.append(
            (np.flatnonzero(np.concatenate(training)), np.flatnonzero(np.concatenate(held_out)))
        )
    usable = [
        (training, held_out) for training, held_out in splits if len(training) and len(held_out)
    ]
    if len(usable) < 2:
        raise NotIdentifiable(
            f"{count} folds: the regressor reaches back {reach} samples and leaves none; give the"
            " strength"
        )
    return usable


def _ridge(
    phi: FloatArray,
    target: FloatArray,
    splits: list[tuple[IntArray, IntArray]],
    strength: float | None,
    offset: bool,
) -> _Fit:
    if strength is None:
        search = RidgeCV(
            _STRENGTHS["ridge"], fit_intercept=offset, cv=splits, scoring="neg_mean_squared_error"
        )
        strength = float(search.fit(phi, target).alpha_)
    ridge = Ridge(strength, fit_intercept=offset).fit(phi, target)
    centred = phi - phi.mean(axis=0) if offset else phi
    _, singular, axes = np.linalg.svd(centred, full_matrices=False)
    # in directions that no row reaches the posterior is the prior, of variance 1/λ
    unseen = np.eye(phi.shape[1]) - axes.T @ axes
    covariance = (axes.T / (singular**2 + strength)) @ axes + unseen / strength
    freedom = float(np.sum(singular**2 / (singular**2 + strength)))
    return _Fit(
        np.asarray(ridge.coef_),
        float(ridge.intercept_),
        strength,
        covariance,
        freedom,
        _at_edge("ridge", strength),
    )


def _lasso(
    phi: FloatArray,
    target: FloatArray,
    splits: list[tuple[IntArray, IntArray]],
    strength: float | None,
    offset: bool,
) -> _Fit:
    """Degrees of freedom: the number of coefficients kept (H. Zou, T. Hastie, R. Tibshirani, Annals
    of Statistics 35, 2007).
    """
    says = [
        "the covariance takes the lags that the lasso kept as known beforehand; it is too small"
    ]
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always", ConvergenceWarning)
        if strength is None:
            search = LassoCV(
                alphas=_STRENGTHS["lasso"], fit_intercept=offset, cv=splits, max_iter=_SWEEPS
            )
            strength = float(search.fit(phi, target).alpha_)
        # a weak penalty that did not converge while searching is of no consequence unless it is the
        # one chosen
        raised.clear()
        lasso = Lasso(strength, fit_intercept=offset, max_iter=_SWEEPS).fit(phi, target)
    if any(issubclass(warning.category, ConvergenceWarning) for warning in raised):
        says.append("the lasso did not converge; its coefficients are not to be trusted")
    theta = np.asarray(lasso.coef_)
    active = np.flatnonzero(theta)
    centred = (phi - phi.mean(axis=0) if offset else phi)[:, active]
    covariance = np.zeros((len(theta), len(theta)))
    covariance[np.ix_(active, active)] = np.linalg.pinv(centred.T @ centred, hermitian=True)
    says += _at_edge("lasso", strength)
    return _Fit(
        theta, float(lasso.intercept_), strength, covariance, float(len(active)), tuple(says)
    )


def _elastic_net(
    phi: FloatArray,
    target: FloatArray,
    splits: list[tuple[IntArray, IntArray]],
    strength: float | None,
    mix: float | None,
    offset: bool,
) -> _Fit:
    """Degrees of freedom: tr Φ_A (Φ_AᵀΦ_A + nλ(1 − ρ) I)⁻¹ Φ_Aᵀ of the coefficients A that it kept.

    R. J. Tibshirani, J. Taylor, Annals of Statistics 40 (2012).
    """
    says = [
        "the covariance takes the lags that the elastic net kept as known beforehand; it is too"
        " small"
    ]
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always", ConvergenceWarning)
        if strength is None:
            mixes = _MIXES if mix is None else (mix,)
            search = ElasticNetCV(
                l1_ratio=list(mixes),
                alphas=_STRENGTHS["elastic-net"],
                fit_intercept=offset,
                cv=splits,
                max_iter=_SWEEPS,
            ).fit(phi, target)
            strength, mix = float(search.alpha_), float(search.l1_ratio_)
        mix = 0.5 if mix is None else mix
        raised.clear()
        net = ElasticNet(strength, l1_ratio=mix, fit_intercept=offset, max_iter=_SWEEPS).fit(
            phi, target
        )
    if any(issubclass(warning.category, ConvergenceWarning) for warning in raised):
        says.append("the elastic net did not converge; its coefficients are not to be trusted")
    theta = np.asarray(net.coef_)
    active = np.flatnonzero(theta)
    centred = (phi - phi.mean(axis=0) if offset else phi)[:, active]
    gram = centred.T @ centred
    inverse = np.linalg.pinv(
        gram + len(target) * strength * (1 - mix) * np.eye(len(active)), hermitian=True
    )
    covariance = np.zeros((len(theta), len(theta)))
    covariance[np.ix_(active, active)] = inverse
    says += _at_edge("elastic-net", strength)
    return _Fit(
        theta,
        float(net.intercept_),
        strength,
        covariance,
        float(np.sum(inverse * gram)),
        tuple(says),
        mix,
    )


def _at_edge(penalty: str, strength: float) -> tuple[str, ...]:
    """A warning when cross-validation would have gone on to a stronger penalty."""
    if strength < _STRENGTHS[penalty][-1]:
        return ()
    return (
        (
            f"cross-validation chose the strongest penalty tried, {strength:g}: the input explains"
            " next to nothing"
        ),
    )
