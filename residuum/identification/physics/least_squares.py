"""The linear algebra of Gauss–Newton steps: scaled solves, covariance, and directions that the data leave open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

FLAT = 1e-9
"""Eigenvalues of the scaled Gauss–Newton matrix below this fraction of the largest are flat."""

RIDGE = 1e-13
"""And below this fraction a solution has nothing along them."""


@dataclass(frozen=True)
class FlatDirection:
    """Parameters that trade off: moving them together by `weights` (relative to their size) leaves the outputs as they are."""

    parameters: tuple[str, ...]
    weights: tuple[float, ...]


def damped(H: Array, damping: float) -> Array:
    """H, or each of several (…, m, m), with its diagonal raised by the fraction `damping` (Marquardt)."""
    raised = H.copy()
    np.einsum("...ii->...i", raised)[...] *= 1.0 + damping
    return raised


def solve_scaled(H: Array, right: Array, ridge: float = RIDGE) -> Array:
    """H⁻¹ right for symmetric H scaled to unit diagonal, zero along directions of too little curvature, or after an overflow.

    Shapes (…, m, m) and (…, m, columns); `ridge` is the fraction of the largest scaled curvature that is too little.
    """
    if H.shape[-1] == 0:
        return np.zeros(right.shape)
    if not (np.isfinite(H).all() and np.isfinite(right).all()):
        sound = np.all(np.isfinite(H), axis=(-2, -1)) & np.all(np.isfinite(right), axis=(-2, -1))
        H, right = np.where(sound[..., None, None], H, 0.0), np.where(sound[..., None, None], right, 0.0)
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", H), 0.0))
    scale = np.where(scale > 0, scale, 1.0)[..., None]
    values, vectors = np.linalg.eigh(H / (scale * scale.swapaxes(-2, -1)))
    kept = values > ridge * np.maximum(values[..., -1:], 1e-300)
    inverse = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
    return np.asarray(((vectors * inverse[..., None, :]) @ vectors.swapaxes(-2, -1) @ (right / scale)) / scale)


def covariance_of(H: Array, variance: float, names: tuple[str, ...], theta: Array) -> tuple[Array, tuple[FlatDirection, ...]]:
    """Covariance σ²·H⁻¹ of parameters, infinite along flat directions, and those directions."""
    if not names:
        return np.zeros((0, 0)), ()
    if not np.all(np.isfinite(H)):  # an overflow: nothing is known of any of them
        return np.full(H.shape, np.inf), ()
    size = np.where(theta != 0, np.abs(theta), 1.0)
    diagonal = np.sqrt(np.maximum(np.diag(H), 0.0))
    scale = np.where(diagonal > 0, 1.0 / np.where(diagonal > 0, diagonal, 1.0), size)
    values, vectors = np.linalg.eigh(H * np.outer(scale, scale))
    flat = values < FLAT * max(float(values[-1]), 1e-300)
    variances = np.where(flat, np.inf, variance / np.where(flat, 1.0, values))
    parts = vectors * scale[:, None]
    with np.errstate(invalid="ignore"):
        covariance = np.einsum("ik,k,jk->ij", parts, np.where(flat, 0.0, variances), parts)
    directions = []
    for k in np.flatnonzero(flat):
        relative = parts[:, k] / size
        relative = relative / np.max(np.abs(relative))
        members = np.flatnonzero(np.abs(relative) > 0.05)
        touched = np.abs(vectors[:, k]) > 1e-3
        covariance[touched, touched] = np.inf
        directions.append(FlatDirection(tuple(names[i] for i in members), tuple(float(relative[i]) for i in members)))
    return covariance, tuple(directions)
