"""The mixed-sensitivity cost over plants and frequencies in one pass: the inner loop of every
design.
"""

# mypy: disable-error-code="no-untyped-def,untyped-decorator"

import numpy as np

from residuum.kept_loops import njit


@njit(error_model="numpy")
def rational_response(num, den, z):
    """num(z)/den(z), descending powers, at every z; shape (k,)."""
    response = np.empty(len(z), dtype=np.complex128)
    for k in range(len(z)):
        above, below = 0j, 0j
        for b in num:
            above = above * z[k] + b
        for a in den:
            below = below * z[k] + a
        response[k] = above * np.conj(below) / (below.real**2 + below.imag**2)
    return response


@njit(error_model="numpy")
def weighted_cost(G, K, W_S, W_T, W_K, added):
    """‖(W_S S, W_T T, W_K K S)‖ at every plant and frequency, shape (plants, k); the sum of moduli
    when `added`, else Euclidean.

    G has shape (plants, k), the others (k,).
    """
    cost = np.empty(G.shape)
    for k in range(len(K)):
        effort = (K[k].real ** 2 + K[k].imag ** 2) * W_K[k] ** 2
        for p in range(len(G)):
            L = G[p, k] * K[k]
            loop = (L.real**2 + L.imag**2) * W_T[k] ** 2
            distance = (1.0 + L.real) ** 2 + L.imag**2
            if added:
                cost[p, k] = (W_S[k] + np.sqrt(loop) + np.sqrt(effort)) / np.sqrt(distance)
            else:
                cost[p, k] = np.sqrt((W_S[k] ** 2 + loop + effort) / distance)
    return cost


@njit(error_model="numpy")
def weighted_slopes(G, K, dK, W_S, W_T, W_K, added):
    """(cost, ∂cost/∂ρ) at c points of a plant and a frequency each, shapes (c,) and (c,
    parameters); dK is ∂K/∂ρ there.

    With S = 1/(1 + GK): dS = −S² G dK = −dT, d(KS) = S² dK, and d|X| = Re(X̄ dX)/|X|.
    """
    cost, slope = np.empty(len(G)), np.empty(dK.shape)
    for c in range(len(G)):
        S = 1.0 / (1.0 + G[c] * K[c])
        square = S * S
        X = (W_S[c] * S, W_T[c] * (1.0 - S), W_K[c] * K[c] * S)
        dX = (-W_S[c] * square * G[c], W_T[c] * square * G[c], W_K[c] * square)
        total, factor = 0.0, 0j
        for i in range(3):
            size = np.sqrt(X[i].real ** 2 + X[i].imag ** 2)
            total += size if added else size * size
            factor += np.conj(X[i]) * dX[i] / (max(size, 1e-300) if added else 1.0)
        cost[c] = total if added else np.sqrt(total)
        if not added:
            factor /= max(cost[c], 1e-300)
        for j in range(dK.shape[1]):
            slope[c, j] = (factor * dK[c, j]).real
    return cost, slope
