"""Levenberg–Marquardt search of the prediction error criterion, kept to stable predictors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.linear_models.prediction_error.criterion import Criterion, Normal

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a search ended: parameters, blocks there, whether it converged."""

    x: FloatArray
    normal: Normal
    converged: bool


def minimise(criterion: Criterion, start: FloatArray, *, iterations: int = 60, tolerance: float = 1e-9) -> Minimum:
    """Walk down from `start`; steps that leave the stable region or raise the cost are shortened by damping.

    Stops when the predicted relative fall of the cost is below `tolerance`.

    References
    ----------
    J. J. Moré, *The Levenberg–Marquardt algorithm*, LNM 630 (1978): damping scaled by the diagonal of ψᵀψ.
    """
    x = start
    normal = criterion.normal(x)
    damping = 1e-4
    for _ in range(iterations):
        accepted = False
        while damping < 1e10:
            step, fall = _step(normal, damping)
            if fall <= tolerance * normal.cost:
                return Minimum(x, normal, converged=True)
            cost = criterion.cost(x + step)
            if cost < normal.cost:
                gain = (normal.cost - cost) / fall
                damping = max(damping * (0.2 if gain > 0.5 else 1.0), 1e-12)
                accepted = True
                break
            damping *= 5.0
        if not accepted:
            return Minimum(x, normal, converged=False)
        x = x + step
        normal = criterion.normal(x)
    return Minimum(x, normal, converged=False)


def _step(normal: Normal, damping: float) -> tuple[FloatArray, float]:
    """(step, fall of the cost that the linear model predicts)."""
    scale = np.sqrt(np.maximum(np.diag(normal.gram), 1e-300))
    scaled = normal.gram / np.outer(scale, scale)
    right = normal.gradient / scale
    step = np.linalg.lstsq(scaled + damping * np.eye(len(right)), right, rcond=1e-14)[0]
    return step / scale, float(2 * step @ right - step @ scaled @ step)
