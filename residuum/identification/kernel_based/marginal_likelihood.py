"""Marginal likelihood of a Gaussian impulse-response prior, with its exact gradient, from
regression sums alone.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag, lapack

from residuum.array_types import FloatArray
from residuum.identification.errors import NotIdentifiable
from residuum.identification.kernel_based.gram import RegressionSums
from residuum.identification.kernel_based.kernels import DiagonalKernel, Kernel

_LOG_2PI = math.log(2 * math.pi)
# Rounding of yᵀy − zᵀz relative to yᵀy: a smaller residual cannot be told from zero.
RESOLUTION = 1e-13
# Difference step and widest standard deviation of the search variables, which are logarithms.
_STEP = 1e-4
_WIDEST = 2.0
_RAISES = 10


@dataclass(frozen=True, eq=False)
class Posterior:
    """Mean, shape (p,), and covariance, shape (p, p), of the coefficients, and σ², in the units of
    the sums.
    """

    mean: FloatArray
    covariance: FloatArray
    noise_variance: float


class MarginalLikelihood(ABC):
    """−log p(y | η, κ) of y = Φ g + e with g_j ~ N(0, σ² κ_j K(η_j)) for each input j and e ~ N(0,
    σ² I); (A.16)–(A.18).

    With the prior factor F (σ² F Fᵀ = P) and A = I + FᵀΦᵀΦF = L Lᵀ, z = L⁻¹FᵀΦᵀy:

        log|Z| = n ln σ² + 2 Σ ln L_ii,    yᵀZ⁻¹y = q/σ²,    q = yᵀy − zᵀz

    so one evaluation costs m³ whatever n is. When σ² is a hyper-parameter, its optimum q/n is
    inserted. For any change of the prior with E = F⁻¹ dK F⁻ᵀ, and s = L⁻ᵀz:  d log|Z| = tr((I −
    A⁻¹) E),  dq = −sᵀ E s. Neither P nor ΦᵀΦ is inverted, so decays that underflow and inputs that
    do not excite stay finite. The search variables are, input by input, the kernel's free variables
    and ln κ_j.

    Parameters
    ----------
    sums : RegressionSums
        `n_inputs` blocks of columns of equal order; best scaled to unit variances.
    kernel : Kernel
    n_inputs : int
        Each input has hyper-parameters and a scale of its own (block-diagonal prior).
    noise_variance : float or None
        σ² in the units of the sums; None = hyper-parameter.
    """

    def __init__(
        self, sums: RegressionSums, kernel: Kernel, n_inputs: int, noise_variance: float | None
    ) -> None:
        self.kernel, self.noise_variance, self.n_inputs = kernel, noise_variance, n_inputs
        self.order = len(sums.cross) // n_inputs
        self.n, self.energy = sums.degrees_of_freedom, sums.energy
        self.gram, self.cross = sums.gram, sums.cross
        self._solved: tuple[bytes, tuple[FloatArray, float, float, FloatArray]] | None = None
        self._inverted: tuple[bytes, FloatArray] | None = None

    @abstractmethod
    def whitened(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A and FᵀΦᵀy at `x`."""

    @abstractmethod
    def slopes(
        self, x: FloatArray, inverse_root: FloatArray, solved: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives of q and log|Z| by `x`, from L⁻¹ and L⁻ᵀz."""

    @abstractmethod
    def to_coefficients(self, x: FloatArray, array: FloatArray) -> FloatArray:
        """F applied along the first axis."""

    @abstractmethod
    def gain(self, x: FloatArray) -> FloatArray:
        """Mean square of the output that each input's prior gives, in units of σ², shape
        (n_inputs,).
        """

    def value(self, x: npt.ArrayLike) -> float:
        """−log p(y) at the search variables `x`."""
        _, q, log_det, _ = self._solve(np.asarray(x, dtype=float))
        return self._combine(q, log_det)[0]

    def value_and_gradient(self, x: npt.ArrayLike) -> tuple[float, FloatArray]:
        """−log p(y) and its derivative by `x`."""
        value, gradient, _ = self._derivatives(np.asarray(x, dtype=float))
        return value, gradient

    def posterior(self, x: npt.ArrayLike) -> Posterior:
        """Posterior of g at the search variables `x`: (A.17b), (A.17c)."""
        x = np.asarray(x, dtype=float)
        _, q, log_det, z = self._solve(x)
        variance = self._combine(q, log_det)[1]
        root = self.to_coefficients(x, self._inverse_root(x).T)
        return Posterior(root @ z, variance * (root @ root.T), variance)

    def hyper_parameter_spread(self, x: npt.ArrayLike) -> FloatArray:
        """Part of the covariance of g that comes from not knowing the hyper-parameters, shape (p,
        p).

        To first order J H⁻¹ Jᵀ with J = ∂ĝ/∂x and H = −∂² log p/∂x² by differences of the exact
        gradient (Laplace's approximation), under a wide prior of the search variables that keeps
        flat directions finite.
        """
        x = np.asarray(x, dtype=float)
        # forward differences: the gradient is exact, so one step a variable gives a row of H and J
        gradient, mean = self._gradient_and_mean(x)
        moved = [self._gradient_and_mean(x + step) for step in _STEP * np.eye(len(x))]
        H = np.array([(shifted - gradient) / _STEP for shifted, _ in moved])
        J = np.array([(shifted - mean) / _STEP for _, shifted in moved])
        # differences leave H not quite symmetric
        curvature, axes = np.linalg.eigh(0.5 * (H + H.T))
        # a curvature below zero, as at a bound, counts as none: there the wide prior alone holds
        directions = (axes.T @ J) / np.sqrt(np.maximum(curvature, 0.0) + 1 / _WIDEST**2)[:, None]
        return np.asarray(directions.T @ directions)

    def _gradient_and_mean(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        _, gradient, solved = self._derivatives(x)
        return gradient, self.to_coefficients(x, solved[:, None])[:, 0]

    def _derivatives(self, x: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """−log p, its derivative by x, and L⁻ᵀz."""
        _, q, log_det, z = self._solve(x)
        inverse_root = self._inverse_root(x)
        solved = inverse_root.T @ z
        dq, dlog_det = self.slopes(x, inverse_root, solved)
        value, variance = self._combine(q, log_det)
        return value, 0.5 * (dq / variance + dlog_det), solved

    def hyper_parameters(self, x: npt.ArrayLike) -> list[tuple[FloatArray, float]]:
        """(η_j, κ_j) of every input."""
        rows = np.asarray(x, dtype=float).reshape(self.n_inputs, -1)
        items = self.kernel.parameters
        return [
            (
                np.array([item.value(v) for item, v in zip(items, row, strict=False)]),
                math.exp(row[-1]),
            )
            for row in rows
        ]

    def _solve(self, x: FloatArray) -> tuple[FloatArray, float, float, FloatArray]:
        """L, q, log det A and z; the last result is kept, as value, gradient and posterior ask for
        it in turn.
        """
        if self._solved is None or self._solved[0] != x.tobytes():
            A, b = self.whitened(x)
            L = cholesky(A)
            z = lapack.dtrtrs(L, b, lower=1)[0]
            solution = (L, self.energy - float(z @ z), 2.0 * float(np.log(np.diagonal(L)).sum()), z)
            self._solved = (x.tobytes(), solution)
        return self._solved[1]

    def _inverse_root(self, x: FloatArray) -> FloatArray:
        if self._inverted is None or self._inverted[0] != x.tobytes():
            self._inverted = (x.tobytes(), lapack.dtrtri(self._solve(x)[0], lower=1)[0])
        return self._inverted[1]

    def _combine(self, q: float, log_det: float) -> tuple[float, float]:
        # rounding can leave q below what double precision resolves of yᵀy
        n, q = self.n, max(q, RESOLUTION * self.energy)
        # the variance of largest likelihood is q/n: it is eliminated where nobody says it
        variance = q / n if self.noise_variance is None else self.noise_variance
        return 0.5 * (q / variance + log_det + n * (math.log(variance) + _LOG_2PI)), variance

    def _free_slopes(self, x: FloatArray) -> FloatArray:
        """∂η/∂x of the kernel's variables, shape (n_inputs, len(η))."""
        rows = x.reshape(self.n_inputs, -1)
        return np.array(
            [
                [item.slope(v) for item, v in zip(self.kernel.parameters, row, strict=False)]
                for row in rows
            ]
        )


class DiagonalLikelihood(MarginalLikelihood):
    """For kernels diagonal in a fixed basis: the sums go to that basis once, a gradient needs
    diag(A⁻¹) only.
    """

    def __init__(
        self,
        sums: RegressionSums,
        kernel: DiagonalKernel,
        n_inputs: int,
        noise_variance: float | None,
    ) -> None:
        super().__init__(sums, kernel, n_inputs, noise_variance)
        self._prior = kernel
        self.cross = self._blockwise(kernel.to_basis, sums.cross)
        # from the left, then from the right as the left of its transpose: ΦᵀΦ is symmetric
        half = self._blockwise(kernel.to_basis, sums.gram)
        self.gram = self._blockwise(kernel.to_basis, half.T)

    def whitened(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A = I + v^½ ΦᵀΦ v^½ with the prior variances v = κ w in the basis."""
        root_v = np.exp(0.5 * self._log_variances(x))
        A = self.gram * root_v
        A *= root_v[:, None]
        np.einsum("ii->i", A)[...] += 1.0
        return A, root_v * self.cross

    def slopes(
        self, x: FloatArray, inverse_root: FloatArray, solved: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """∂q/∂ ln v_k = −s_k², ∂ log|Z|/∂ ln v_k = 1 − (A⁻¹)_kk, chained to the search
        variables.
        """
        by_log_v = np.stack(
            [-np.square(solved), 1.0 - np.einsum("ik,ik->k", inverse_root, inverse_root)]
        )
        by_input = by_log_v.reshape(2, self.n_inputs, self.order)
        slopes = []
        for j, ((eta, _), free) in enumerate(
            zip(self.hyper_parameters(x), self._free_slopes(x), strict=True)
        ):
            by_eta = by_input[:, j] @ self._prior.log_variances(self.order, eta)[1].T * free
            slopes.append(np.hstack([by_eta, by_input[:, j].sum(axis=1, keepdims=True)]))
        both = np.hstack(slopes)
        return both[0], both[1]

    def to_coefficients(self, x: FloatArray, array: FloatArray) -> FloatArray:
        """U v^½ applied along the first axis."""
        root_v = np.exp(0.5 * self._log_variances(x))
        return self._blockwise(self._prior.from_basis, root_v[:, None] * array)

    def gain(self, x: FloatArray) -> FloatArray:
        """Σ_k v_k (ΦᵀΦ)_kk / n."""
        by_column = np.exp(self._log_variances(x)) * np.diagonal(self.gram)
        return np.asarray(by_column.reshape(self.n_inputs, -1).sum(axis=1) / self.n)

    def _log_variances(self, x: FloatArray) -> FloatArray:
        pairs = self.hyper_parameters(x)
        return np.concatenate(
            [
                self._prior.log_variances(self.order, eta)[0] + math.log(kappa)
                for eta, kappa in pairs
            ]
        )

    def _blockwise(
        self, transform: Callable[[FloatArray], FloatArray], array: FloatArray
    ) -> FloatArray:
        return np.concatenate([transform(block) for block in np.split(array, self.n_inputs)])


class DenseLikelihood(MarginalLikelihood):
    """For any kernel that gives its factor F and its E = F⁻¹ (∂K/∂η) F⁻ᵀ."""

    def __init__(
        self, sums: RegressionSums, kernel: Kernel, n_inputs: int, noise_variance: float | None
    ) -> None:
        super().__init__(sums, kernel, n_inputs, noise_variance)
        self._last: tuple[bytes, FloatArray, list[list[FloatArray]]] = (b"", np.empty(0), [])

    def whitened(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A = I + FᵀΦᵀΦF."""
        F = self._prior(x)[0]
        A = F.T @ self.gram @ F
        # symmetric but for rounding, which a Cholesky factorisation reads from one half alone
        A = 0.5 * (A + A.T)
        np.einsum("ii->i", A)[...] += 1.0
        return A, F.T @ self.cross

    def slopes(
        self, x: FloatArray, inverse_root: FloatArray, solved: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """tr((I − A⁻¹) E) and −sᵀ E s on the block of each input."""
        spread = np.eye(len(solved)) - inverse_root.T @ inverse_root
        dq, dlog_det = [], []
        for j, (changes, free) in enumerate(
            zip(self._prior(x)[1], self._free_slopes(x), strict=True)
        ):
            block = slice(j * self.order, (j + 1) * self.order)
            # the kernel's own variables, then ln κ, whose E is the identity
            for E, slope in zip(changes, free, strict=True):
                dq.append(-slope * float(solved[block] @ E @ solved[block]))
                dlog_det.append(slope * float(np.vdot(spread[block, block], E)))
            dq.append(-float(solved[block] @ solved[block]))
            dlog_det.append(float(np.trace(spread[block, block])))
        return np.array(dq), np.array(dlog_det)

    def to_coefficients(self, x: FloatArray, array: FloatArray) -> FloatArray:
        """F applied along the first axis."""
        return self._prior(x)[0] @ array

    def gain(self, x: FloatArray) -> FloatArray:
        """tr(ΦᵀΦ K κ) / n, input by input."""
        F = self._prior(x)[0]
        by_column = np.einsum("ij,ij->j", F, self.gram @ F)
        return np.asarray(by_column.reshape(self.n_inputs, -1).sum(axis=1) / self.n)

    def _prior(self, x: FloatArray) -> tuple[FloatArray, list[list[FloatArray]]]:
        """F of all inputs and the E of each; the last one is kept, as value, gradient and posterior
        ask in turn.
        """
        if self._last[0] != x.tobytes():
            factors = [
                (math.sqrt(kappa), *self.kernel.factor(self.order, eta))
                for eta, kappa in self.hyper_parameters(x)
            ]
            self._last = (
                x.tobytes(),
                block_diag(*(root * F for root, F, _ in factors)),
                [changes for _, _, changes in factors],
            )
        return self._last[1], self._last[2]


def marginal_likelihood(
    sums: RegressionSums, kernel: Kernel, n_inputs: int = 1, noise_variance: float | None = None
) -> MarginalLikelihood:
    """The marginal likelihood in the form that suits the kernel."""
    if isinstance(kernel, DiagonalKernel):
        return DiagonalLikelihood(sums, kernel, n_inputs, noise_variance)
    return DenseLikelihood(sums, kernel, n_inputs, noise_variance)


def cholesky(A: FloatArray) -> FloatArray:
    """Lower factor of A, positive definite but for rounding, which a slight raise of the diagonal
    repairs.

    Raises NotIdentifiable when A is not finite.
    """
    size = float(A.trace())
    if not math.isfinite(size):
        raise NotIdentifiable(
            "the sums of the regression are not finite: the signals are too large for double"
            " precision"
        )
    raised = 0.0
    if np.isfinite(A).all():
        for _ in range(_RAISES):
            L, info = lapack.dpotrf(A + raised * np.eye(len(A)) if raised else A, lower=1, clean=1)
            if info == 0:
                return np.asarray(L)
            raised = 100 * raised or 1e-16 * size  # first by less than one rounding of the trace
    raise NotIdentifiable(
        "the sums of the regression are no Gram matrix: the signals are too large or too small to"
        " tell"
    )
