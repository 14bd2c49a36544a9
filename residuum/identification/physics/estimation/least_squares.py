"""The linear algebra of Gauss–Newton steps: scaled solves, covariance, and directions that the data
leave open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

# What compiled linear algebra calls: else it is looked for in the first step of a search.
import scipy.linalg.cython_lapack  # noqa: F401

from residuum.kept_loops import njit

Array = npt.NDArray[np.float64]

FLAT = 1e-9
"""Eigenvalues of the scaled Gauss–Newton matrix below this fraction of the largest are flat."""

NOTHING_ALONG = 1e-13
"""And below this fraction a solution has nothing along them."""


@dataclass(frozen=True)
class FlatDirection:
    """Parameters that trade off: moving them together by `weights` (relative to their size) leaves
    the outputs as they are.
    """

    parameters: tuple[str, ...]
    weights: tuple[float, ...]


def damped(H: Array, damping: float) -> Array:
    """H, or each of several (…, m, m), with its diagonal raised by the fraction `damping`
    (Marquardt).
    """
    raised = H.copy()
    np.einsum("...ii->...i", raised)[...] *= 1.0 + damping
    return raised


def bounded_step(H: Array, g: Array, theta: Array, lower: Array, upper: Array) -> Array:
    """Solution of H step = g for parameters within bounds: those at a bound that it would leave are
    held (active set).
    """
    held = np.zeros(len(g), dtype=bool)
    step = np.zeros(len(g))
    # Each round holds one parameter more at least, so there are no more than that.
    for _ in range(len(g) + 1):
        step = np.zeros(len(g))
        step[~held] = solve_scaled(H[np.ix_(~held, ~held)], g[~held, None])[:, 0]
        # At a bound and pushed beyond it. Those that are held stay so: a later round might free
        # them, but the next step of the descent does.
        out = ~held & ((theta <= lower) & (step < 0) | (theta >= upper) & (step > 0))
        if not out.any():
            break
        held |= out
    return step


def solve_scaled(H: Array, right: Array, ridge: float = NOTHING_ALONG) -> Array:
    """H⁻¹ right for symmetric H scaled to unit diagonal, zero along directions of too little
    curvature, or after an overflow.

    Shapes (…, m, m) and (…, m, columns); `ridge` is the fraction of the largest scaled curvature
    that is too little.
    """
    m, columns = right.shape[-2:]
    if not right.size:
        return np.zeros(right.shape)
    several = (
        np.ascontiguousarray(H).reshape(-1, m, m),
        np.ascontiguousarray(right).reshape(-1, m, columns),
    )
    return np.asarray(solved(*several, ridge).reshape(right.shape))


@njit(error_model="numpy")
def solved(H, right, ridge):  # type: ignore[no-untyped-def]
    """`solve_scaled` of several, for compiled code."""
    solution = np.zeros(right.shape)
    for k in range(H.shape[0]):
        if not (np.isfinite(H[k]).all() and np.isfinite(right[k]).all()):
            continue
        # Parameters of any units: by the root of their curvature they become comparable, and
        # eigenvalues say what the data leave open.
        scale = np.sqrt(np.maximum(np.diag(H[k]), 0.0))
        scale = np.where(scale > 0.0, scale, 1.0)
        scaled = H[k] / scale.reshape(-1, 1) / scale
        if not np.isfinite(scaled).all():
            continue
        values, vectors = np.linalg.eigh(scaled)
        for i in range(values.shape[0]):
            # Along a direction without curvature nothing is known: the step has no part there,
            # rather than a huge one.
            if values[i] > ridge * max(values[-1], 1e-300):
                direction = vectors[:, i] / scale
                for c in range(right.shape[2]):
                    solution[k, :, c] += np.sum(direction * right[k, :, c]) / values[i] * direction
    return solution


def covariance_of(
    H: Array, variance: float, names: tuple[str, ...], theta: Array
) -> tuple[Array, tuple[FlatDirection, ...]]:
    """Covariance σ²·H⁻¹ of parameters, infinite along flat directions, and those directions."""
    if not names:
        return np.zeros((0, 0)), ()
    if not np.all(np.isfinite(H)):  # an overflow: nothing is known of any of them
        return np.full(H.shape, np.inf), ()
    # Directions are told relative to the values: 1 stands for one that is zero.
    size = np.where(theta != 0, np.abs(theta), 1.0)
    diagonal = np.sqrt(np.maximum(np.diag(H), 0.0))
    scale = np.where(diagonal > 0, 1.0 / np.where(diagonal > 0, diagonal, 1.0), size)
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = H * scale[:, None] * scale
    if not np.all(np.isfinite(scaled)):  # curvatures that underflow: nothing is known either
        return np.full(H.shape, np.inf), ()
    values, vectors = np.linalg.eigh(scaled)
    # Relative to the largest: curvatures are only known up to the units of the errors.
    flat = values < FLAT * max(float(values[-1]), 1e-300)
    variances = np.where(flat, np.inf, variance / np.where(flat, 1.0, values))
    # Eigenvectors back in the parameters' own units.
    parts = vectors * scale[:, None]
    with np.errstate(invalid="ignore"):
        covariance = np.einsum("ik,k,jk->ij", parts, np.where(flat, 0.0, variances), parts)
    directions = []
    for k in np.flatnonzero(flat):
        relative = parts[:, k] / size
        relative = relative / np.max(np.abs(relative))
        # A parameter with less than a twentieth of the largest share does not belong to the
        # trade-off that is told.
        members = np.flatnonzero(np.abs(relative) > 0.05)
        touched = np.abs(vectors[:, k]) > 1e-3
        # Infinite also for those with little share: their values are known no better than the
        # direction is.
        covariance[touched, touched] = np.inf
        directions.append(
            FlatDirection(
                tuple(names[i] for i in members), tuple(float(relative[i]) for i in members)
            )
        )
    return covariance, tuple(directions)
