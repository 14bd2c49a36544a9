"""Linear systems: state space, factorisations, norms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import linalg

from residuum.array_types import FloatArray
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.state_space import StateSpace
from residuum.kept_loops import njit

# Model reduction by balanced truncation, with its guaranteed error bound.


@dataclass(frozen=True, eq=False)
class ReducedSystem:
    """The truncated system, the Hankel singular values, and the bound 2 Σ_{i>r} σ_i on ‖G −
    G_r‖_∞.
    """

    system: StateSpace
    hankel_singular_values: FloatArray
    error_bound: float


def balanced_truncation(
    system: StateSpace, tolerance: float, *, order: int | None = None
) -> ReducedSystem:
    """Least order r whose error bound 2 Σ_{i>r} σ_i is at most `tolerance` (absolute), or the given
    `order`.

    Square-root form (Tombs and Postlethwaite, 1987): it needs no balancing of the full system, so
    nearly uncontrollable states do no harm. The bound is Enns' and Glover's (1984); the reduced
    system is stable.

    Raises
    ------
    BadModel
        The system is not stable.
    """
    if not system.is_stable:
        raise BadModel("balanced_truncation: the system is not stable")
    if not system.order:
        return ReducedSystem(system, np.zeros(0), 0.0)
    controllability = _root(linalg.solve_discrete_lyapunov(system.A, system.B @ system.B.T))
    observability = _root(linalg.solve_discrete_lyapunov(system.A.T, system.C.T @ system.C))
    # R_oᵀ R_c has the Hankel singular values, whatever roots of the Gramians are taken
    U, sigma, Vt = np.linalg.svd(observability.T @ controllability)
    # the bound for each order: of r states, twice the sum of the values left out
    tails = 2.0 * np.concatenate([np.cumsum(sigma[::-1])[::-1], [0.0]])
    r = int(np.argmax(tails <= tolerance)) if order is None else min(order, len(sigma))
    # values that are rounding have no direction to keep
    r = min(r, int(np.sum(sigma > sigma[0] * 1e-14))) if sigma[0] > 0 else 0
    scale = 1.0 / np.sqrt(sigma[:r])
    left, right = (observability @ U[:, :r] * scale).T, controllability @ Vt[:r].T * scale
    reduced = StateSpace(
        left @ system.A @ right, left @ system.B, system.C @ right, system.D, system.sample_time
    )
    return ReducedSystem(reduced, np.asarray(sigma), float(tails[r]))


def _root(gramian: FloatArray) -> FloatArray:
    eigenvalues, vectors = np.linalg.eigh((gramian + gramian.T) / 2.0)
    return np.asarray(vectors * np.sqrt(np.maximum(eigenvalues, 0.0)))


# Left coprime factorisation G = M⁻¹ N over the stable proper rational functions.


@dataclass(frozen=True, eq=False)
class LeftCoprimeFactors:
    """Stable M, N with G = M⁻¹ N that share the observer x⁺ = (A − L C) x + (B − L D) u + L y.

    Parameters
    ----------
    M : StateSpace, p × p
        y → M y = y − C x.
    N : StateSpace, p × q
        u → N u.
    observer : StateSpace, p × (p + q)
        [M, −N]: its output for the input [y; u] is the primary residual M y − N u, (1.46) of the
        source.
    observer_gain : array, shape (n, p)
        L.
    """

    M: StateSpace
    N: StateSpace
    observer: StateSpace
    observer_gain: FloatArray


def left_coprime(system: StateSpace, *, normalised: bool = False) -> LeftCoprimeFactors:
    """Left coprime factors of a detectable proper system, stable or not; definition 1.8 of the
    source.

    A stable system keeps L = 0, hence M = 1 and N = G, unless `normalised` asks for M M~ + N N~ =
    1. Otherwise L is the stationary Kalman gain for unit noise on input and output, which is what
    makes the factors normalised after scaling with (1 + D Dᵀ + C X Cᵀ)^(−1/2).

    Raises
    ------
    BadModel
        An unstable mode of the system is not seen at its output, so no stable observer exists.

    Examples
    --------
    >>> from residuum.identification.linear_models.transfer_function import TransferFunction
    >>> unstable = TransferFunction([1.0], [1.0, -2.0], sample_time=1.0)
    >>> factors = left_coprime(StateSpace.from_transfer_function(unstable))
    >>> factors.M.is_stable and factors.N.is_stable
    True
    """
    p = system.D.shape[0]
    if system.is_stable and not normalised:
        L = np.zeros((system.order, p))
        observer = StateSpace.gain(np.eye(p), system.sample_time).beside(system * -1.0)
        return LeftCoprimeFactors(
            StateSpace.gain(np.eye(p), system.sample_time), system, observer, L
        )
    L, scale = _kalman_gain(system)
    A, B = system.A - L @ system.C, system.B - L @ system.D
    C, D = scale @ system.C, scale @ system.D
    Ts = system.sample_time
    return LeftCoprimeFactors(
        M=StateSpace(A, L, -C, scale, Ts),
        N=StateSpace(A, B, C, D, Ts),
        observer=StateSpace(A, np.hstack([L, B]), -C, np.hstack([scale, -D]), Ts),
        observer_gain=L,
    )


def _kalman_gain(system: StateSpace) -> tuple[FloatArray, FloatArray]:
    """Stationary predictor gain L for unit white noise at input and output, and the normalising
    factor.
    """
    A, B, C, D = system.A, system.B, system.C, system.D
    measurement = np.eye(D.shape[0]) + D @ D.T
    try:
        X = linalg.solve_discrete_are(A.T, C.T, B @ B.T, measurement, s=B @ D.T)
    except (linalg.LinAlgError, ValueError):
        raise BadModel(
            "left_coprime: an unstable or undamped mode cannot be seen at the output (not"
            " detectable)"
        ) from None
    innovation = measurement + C @ X @ C.T
    L = np.linalg.solve(innovation, (A @ X @ C.T + B @ D.T).T).T
    if np.any(np.abs(np.linalg.eigvals(A - L @ C)) >= 1.0):
        raise BadModel(
            "left_coprime: an unstable or undamped mode cannot be seen at the output (not"
            " detectable)"
        )
    eigenvalues, vectors = np.linalg.eigh(innovation)
    return L, (vectors / np.sqrt(eigenvalues)) @ vectors.T


# Finite impulse response filter that remembers its past, so that blocks and single samples give
# the same numbers.


class FirFilter:
    """w(t) = Σ_k h_k v(t−k), fed block by block from rest.

    Each output is summed in the order of the taps whatever the block lengths, so cutting the input
    differently changes no bit of the result.

    >>> whole, halves = FirFilter([1.0, 0.5]), FirFilter([1.0, 0.5])
    >>> in_parts = [*halves.process([1.0]), *halves.process([2.0, 3.0])]
    >>> whole.process([1.0, 2.0, 3.0]).tolist() == in_parts
    True
    """

    def __init__(self, taps: npt.ArrayLike) -> None:
        self.taps: FloatArray = np.ascontiguousarray(taps, dtype=float)
        self.history: FloatArray = np.zeros(len(self.taps) - 1)

    def reset(self) -> None:
        """Forget the past."""
        self.history = np.zeros(len(self.taps) - 1)

    def process(self, v: npt.ArrayLike) -> FloatArray:
        """Output for the next block, shape of `v`."""
        past = np.concatenate([self.history, np.asarray(v, dtype=float)])
        self.history = past[len(past) - len(self.taps) + 1 :]
        return np.asarray(_convolve(self.taps, past))


_BLOCK = 1024  # outputs that stay in the first cache while the taps pass over them


@njit()
def _convolve(taps, past):  # type: ignore[no-untyped-def]
    """Eight taps a pass: the output is then loaded and stored an eighth as often, and added to in
    the same order.
    """
    m = len(taps)
    n = len(past) - m + 1
    w = np.zeros(n)
    for start in range(0, n, _BLOCK):
        size = min(_BLOCK, n - start)
        out = w[start : start + size]
        k = 0
        while k + 8 <= m:
            p = past[start + m - 8 - k :]
            h = taps[k : k + 8]
            h0, h1, h2, h3, h4, h5, h6, h7 = h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7]
            for t in range(size):
                early = out[t] + h0 * p[t + 7] + h1 * p[t + 6] + h2 * p[t + 5] + h3 * p[t + 4]
                out[t] = early + h4 * p[t + 3] + h5 * p[t + 2] + h6 * p[t + 1] + h7 * p[t]
            k += 8
        for tap in range(k, m):
            p = past[start + m - 1 - tap :]
            h0 = taps[tap]
            for t in range(size):
                out[t] += h0 * p[t]
    return w


# How long a stable system remembers.

_LONGEST_MEMORY = 4096  # samples


def settled_length(system: StateSpace, part: float = 1e-4) -> int:
    """Samples after which the slowest mode of a stable system is down to this part of itself; 1
    without states, 4096 at most.
    """
    if not system.order:
        return 1
    slowest = float(np.max(np.abs(system.poles)))
    if slowest <= 0.0:
        return system.order + 1
    return min(_LONGEST_MEMORY, system.order + 1 + int(np.ceil(np.log(part) / np.log(slowest))))


# Co-outer (spectral) factor: the stable, stably invertible G_o with G_o G_o~ = G G~.


def co_outer_factor(system: StateSpace) -> StateSpace:
    """G_o, p × p, with G_o(z) G_o(1/z)ᵀ = G(z) G(1/z)ᵀ on the unit circle; G_o and its inverse are
    stable.

    With the stabilising solution X of the filter Riccati equation

        X = A X Aᵀ + B Bᵀ − K R Kᵀ,   R = D Dᵀ + C X Cᵀ,   K = (A X Cᵀ + B Dᵀ) R⁻¹,

    G_o = C (zI − A)⁻¹ K R^½ + R^½ (Anderson and Moore, Optimal Filtering, 1979, ch. 9).

    Raises
    ------
    BadModel
        G is not stable, or has a zero on the unit circle (no stably invertible factor exists).
    """
    if not system.is_stable:
        raise BadModel("co_outer_factor: the system is not stable")
    A, B, C, D = system.A, system.B, system.C, system.D
    if not system.order:
        return StateSpace.gain(linalg.sqrtm(D @ D.T).real, system.sample_time)
    try:
        X = linalg.solve_discrete_are(A.T, C.T, B @ B.T, D @ D.T, s=B @ D.T)
    except (linalg.LinAlgError, ValueError):
        raise BadModel(
            "co_outer_factor: the system has a zero on the unit circle; add measurement noise"
        ) from None
    R = D @ D.T + C @ X @ C.T
    eigenvalues, vectors = np.linalg.eigh(R)
    root = (vectors * np.sqrt(eigenvalues)) @ vectors.T
    K = np.linalg.solve(R, (A @ X @ C.T + B @ D.T).T).T
    factor = StateSpace(A, K @ root, C, root, system.sample_time)
    if not factor.inverse().is_stable:
        raise BadModel(
            "co_outer_factor: the system has a zero on the unit circle; add measurement noise"
        )
    return factor


# Norms of discrete-time systems: H∞ (largest gain over frequency) and ℓ₁ (largest peak-to-peak
# gain).

_LARGEST_GRID = 1 << 20  # samples of an impulse response, at most
_ROWS = 1024  # samples of an impulse response that are worked out at once


def h_infinity_norm(system: StateSpace, tolerance: float = 1e-8) -> tuple[float, float]:
    """‖G‖_∞ = max_ω σ̄(G(e^{jωTs})) and the frequency [rad/s] where it is reached.

    Two-step bisection of Bruinsma and Steinbuch (1990): a lower bound from a grid is raised to the
    largest gain between the crossings that the Hamiltonian's imaginary eigenvalues mark, until
    there are none at (1 + tolerance) times the bound. The Hamiltonian is that of the bilinearly
    transformed system, whose norm is the same. The answer therefore does not rest on the grid.

    Raises
    ------
    BadModel
        The system is not stable.

    Examples
    --------
    >>> from residuum.identification.linear_models.transfer_function import TransferFunction
    >>> lag = TransferFunction([0.5], [1.0, -0.5], sample_time=1.0)
    >>> round(h_infinity_norm(StateSpace.from_transfer_function(lag))[0], 8)
    1.0
    """
    if not system.is_stable:
        raise BadModel("h_infinity_norm: the system is not stable")
    nyquist = np.pi / system.sample_time
    omega = np.concatenate([np.linspace(0.0, nyquist, 257), nyquist * np.logspace(-6, 0, 64)])
    bound, peak = _largest(system, omega)
    if not system.order or bound == 0.0:
        return bound, peak
    for _ in range(50):
        crossings = _crossings(system, bound * (1.0 + tolerance))
        if len(crossings) == 0:
            return bound, peak
        edges = np.concatenate([[0.0], crossings, [nyquist]])
        higher, at = _largest(system, np.concatenate([(edges[:-1] + edges[1:]) / 2, crossings]))
        if higher <= bound * (1.0 + tolerance):
            return max(bound, higher), at if higher > bound else peak
        bound, peak = higher, at
    return bound, peak


def _largest(system: StateSpace, omega: FloatArray) -> tuple[float, float]:
    response = system.frequency_response(omega)
    gains = np.linalg.norm(response, ord=2, axis=(1, 2))
    k = int(np.argmax(gains))
    return float(gains[k]), float(omega[k])


def _crossings(system: StateSpace, gamma: float) -> FloatArray:
    """Frequencies [rad/s], ascending, at which a singular value of G equals `gamma`."""
    identity = np.eye(system.order)
    # bilinear transform z = (1 + s)/(1 − s) to continuous time, which leaves the norm as it is
    inverse = np.linalg.inv(system.A + identity)
    A = inverse @ (system.A - identity)
    B = np.sqrt(2.0) * inverse @ system.B
    C = np.sqrt(2.0) * system.C @ inverse
    D = system.D - system.C @ inverse @ system.B
    R = gamma**2 * np.eye(D.shape[1]) - D.T @ D
    F = A + B @ np.linalg.solve(R, D.T @ C)
    H = np.block(
        [
            [F, B @ np.linalg.solve(R, B.T)],
            [-C.T @ (np.eye(D.shape[0]) + D @ np.linalg.solve(R, D.T)) @ C, -F.T],
        ]
    )
    # imaginary to rounding, s = jΩ: ω = 2 atan(Ω)/Ts
    eigenvalues = np.linalg.eigvals(H)
    scale = max(1.0, float(np.abs(eigenvalues).max()))
    near = eigenvalues[(np.abs(eigenvalues.real) < 1e-7 * scale) & (eigenvalues.imag >= 0)]
    return np.asarray(np.sort(2.0 * np.arctan(near.imag) / system.sample_time))


def peak_gain(system: StateSpace, tolerance: float = 1e-9) -> FloatArray:
    """ℓ₁ norm Σ_k |g_ij(k)| of each entry, shape (p, q): the largest peak of output i for |input j|
    ≤ 1.

    The impulse response is summed over N samples; as A^(jN) shrinks like ‖A^N‖^j, what follows is
    at most Σ_{k<N} ‖C A^k‖ ‖B‖ ‖A^N‖/(1 − ‖A^N‖). N doubles until that is below `tolerance` of the
    sum, and it is added, so the value never lies below the norm.

    Raises
    ------
    BadModel
        The system is not stable, or its memory exceeds a million samples.
    """
    if not system.is_stable:
        raise BadModel("peak_gain: the system is not stable")
    total, left = np.abs(system.D), np.zeros(system.D.shape[0])
    if not system.order:
        return np.asarray(total)
    rows, step = system.C[None], system.A  # C A^k for k < L, and A^L
    while len(rows) < _ROWS:
        rows, step = np.concatenate([rows, rows @ step]), step @ step
    N, power, next_check = 0, step, _ROWS
    while N < _LARGEST_GRID:
        total = total + np.abs(rows @ system.B).sum(axis=0)
        left = left + np.linalg.norm(rows, axis=2).sum(axis=0)
        N += _ROWS
        if next_check == N:  # power = A^N
            shrink = float(np.linalg.norm(power))
            if shrink < 1.0:
                tail = np.outer(left, np.linalg.norm(system.B, axis=0)) * shrink / (1.0 - shrink)
                if np.all(tail <= tolerance * np.maximum(total, np.finfo(float).tiny)):
                    return np.asarray(total + tail)
            power, next_check = power @ power, 2 * next_check
        rows = rows @ step
    raise BadModel("peak_gain: the impulse response does not decay within a million samples")
