"""Norms of discrete-time systems: H∞ (largest gain over frequency) and ℓ₁ (largest peak-to-peak gain)."""

from __future__ import annotations

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.state_space import StateSpace

_LONGEST = 1 << 20
_ROWS = 1024  # samples of an impulse response that are worked out at once


def h_infinity_norm(system: StateSpace, tolerance: float = 1e-8) -> tuple[float, float]:
    """‖G‖_∞ = max_ω σ̄(G(e^{jωTs})) and the frequency [rad/s] where it is reached.

    Two-step bisection of Bruinsma and Steinbuch (1990): a lower bound from a grid is raised to the largest gain between
    the crossings that the Hamiltonian's imaginary eigenvalues mark, until there are none at (1 + tolerance) times the
    bound. The Hamiltonian is that of the bilinearly transformed system, whose norm is the same. The answer therefore
    does not rest on the grid.

    Raises
    ------
    BadModel
        The system is not stable.

    Examples
    --------
    >>> from residuum.identification.linear_models.transfer_function import TransferFunction
    >>> lag = StateSpace.from_transfer_function(TransferFunction([0.5], [1.0, -0.5], sample_time=1.0))
    >>> round(h_infinity_norm(lag)[0], 8)
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
    eigenvalues = np.linalg.eigvals(H)
    scale = max(1.0, float(np.abs(eigenvalues).max()))
    near = eigenvalues[(np.abs(eigenvalues.real) < 1e-7 * scale) & (eigenvalues.imag >= 0)]
    return np.asarray(np.sort(2.0 * np.arctan(near.imag) / system.sample_time))


def peak_gain(system: StateSpace, tolerance: float = 1e-9) -> FloatArray:
    """ℓ₁ norm Σ_k |g_ij(k)| of each entry, shape (p, q): the largest peak of output i for |input j| ≤ 1.

    The impulse response is summed over N samples; as A^(jN) shrinks like ‖A^N‖^j, what follows is at most
    Σ_{k<N} ‖C A^k‖ ‖B‖ ‖A^N‖/(1 − ‖A^N‖). N doubles until that is below `tolerance` of the sum, and it is added, so the
    value never lies below the norm.

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
    while N < _LONGEST:
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
