"""Identify a model of one structure and order, or let a criterion choose the order."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import one_thread_if_small
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.prediction_error.criterion import (
    Criterion,
    Orders,
    Polynomials,
)
from residuum.identification.linear_models.prediction_error.data import Signals, signals
from residuum.identification.linear_models.prediction_error.order_selection import (
    CRITERIA,
    Fold,
    block_folds,
    cross_validation,
    information,
    negative_log_likelihood,
    record_folds,
)
from residuum.identification.linear_models.prediction_error.result import (
    description,
    identified_model,
)
from residuum.identification.linear_models.prediction_error.search import (
    Minimum,
    best_fit,
    rough_fit,
)
from residuum.identification.linear_models.prediction_error.starts import FirstValues, Structure
from residuum.identification.linear_models.schur import is_schur
from residuum.identification.record import Record
from residuum.nearest_names import known_names


def identify(
    structure: Structure,
    records: Sequence[Record],
    input: str | None,
    output: str,
    *,
    order: int | None = None,
    orders: Orders | None = None,
    delay: int = 1,
    offset: bool = True,
    criterion: str = "bic",
    candidates: Iterable[int] = range(1, 11),
    folds: int = 5,
) -> IdentifiedModel:
    """Minimise the prediction error of one structure over the records.

    θ̂ = arg min (1/n) Σ e(t, θ)²,   cov θ̂ = σ̂² (Σ ψψᵀ)⁻¹ with ψ = −∂e/∂θ   — (1.101), (1.104) of the source

    Parameters
    ----------
    structure : Structure
        A member of `STRUCTURES`.
    order, orders : int or Orders
        One number for the structure, or all polynomial orders; neither: the candidate with the
        smallest criterion.
    delay : int
        Samples before the input acts (ignored with `orders`).
    offset : bool
        Estimate a constant level of the output as well.
    criterion : {"bic", "aic", "k-fold", "record-wise"}
        What chooses among the candidates: information, or the error on held-out blocks or records;
        see `order_selection`.
    folds : int
        Blocks of each record with `k-fold`.

    Raises
    ------
    BadRecord
        Missing samples, records that differ in sample time.
    NotIdentifiable
        Fewer samples than five a parameter, an input that does not excite the order (the message
        says which it supports).
    BadInput
        Unknown criterion.

    Notes
    -----
    The covariance holds for the right structure only: a model of too low an order has a bias that
    it does not show.
    """
    started = time.perf_counter()
    if criterion not in CRITERIA:
        raise BadInput(
            f"criterion {criterion!r}: {known_names(criterion, CRITERIA, 'must be one of')}"
        )
    data = signals(records, input if structure.has_input else None, output, offset=offset)
    numbers = candidates if order is None else [order]
    wanted = (
        [orders] if orders is not None else [structure.orders(number, delay) for number in numbers]
    )
    with one_thread_if_small(max(o.count for o in wanted) + 200):
        held_out = _folds(data, criterion, folds) if len(wanted) > 1 else []
        possible = _possible(wanted, data, held_out, records)
        if structure.has_input:
            _check_excitation(data, min(o.nb + max(o.na, o.nf) for o in possible), input)
        longest = max(max(o.nf, o.na, o.nb) for o in possible)
        first = FirstValues(data, possible[0].delay, longest)
        scores = _scores(structure, data, held_out, possible, first, criterion, offset)
        best = int(np.argmin(scores)) if scores.size else 0
        fit = best_fit(structure, data, possible[best], first, offset=offset)
    described = description(structure, records, input, output, possible[best], fit.normal.n)
    described["warnings"] = _warnings(fit, possible[best])
    described["provenance"] |= {"seconds": time.perf_counter() - started, "criterion": criterion}
    if scores.size:
        described["provenance"] |= {
            "candidates": [str(o) for o in possible],
            criterion: scores.tolist(),
        }
    return _finish(data, fit, possible[best], described, offset)


def _scores(
    structure: Structure,
    data: Signals,
    held_out: Sequence[Fold],
    possible: Sequence[Orders],
    first: FirstValues,
    criterion: str,
    offset: bool,
) -> FloatArray:
    """The criterion of each candidate; none where there is no choice."""
    if held_out:
        return cross_validation(structure, held_out, possible, offset=offset)
    if len(possible) == 1:
        return np.zeros(0)
    # information compares candidates by a rough fit each; only the chosen one is fitted to the end
    fits = [rough_fit(structure, data, orders, first, offset=offset) for orders in possible]
    return np.array(
        [
            information(fit, orders, data.n)[criterion]
            for fit, orders in zip(fits, possible, strict=True)
        ]
    )


def _folds(data: Signals, criterion: str, count: int) -> list[Fold]:
    """The folds of a cross-validation criterion, none of an information criterion."""
    return {
        "k-fold": lambda: block_folds(data, count),
        "record-wise": lambda: record_folds(data),
    }.get(criterion, list)()


def _possible(
    wanted: Sequence[Orders], data: Signals, held_out: Sequence[Fold], records: Sequence[Record]
) -> list[Orders]:
    """The orders that the data can determine; NotIdentifiable when there is none."""
    enough = [orders for orders in wanted if data.n >= 5 * orders.count]
    where = records[0].source or "record"
    if not enough:
        least = min(orders.count for orders in wanted)
        raise NotIdentifiable(
            f"{where}: has {data.n} samples; {least} parameters need at least {5 * least}: record"
            " longer, or take a smaller order"
        )
    possible = [orders for orders in enough if all(fold.allows(orders) for fold in held_out)]
    if not possible:
        raise NotIdentifiable(
            f"{where}: cross-validation leaves too few samples for any candidate; use fewer folds"
            " or BIC"
        )
    return possible


def _warnings(fit: Minimum, orders: Orders) -> tuple[str, ...]:
    says = []
    if not fit.converged:
        says.append("the search stopped before it converged; the covariance is not to be trusted")
    # F is kept stable by the search, A is not
    if orders.nb and not is_schur(Polynomials.from_vector(fit.x, orders).a):
        pole = max(np.roots(Polynomials.from_vector(fit.x, orders).a), key=abs)
        says.append(
            f"the model has a pole of size {abs(pole):.4g}, on or outside the unit circle: it"
            " predicts, but a simulation with it diverges"
        )
    return tuple(says)


def _finish(
    data: Signals, fit: Minimum, orders: Orders, described: Mapping[str, Any], offset: bool
) -> IdentifiedModel:
    """Unscale; the degrees of freedom of level and free responses are taken from the variance."""
    n, p = fit.normal.n, len(fit.x)
    variance = fit.normal.cost / max(n - p, 1)
    covariance = variance * _inverse(fit.normal.gram)[: orders.count, : orders.count]
    polynomials = Criterion(data, orders, level=offset).polynomials(fit.x)
    level = float(fit.x[orders.count]) if offset else 0.0
    unscaled = n * float(np.log(data.y_scale))
    extra = {name: value + 2 * unscaled for name, value in information(fit, orders, n).items()}
    extra["negative_log_likelihood"] = negative_log_likelihood(fit, n) + unscaled
    return identified_model(polynomials, covariance, variance, level, data, {**described, **extra})


def _inverse(gram: FloatArray) -> FloatArray:
    """The inverse of a Gram matrix; directions that the data do not tell have a variance as large
    as double precision can say.
    """
    size = np.diag(gram)
    scale = np.sqrt(np.maximum(size, 1e-30 * max(float(size.max(initial=0.0)), 1e-270)))
    eigenvalues, axes = np.linalg.eigh(gram / np.outer(scale, scale))
    floored = np.maximum(eigenvalues, 1e-13 * max(float(eigenvalues[-1]), 1e-300))
    return np.asarray((axes / floored) @ axes.T / np.outer(scale, scale))


def _check_excitation(data: Signals, needed: int, input: str | None) -> None:
    """Refuse an input whose lagged copies are linearly dependent before `needed` of them are
    reached.
    """
    size = min(max(needed, 1), 40)
    gram = np.zeros((size, size))
    for u, _ in data.pairs:
        if len(u) <= size:
            continue
        lagged = np.lib.stride_tricks.sliding_window_view(u, size)
        gram += lagged.T @ lagged
    eigenvalues = np.linalg.eigvalsh(gram)
    supported = int(np.sum(eigenvalues > 1e-10 * max(float(eigenvalues[-1]), 1e-300)))
    if supported < size:
        raise NotIdentifiable(
            f"channel {input!r}: excites {supported} parameters; this order needs {needed}; lower"
            " the order"
        )
