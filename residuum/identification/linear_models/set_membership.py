"""Set membership: all parameters that bounded noise leaves possible."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.kernel_based.lagged_data import lagged_data
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.record import Record


@dataclass(frozen=True, eq=False)
class FeasibleSet:
    """What is known of β when y = Φβ + e and the noise is bounded.

    Attributes
    ----------
    norm : "inf" or "2"
        Of the bound on e.
    bound : float
        ε, in the output's unit.
    smallest_bound : float
        The smallest ε for which any β is possible; larger than `bound` when the set is empty.
    lower, upper : array, shape (p,)
        Tightest interval of each parameter (NaN when the set is empty).
    """

    norm: str
    bound: float
    smallest_bound: float
    lower: FloatArray
    upper: FloatArray

    @property
    def empty(self) -> bool:
        """True when no parameter vector agrees with the data: the bound or the structure is
        wrong.
        """
        return self.smallest_bound > self.bound

    @property
    def centre(self) -> FloatArray:
        """Central estimate (β^u + β^l)/2, shape (p,): the smallest worst-case error in every
        parameter, (1.123) corrected.
        """
        return (self.upper + self.lower) / 2

    @property
    def radius(self) -> FloatArray:
        """Half widths: |centre − β_true| is at most this, (1.119); shape (p,)."""
        return (self.upper - self.lower) / 2


def feasible_set(
    Phi: npt.ArrayLike, y: npt.ArrayLike, bound: float, *, norm: str = "inf"
) -> FeasibleSet:
    """The feasible parameter set of a linear regression with bounded noise.

    ∞-norm, |e_t| ≤ ε for every t: a polytope; its intervals (1.120)–(1.121) are 2p linear programs,
    and the smallest feasible bound is the Chebyshev fit. 2-norm, ‖e‖ ≤ ε: an ellipsoid about least
    squares, β_ls ± √((ε² − ‖y − Φβ_ls‖²) (ΦᵀΦ)⁻¹_jj).

    Parameters
    ----------
    Phi : array, shape (n, p)
    y : array, shape (n,)
    bound : float
        ε > 0, in the unit of y.
    norm : "inf" or "2"

    Raises
    ------
    BadInput
        Shapes that do not fit, missing or infinite values, a bound that is not positive, unknown
        norm.
    NotIdentifiable
        Fewer rows than parameters, or dependent columns: the set is unbounded.

    References
    ----------
    M. Milanese, A. Vicino, *Optimal estimation theory for dynamic systems with set membership
    uncertainty*, Automatica 27 (1991).

    Examples
    --------
    >>> found = feasible_set([[1.0], [1.0], [1.0]], [1.1, 0.9, 1.0], bound=0.3)
    >>> found.empty, found.lower.round(6).tolist(), found.upper.round(6).tolist(), round(found.smallest_bound, 6)
    (False, [0.8], [1.2], 0.1)
    """
    Phi, y = _checked(Phi, y, bound, norm)
    scale = np.linalg.norm(Phi, axis=0)
    if (
        Phi.shape[0] < Phi.shape[1]
        or np.linalg.matrix_rank(Phi / np.where(scale > 0, scale, 1.0)) < Phi.shape[1]
    ):
        raise NotIdentifiable(
            f"feasible_set: {Phi.shape[1]} parameters are not determined by these {Phi.shape[0]}"
            " rows"
        )
    solve = _polytope if norm == "inf" else _ellipsoid
    smallest, lower, upper = solve(Phi / scale, y, bound)
    return FeasibleSet(norm, float(bound), smallest, lower / scale, upper / scale)


def _ellipsoid(
    Phi: FloatArray, y: FloatArray, bound: float
) -> tuple[float, FloatArray, FloatArray]:
    beta = np.linalg.lstsq(Phi, y, rcond=None)[0]
    smallest = float(np.linalg.norm(y - Phi @ beta))
    if smallest > bound:
        return smallest, *_nothing(Phi)
    half: FloatArray = np.sqrt((bound**2 - smallest**2) * np.diag(np.linalg.inv(Phi.T @ Phi)))
    return smallest, np.subtract(beta, half), np.add(beta, half)


def _polytope(Phi: FloatArray, y: FloatArray, bound: float) -> tuple[float, FloatArray, FloatArray]:
    p = Phi.shape[1]
    size = float(np.abs(y).max()) or 1.0
    A, b = np.vstack([Phi, -Phi]), np.concatenate([y, -y]) / size
    chebyshev = linprog(
        np.r_[np.zeros(p), 1.0],
        A_ub=np.c_[A, -np.ones(len(A))],
        b_ub=b,
        bounds=[(None, None)] * p + [(0, None)],
    )
    smallest = float(chebyshev.x[-1]) * size
    if smallest > bound:
        return smallest, *_nothing(Phi)
    room = b + bound / size
    ends = np.array([[_extreme(A, room, j, sign) for j in range(p)] for sign in (1.0, -1.0)]) * size
    return smallest, ends[0], ends[1]


def _extreme(A: FloatArray, room: FloatArray, j: int, sign: float) -> float:
    """The smallest (sign 1) or largest (sign −1) β_j with A β ≤ room."""
    cost = np.zeros(A.shape[1])
    cost[j] = sign
    return float(linprog(cost, A_ub=A, b_ub=room, bounds=[(None, None)] * A.shape[1]).x[j])


def _nothing(Phi: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.full(Phi.shape[1], np.nan), np.full(Phi.shape[1], np.nan)


def _checked(
    Phi: npt.ArrayLike, y: npt.ArrayLike, bound: float, norm: str
) -> tuple[FloatArray, FloatArray]:
    Phi, y = np.asarray(Phi, dtype=float), np.asarray(y, dtype=float)
    if norm not in ("inf", "2"):
        raise BadInput(f"feasible_set, norm: is {norm!r}; must be 'inf' or '2'")
    if not (np.isfinite(bound) and bound > 0):
        raise BadInput(f"feasible_set, bound: is {bound!r}; must be a positive number")
    if Phi.ndim != 2 or y.shape != Phi.shape[:1]:
        raise BadInput(
            f"feasible_set: Phi has shape {Phi.shape} and y {y.shape}; must be (n, p) and (n,)"
        )
    if not (np.isfinite(Phi).all() and np.isfinite(y).all()):
        raise BadInput("feasible_set: Phi and y must have no missing or infinite value")
    return Phi, y


# Identification of an impulse response from a bound on the noise alone: set membership,
# (1.115)–(1.123) of the source.
# y(t) = Σ_{i=0}^{m−1} g_i u(t − delay − i) + level + e(t), |e(t)| ≤ ν for every t
# Every g that all samples allow is possible, none is likelier than another. The estimate is the
# centre of the tightest intervals, which no other beats in its worst case; the true g_i is
# inside, whatever the noise does within its bound.
# Assumes that the bound holds for every sample. Fails where it does not: one outlier empties the
# set (then the smallest bound that leaves a response is told) or, with a bound made from the
# data, cuts the truth off; and where the response outlasts m lags, which is noise to this method.
# Bounds grow wider than confidence bands, since they allow for noise that conspires.

LAGS, MOST_LAGS = 20, 60
"""Length of the response that nobody chose, and the longest: each coefficient costs two linear
programs.
"""
_ROWS = 4000  # that count, at most
_ROOM = 1.1  # times the smallest bound that leaves any response: the bound that nobody chose


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
        Of over 4000 complete rows, 4000 evenly spaced ones count: fewer constraints allow more,
        never less.
    order : int or None
        m; None: 20.
    noise_bound : float or None
        ν [output unit]; None: 1.1 times the smallest that leaves any response.

    Returns
    -------
    IdentifiedModel
        `impulse_response` is the centre c, `covariance` diag(r²/3), that of a uniform spread over
        the intervals c ± r: they end √3 standard deviations from the centre. `hyper_parameters`
        holds `noise_bound` and `smallest_noise_bound`.

    Raises
    ------
    BadInput
        An order over 60, a bound that is not positive.
    NotIdentifiable
        Too few rows, an input that does not move, a bound that nothing agrees with; says the
        smallest that something does.
    """
    started = time.perf_counter()
    m = LAGS if order is None else order
    if not 1 <= m <= MOST_LAGS:
        raise BadInput(
            f"set-membership, order: is {m}; must be 1 to {MOST_LAGS}, for each coefficient costs"
            " two linear programs"
        )
    data = lagged_data(records, [input], output, m, delay, offset=offset)
    Phi, y = _rows(records, input, output, m, delay)
    if offset:
        Phi = np.column_stack([Phi, np.ones(len(y))])
    if len(y) < 2 * Phi.shape[1]:
        raise NotIdentifiable(
            f"set-membership: {len(y)} complete rows for {m} coefficients; at least"
            f" {2 * Phi.shape[1]} are needed: record longer, or take a smaller order"
        )
    # a bound that nothing meets: the Chebyshev fit tells the smallest one, no interval is computed
    smallest = feasible_set(Phi, y, 1e-12 * (float(np.abs(y).max()) or 1.0)).smallest_bound
    bound = _ROOM * smallest if noise_bound is None else noise_bound
    feasible = feasible_set(Phi, y, bound)
    unit = f" {data.output_unit}" if data.output_unit else ""
    if feasible.empty:
        raise NotIdentifiable(
            f"set-membership: with noise of at most {bound:.4g}{unit} no impulse response of {m}"
            " coefficients agrees with the records; the smallest bound that leaves one is"
            f" {smallest:.4g}{unit}"
        )
    residual = y - Phi @ feasible.centre
    # the last coefficient is not zero for certain
    lasts = abs(feasible.centre[m - 1]) > feasible.radius[m - 1]
    return IdentifiedModel(
        method="set-membership",
        sample_time=data.sample_time,
        impulse_response=feasible.centre[:m],
        covariance=np.diag(feasible.radius[:m] ** 2 / 3.0),
        noise_variance=float(np.mean(residual**2)),
        input_name=input,
        input_unit=data.input_units[0],
        output_name=output,
        output_unit=data.output_unit,
        delay=delay,
        offset=float(feasible.centre[m]) if offset else 0.0,
        hyper_parameters={"noise_bound": float(bound), "smallest_noise_bound": smallest},
        warnings=_warnings(
            bound, smallest, unit, given=noise_bound is not None, outlasts=m if lasts else None
        ),
        provenance={
            "records": [record.source for record in records],
            "n": len(y),
            "seconds": time.perf_counter() - started,
        },
    )


def _warnings(
    bound: float, smallest: float, unit: str, *, given: bool, outlasts: int | None
) -> tuple[str, ...]:
    known = (
        f"the smallest bound possible is {smallest:.4g}{unit}"
        if given
        else "the bound is 1.1 times the smallest possible"
    )
    says = [
        f"set membership: if the noise is at most {bound:.4g}{unit} in every sample, each"
        f" coefficient lies within √3 of its standard deviations for certain; {known}"
    ]
    if outlasts is not None:
        says.append(
            f"the response has not decayed within {outlasts} lags; what lies beyond counts as"
            " noise: take a larger order"
        )
    return tuple(says)


def _rows(
    records: Sequence[Record], input: str, output: str, m: int, delay: int
) -> tuple[FloatArray, FloatArray]:
    """Lagged inputs (n, m) and outputs (n,) of all complete rows, at most 4000 evenly spaced
    ones.
    """
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
    spaced = (
        np.unique(np.linspace(0, len(y) - 1, min(len(y), _ROWS)).round().astype(int))
        if len(y)
        else np.zeros(0, dtype=int)
    )
    return Phi[spaced], y[spaced]
