"""Compiled recursions over an autoregression's coefficients: its poles, and the predictors of a signal's first samples."""

# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from residuum.kept_loops import njit


@njit(error_model="numpy")
def within(a, radius):
    """Coefficients of A(z) with its zeros drawn onto the circle of this radius where they lie beyond, and whether any did."""
    if stable(a / radius ** np.arange(1, a.shape[0] + 1)):
        return a, False
    found = np.zeros(a.shape[0] + 1, dtype=np.complex128)
    found[0] = 1.0
    polynomial = np.ones(a.shape[0] + 1, dtype=np.complex128)
    polynomial[1:] = a
    for number, root in enumerate(np.roots(polynomial)):
        size = abs(root)
        drawn = root * (radius / size) if size > radius else root
        for k in range(number + 1, 0, -1):
            found[k] -= drawn * found[k - 1]
    return found[1:].real.copy(), True


@njit(error_model="numpy")
def first_predictors(a, stable):
    """Levinson's recursion downwards: rows of the scaled predictors of the first p samples, and the logarithms of their spreads.

    Reflection coefficients are kept within ±`stable`.
    """
    order = a.shape[0]
    rows, spreads, spread, a = np.zeros((order, order)), np.zeros(order), 0.0, a.copy()
    for k in range(order, 0, -1):
        reflection = min(max(a[k - 1], -stable), stable)
        left = 1.0 - reflection**2
        spread -= 0.5 * np.log(left)
        a = (a[: k - 1] - reflection * a[: k - 1][::-1]) / left
        rows[k - 1, : k - 1] = np.exp(-spread) * a[::-1]
        rows[k - 1, k - 1] = np.exp(-spread)
        spreads[k - 1] = spread
    return rows, spreads


@njit(error_model="numpy")
def stable(a):
    """Whether all poles of 1/A(z) lie within the unit circle (Levinson's recursion downwards: reflections below one)."""
    a = a.copy()
    for k in range(a.shape[0], 0, -1):
        reflection = a[k - 1]
        if not abs(reflection) < 1.0:
            return False
        a = (a[: k - 1] - reflection * a[: k - 1][::-1]) / (1.0 - reflection**2)
    return True
