"""Identification of an impulse response from a bound on the noise alone: set membership, (1.115)–(1.123) of the source.

    y(t) = Σ_{i=0}^{m−1} g_i u(t − delay − i) + level + e(t),   |e(t)| ≤ ν for every t

Every g that all samples allow is possible, none is likelier than another. The estimate is the centre of the tightest intervals,
which no other beats in its worst case; the true g_i is inside, whatever the noise does within its bound.

Assumes that the bound holds for every sample. Fails where it does not: one outlier empties the set (then the smallest bound that
leaves a response is told) or, with a bound made from the data, cuts the truth off; and where the response outlasts m lags, which
is noise to this method. Bounds grow wider than confidence bands, since they allow for noise that conspires.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.kernel_based.lagged_data import lagged_data
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.set_membership import feasible_set
from residuum.identification.record import Record

LAGS, MOST_LAGS = 20, 60
"""Length of the response that nobody chose, and the longest: each coefficient costs two linear programs."""
_ROWS = 4000
_ROOM = 1.1


def identify_set_membership(
    records: Sequence[Record],
    input: str,
    output: str,
    *,
    order: int | None = None,
    delay: int = 1,
    noise_bound: float | None = None,
    offset: bool = True,
) -> IdentifiedModel:
    """The centre of all impulse responses that noise below a bound allows.

    Parameters
    ----------
    records : sequence of Record
        Of over 4000 complete rows, 4000 evenly spaced ones count: fewer constraints allow more, never less.
    order : int or None
        m; None: 20.
    noise_bound : float or None
        ν [output unit]; None: 1.1 times the smallest that leaves any response.

    Returns
    -------
    IdentifiedModel
        `impulse_response` is the centre c, `covariance` diag(r²/3), that of a uniform spread over the intervals c ± r: they end
        √3 standard deviations from the centre. `hyper_parameters` holds `noise_bound` and `smallest_noise_bound`.

    Raises
    ------
    BadInput
        An order over 60, a bound that is not positive.
    NotIdentifiable
        Too few rows, an input that does not move, a bound that nothing agrees with; says the smallest that something does.
    """
    started = time.perf_counter()
    m = LAGS if order is None else order
    if not 1 <= m <= MOST_LAGS:
        raise BadInput(f"set-membership, order: is {m}; must be 1 to {MOST_LAGS}, for each coefficient costs two linear programs")
    data = lagged_data(records, [input], output, m, delay, offset=offset)
    Phi, y = _rows(records, input, output, m, delay)
    if offset:
        Phi = np.column_stack([Phi, np.ones(len(y))])
    if len(y) < 2 * Phi.shape[1]:
        raise NotIdentifiable(
            f"set-membership: {len(y)} complete rows for {m} coefficients; at least {2 * Phi.shape[1]} are needed: record "
            "longer, or take a smaller order"
        )
    smallest = feasible_set(Phi, y, 1e-12 * (float(np.abs(y).max()) or 1.0)).smallest_bound
    bound = _ROOM * smallest if noise_bound is None else noise_bound
    found = feasible_set(Phi, y, bound)
    unit = f" {data.output_unit}" if data.output_unit else ""
    if found.empty:
        raise NotIdentifiable(
            f"set-membership: with noise of at most {bound:.4g}{unit} no impulse response of {m} coefficients agrees with the "
            f"records; the smallest bound that leaves one is {smallest:.4g}{unit}"
        )
    residual = y - Phi @ found.centre
    lasts = abs(found.centre[m - 1]) > found.radius[m - 1]
    return IdentifiedModel(
        method="set-membership",
        sample_time=data.sample_time,
        impulse_response=found.centre[:m],
        covariance=np.diag(found.radius[:m] ** 2 / 3.0),
        noise_variance=float(np.mean(residual**2)),
        input_name=input,
        input_unit=data.input_units[0],
        output_name=output,
        output_unit=data.output_unit,
        delay=delay,
        offset=float(found.centre[m]) if offset else 0.0,
        hyper_parameters={"noise_bound": float(bound), "smallest_noise_bound": smallest},
        warnings=_said(bound, smallest, unit, given=noise_bound is not None, outlasts=m if lasts else None),
        provenance={"records": [record.source for record in records], "n": len(y), "seconds": time.perf_counter() - started},
    )


def _said(bound: float, smallest: float, unit: str, *, given: bool, outlasts: int | None) -> tuple[str, ...]:
    known = f"the smallest bound possible is {smallest:.4g}{unit}" if given else "the bound is 1.1 times the smallest possible"
    says = [
        f"set membership: if the noise is at most {bound:.4g}{unit} in every sample, each coefficient lies within √3 of its "
        f"standard deviations for certain; {known}"
    ]
    if outlasts is not None:
        says.append(f"the response has not decayed within {outlasts} lags; what lies beyond counts as noise: take a larger order")
    return tuple(says)


def _rows(records: Sequence[Record], input: str, output: str, m: int, delay: int) -> tuple[FloatArray, FloatArray]:
    """Lagged inputs (n, m) and outputs (n,) of all complete rows, at most 4000 evenly spaced ones."""
    rows, targets = [], []
    for record in records:
        u, y = np.asarray(record[input], dtype=float), np.asarray(record[output], dtype=float)
        first = delay + m - 1
        if len(y) <= first:
            continue
        past = np.lib.stride_tricks.sliding_window_view(u[: len(u) - delay], m)[:, ::-1]
        known = np.isfinite(past).all(axis=1) & np.isfinite(y[first:])
        rows.append(past[known])
        targets.append(y[first:][known])
    Phi, y = np.concatenate(rows), np.concatenate(targets)
    kept = np.unique(np.linspace(0, len(y) - 1, min(len(y), _ROWS)).round().astype(int)) if len(y) else np.zeros(0, dtype=int)
    return Phi[kept], y[kept]
