"""Set membership: all parameters that bounded noise leaves possible."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput, NotIdentifiable


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
        """True when no parameter vector agrees with the data: the bound or the structure is wrong."""
        return self.smallest_bound > self.bound

    @property
    def centre(self) -> FloatArray:
        """Central estimate (β^u + β^l)/2, shape (p,): the smallest worst-case error in every parameter, (1.123) corrected."""
        return (self.upper + self.lower) / 2

    @property
    def radius(self) -> FloatArray:
        """Half widths: |centre − β_true| is at most this, (1.119); shape (p,)."""
        return (self.upper - self.lower) / 2


def feasible_set(Phi: npt.ArrayLike, y: npt.ArrayLike, bound: float, *, norm: str = "inf") -> FeasibleSet:
    """The feasible parameter set of a linear regression with bounded noise.

    ∞-norm, |e_t| ≤ ε for every t: a polytope; its intervals (1.120)–(1.121) are 2p linear programs, and the smallest feasible
    bound is the Chebyshev fit. 2-norm, ‖e‖ ≤ ε: an ellipsoid about least squares, β_ls ± √((ε² − ‖y − Φβ_ls‖²) (ΦᵀΦ)⁻¹_jj).

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
        Shapes that do not fit, missing or infinite values, a bound that is not positive, unknown norm.
    NotIdentifiable
        Fewer rows than parameters, or dependent columns: the set is unbounded.

    References
    ----------
    M. Milanese, A. Vicino, *Optimal estimation theory for dynamic systems with set membership uncertainty*, Automatica 27 (1991).

    Examples
    --------
    >>> found = feasible_set([[1.0], [1.0], [1.0]], [1.1, 0.9, 1.0], bound=0.3)
    >>> found.empty, found.lower.round(6).tolist(), found.upper.round(6).tolist(), round(found.smallest_bound, 6)
    (False, [0.8], [1.2], 0.1)
    """
    Phi, y = _checked(Phi, y, bound, norm)
    scale = np.linalg.norm(Phi, axis=0)
    if Phi.shape[0] < Phi.shape[1] or np.linalg.matrix_rank(Phi / np.where(scale > 0, scale, 1.0)) < Phi.shape[1]:
        raise NotIdentifiable(f"feasible_set: {Phi.shape[1]} parameters are not determined by these {Phi.shape[0]} rows")
    solve = _polytope if norm == "inf" else _ellipsoid
    smallest, lower, upper = solve(Phi / scale, y, bound)
    return FeasibleSet(norm, float(bound), smallest, lower / scale, upper / scale)


def _ellipsoid(Phi: FloatArray, y: FloatArray, bound: float) -> tuple[float, FloatArray, FloatArray]:
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
    chebyshev = linprog(np.r_[np.zeros(p), 1.0], A_ub=np.c_[A, -np.ones(len(A))], b_ub=b, bounds=[(None, None)] * p + [(0, None)])
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


def _checked(Phi: npt.ArrayLike, y: npt.ArrayLike, bound: float, norm: str) -> tuple[FloatArray, FloatArray]:
    Phi, y = np.asarray(Phi, dtype=float), np.asarray(y, dtype=float)
    if norm not in ("inf", "2"):
        raise BadInput(f"feasible_set, norm: is {norm!r}; must be 'inf' or '2'")
    if not (np.isfinite(bound) and bound > 0):
        raise BadInput(f"feasible_set, bound: is {bound!r}; must be a positive number")
    if Phi.ndim != 2 or y.shape != Phi.shape[:1]:
        raise BadInput(f"feasible_set: Phi has shape {Phi.shape} and y {y.shape}; must be (n, p) and (n,)")
    if not (np.isfinite(Phi).all() and np.isfinite(y).all()):
        raise BadInput("feasible_set: Phi and y must have no missing or infinite value")
    return Phi, y
