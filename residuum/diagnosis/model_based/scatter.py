r"""How values scatter from one healthy window to the next, and move with the kind of run.

    x_w = Bᵀφ_w + δ_w,   δ_w ~ N(0, S),   x̂_w ~ N(x_w, H_w⁻¹),

a hierarchical normal model: φ are the features of the run, H_w is what the window by itself says. B (ridge) and S by expectation
and maximisation; how far each value may depend on φ by the evidence of its ridge. Far from the runs seen the scatter widens.

References
----------
A. Gelman et al., *Bayesian Data Analysis*, 3rd ed. 2013, ch. 5 and 15; D. MacKay, Neural Computation 4 (1992) 415 (evidence).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.diagnosis.model_based.policy import EM_STEPS, EVIDENT, RIDGES


@dataclass(frozen=True, eq=False)
class Scatter:
    """Mean and scatter of values.

    Attributes
    ----------
    B : array, shape (features, values)
    S : array, shape (values, values)
    M : array, shape (values, features, features)
        (FᵀF + ridge)⁻¹ of each value.
    freedom : float
        Windows that S is worth.
    """

    B: FloatArray
    S: FloatArray
    M: FloatArray
    freedom: float

    @classmethod
    def of(cls, F: FloatArray, x: FloatArray, information: Sequence[FloatArray] | None, floor: FloatArray) -> Scatter:
        """Learned from windows.

        Parameters
        ----------
        F : array, shape (windows, features)
        x : array, shape (windows, values)
        information : sequence of array, shape (values, values), or None
            Of each window on its values; None: they are known exactly.
        floor : array, shape (values,)
            Least standard deviation of each.
        """
        ridges = np.full(x.shape[1], RIDGES[0])
        found, post = _fitted(F, x, information, floor, ridges)
        for _ in range(2):
            ridges = np.array([_evident_ridge(F, y, least) for y, least in zip(post.T, floor, strict=True)])
            found, post = _fitted(F, x, information, floor, ridges)
        return found

    def at(self, features: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (values,) and covariance (values, values) of a further window."""
        widened = np.sqrt(1.0 + np.einsum("i,pij,j->p", features, self.M, features))
        return features @ self.B, self.S * np.outer(widened, widened)


def _fitted(
    F: FloatArray, x: FloatArray, information: Sequence[FloatArray] | None, floor: FloatArray, ridges: FloatArray
) -> tuple[Scatter, FloatArray]:
    """The scatter with these ridges, and each window's values as it and the others tell them."""
    n, p = x.shape
    M = np.array([np.linalg.inv(F.T @ F + np.diag([1e-6] + [ridge] * (F.shape[1] - 1))) for ridge in ridges])
    M = M.reshape(p, F.shape[1], F.shape[1])
    freedom = np.array([max(n - float(np.trace(F @ m @ F.T)), 2.0) for m in M])
    post, V = x, np.zeros((n, p, p))
    B, S = np.zeros((F.shape[1], p)), np.zeros((p, p))
    for _ in range(1 if information is None else EM_STEPS):
        B = np.einsum("pij,wj,wp->ip", M, F, post)
        d = post - F @ B
        S = d.T @ d / np.sqrt(np.outer(freedom, freedom)) + V.mean(axis=0) + np.diag(floor**2)
        if information is not None:
            P = np.linalg.inv(S)
            V = np.array([np.linalg.inv(P + h) for h in information])
            told = zip(V, F @ B, information, x, strict=True)
            post = np.array([v @ (P @ mean + h @ y) for v, mean, h, y in told]).reshape(n, p)
    B, S, M = (np.ascontiguousarray(x) for x in (B, S, M))  # as they are loaded: the order decides the last digit
    return Scatter(B, S, M, float(freedom.min(initial=float(n)))), post


def _evident_ridge(F: FloatArray, y: FloatArray, floor: float) -> float:
    """The ridge under which the values of the windows are likeliest; less of it only where that is evident."""
    best, chosen = -np.inf, RIDGES[0]
    r = (y - y.mean()) / max(float(y.std()), float(floor), 1e-300)
    for ridge in RIDGES:
        K = np.eye(len(y)) + F[:, 1:] @ F[:, 1:].T / ridge
        square = max(float(r @ np.linalg.solve(K, r)), 1e-12)
        evidence = -0.5 * float(np.linalg.slogdet(K)[1]) - 0.5 * len(y) * np.log(square)
        if evidence > best + EVIDENT:
            best, chosen = evidence, ridge
    return chosen
