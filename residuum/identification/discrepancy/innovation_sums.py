"""Compiled sums over innovations: autoregression, whitening and the scale of t-distributed noise, one pass each."""

# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np
from numba import njit

_FAST = {"reassoc", "contract", "arcp"}  # sums in any order; missing samples stay NaN
FREEDOM = 5.0
"""Degrees of freedom of the innovations: loses 7 % of a normal noise's information."""
_SCALINGS = 12
_STRETCH = 1024
_LOW = 0.53
"""Median of e²/s² for t-distributed e of scale s."""


@njit(cache=True, error_model="numpy", nogil=True, fastmath=_FAST)
def whitened(rows, a):
    """A(z) x of each row x without the first p samples, shape (rows, n − p); NaN where one of its samples is missing."""
    order, count, n = a.shape[0], rows.shape[0], rows.shape[1]
    found = np.empty((count, max(n - order, 0)))
    for row in range(count):
        whiten(rows[row], a, found[row])
    return found


@njit(cache=True, error_model="numpy", nogil=True, fastmath=_FAST)
def whiten(x, a, e):
    """e(t) = x(t) + Σ aᵢ x(t − i) from the sample p on, lag by lag in stretches that stay in the cache."""
    order = a.shape[0]
    for begin in range(0, e.shape[0], _STRETCH):
        end = min(begin + _STRETCH, e.shape[0])
        there = e[begin:end]
        there[:] = x[begin + order : end + order]
        for lag in range(order):
            past, factor = x[begin + order - lag - 1 :], a[lag]
            for t in range(there.shape[0]):
                there[t] += factor * past[t]


@njit(cache=True, error_model="numpy", nogil=True, fastmath=_FAST)
def add_lag_products(v, a, variance, G, g):
    """Add Σ w·φφᵀ (its lower half) to G and Σ w·φ·v(t) to g, φ = v(t−1) … v(t−p), w the t weight of the innovation (1 for
    variance 0, 0 where a sample is missing).

    Returns how many complete rows there were.
    """
    order, rows, count = a.shape[0], 0, v.shape[0] - a.shape[0]
    if count <= 0:
        return 0
    w, known, innovations = np.empty(count), np.empty(v.shape[0]), np.empty(count)
    whiten(v, a, innovations)
    for t in range(v.shape[0]):
        known[t] = v[t] if np.isfinite(v[t]) else 0.0
    for t in range(count):
        e = innovations[t]
        complete = np.isfinite(e)
        rows += complete
        w[t] = 0.0 if not complete else (1.0 if variance == 0.0 else (FREEDOM + 1.0) / (FREEDOM + e * e / variance))
    weighted = np.empty(count)
    for i in range(order):
        past = known[order - i - 1 :]
        for t in range(count):
            weighted[t] = w[t] * past[t]
        g[i] += product(weighted, known[order:], count)
        for j in range(i + 1):
            G[i, j] += product(weighted, known[order - j - 1 :], count)
    return rows


@njit(cache=True, error_model="numpy", nogil=True, fastmath=_FAST)
def product(x, y, count):
    """Σ x·y over the first `count` samples."""
    sum_ = 0.0
    for t in range(count):
        sum_ += x[t] * y[t]
    return sum_


@njit(cache=True, error_model="numpy", nogil=True, fastmath=_FAST)
def squared_scale(e, near):
    """Maximum-likelihood squared scale of t-distributed innovations (none missing), sought from `near` on (0: anywhere)."""
    n = e.shape[0]
    square = e * e
    variance = near
    if near == 0.0:
        variance = max(np.median(square) / _LOW, 1e-24 * np.mean(square), 1e-300)
    for _ in range(_SCALINGS):
        sum_ = 0.0
        for t in range(n):
            sum_ += (FREEDOM + 1.0) * square[t] / (FREEDOM + square[t] / variance)
        before, variance = variance, max(sum_ / n, 1e-300)
        if abs(variance - before) < 1e-6 * before:
            break
    return variance


@njit(cache=True, error_model="numpy", nogil=True)
def scale_of(x, starts, a, near):
    """`squared_scale` of the innovations A(z) x of several signals, signal j being x[starts[j]] … x[starts[j + 1] − 1]."""
    e, count = np.empty(x.shape[0]), 0
    for j in range(starts.shape[0] - 1):
        v = x[starts[j] : starts[j + 1]]
        innovations = np.empty(max(v.shape[0] - a.shape[0], 0))
        whiten(v, a, innovations)
        for one in innovations:
            if np.isfinite(one):
                e[count] = one
                count += 1
    return squared_scale(e[:count], near)


@njit(cache=True, error_model="numpy", nogil=True)
def reweighted(x, starts, a, variance, turns, floor):
    """Coefficients and squared scale after so many turns of reweighted least squares, signals laid out as in `scale_of`.

    White noise of the variance `floor` is taken to lie over the signals, beside what they show of it. No coefficients where
    missing samples leave too few complete rows for them.
    """
    order = a.shape[0]
    for _ in range(turns):
        G, g, rows = np.zeros((order, order)), np.zeros(order), 0
        for j in range(starts.shape[0] - 1):
            rows += add_lag_products(x[starts[j] : starts[j + 1]], a, variance, G, g)
        if rows < 3 * (order + 1):
            return np.zeros(0), scale_of(x, starts, np.zeros(0), 0.0)
        if order:
            ridge = 1e-10 * (np.trace(G) + 1e-300) + floor * rows
            for i in range(order):
                for j in range(i):
                    G[j, i] = G[i, j]
                G[i, i] += ridge
            a = -np.linalg.solve(G, g)
        variance = scale_of(x, starts, a, variance)
    return a, variance


@njit(cache=True, error_model="numpy", nogil=True)
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


@njit(cache=True, error_model="numpy", nogil=True)
def stable(a):
    """Whether all poles of 1/A(z) lie within the unit circle (Levinson's recursion downwards: reflections below one)."""
    a = a.copy()
    for k in range(a.shape[0], 0, -1):
        reflection = a[k - 1]
        if not abs(reflection) < 1.0:
            return False
        a = (a[: k - 1] - reflection * a[: k - 1][::-1]) / (1.0 - reflection**2)
    return True
