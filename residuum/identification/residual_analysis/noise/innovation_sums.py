"""Compiled sums over innovations: autoregression, whitening, normal equations and likelihood of t-distributed noise.

They run without the interpreter's lock, so that candidates are judged side by side.
"""

# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from residuum.identification.residual_analysis.noise.noise_poles import within
from residuum.identification.residual_analysis.policy.noise import (
    FREEDOM,
    INNOVATION_STRETCH,
    LEAST_SPREAD,
    LOG_DENSITY_AT_ZERO,
    MEDIAN_SQUARE,
    SCALINGS,
    ZERO_INNOVATION,
)
from residuum.kept_loops import njit

_FAST = {"reassoc", "contract", "arcp"}  # sums in any order; missing samples stay NaN


@njit(error_model="numpy", fastmath=_FAST)
def whitened(rows, a):
    """A(z) x of each row x without the first p samples, shape (rows, n − p); NaN where one of its samples is missing."""
    order, count, n = a.shape[0], rows.shape[0], rows.shape[1]
    found = np.empty((count, max(n - order, 0)))
    for row in range(count):
        whiten(rows[row], a, found[row])
    return found


@njit(error_model="numpy", fastmath=_FAST)
def whiten(x, a, e):
    """e(t) = x(t) + Σ aᵢ x(t − i) from the sample p on, lag by lag in stretches that stay in the cache."""
    order = a.shape[0]
    for begin in range(0, e.shape[0], INNOVATION_STRETCH):
        end = min(begin + INNOVATION_STRETCH, e.shape[0])
        there = e[begin:end]
        there[:] = x[begin + order : end + order]
        for lag in range(order):
            past, factor = x[begin + order - lag - 1 :], a[lag]
            for t in range(there.shape[0]):
                there[t] += factor * past[t]


@njit(error_model="numpy", fastmath=_FAST)
def add_lag_products(v, a, variance, G, g):
    """Add Σ w·φφᵀ (its lower half) to G and Σ w·φ·v(t) to g, where φ = v(t−1) … v(t−p). w is the weight of Student's t of the
    innovation (1 for variance 0, 0 where a sample is missing).

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


@njit(error_model="numpy", fastmath=_FAST)
def product(x, y, count):
    """Σ x·y over the first `count` samples."""
    sum_ = 0.0
    for t in range(count):
        sum_ += x[t] * y[t]
    return sum_


@njit(error_model="numpy", fastmath=_FAST)
def squared_scale(e, near, floor):
    """Maximum-likelihood squared scale of t-distributed innovations (none missing), sought from `near` on (0: anywhere).

    It is at least a part of `floor`, the variance that coarse steps hide; and where most innovations are zero (a machine that
    stands) a part of theirs. Otherwise the likelihood has no top.
    """
    n = e.shape[0]
    square = e * e
    mean, zeros = np.mean(square), 0
    for one in square:
        zeros += one <= ZERO_INNOVATION * mean
    least = max(LEAST_SPREAD * max(mean if 2 * zeros > n else 0.0, floor), 1e-300)
    variance = near
    if near == 0.0:
        variance = max(np.median(square) / MEDIAN_SQUARE, 1e-24 * mean)
    variance = max(variance, least)
    for _ in range(SCALINGS):
        sum_ = 0.0
        for t in range(n):
            sum_ += (FREEDOM + 1.0) * square[t] / (FREEDOM + square[t] / variance)
        before, variance = variance, max(sum_ / n, least)
        if abs(variance - before) < 1e-6 * before:
            break
    return variance


@njit(error_model="numpy")
def scale_of(x, starts, a, near, floor):
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
    return squared_scale(e[:count], near, floor)


@njit(error_model="numpy")
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
            return np.zeros(0), scale_of(x, starts, np.zeros(0), 0.0, floor)
        if order:
            ridge = 1e-10 * (np.trace(G) + 1e-300) + floor * rows
            for i in range(order):
                for j in range(i):
                    G[j, i] = G[i, j]
                G[i, i] += ridge
            a = -np.linalg.solve(G, g)
        variance = scale_of(x, starts, a, variance, floor)
    return a, variance


@njit(error_model="numpy")
def autoregression(x, starts, a, variance, turns, floor, radius):
    """`reweighted`, its poles kept within the circle of this radius and the scale found again where that moved them."""
    a, variance = reweighted(x, starts, a, variance, turns, floor)
    a, moved = within(a, radius)
    return a, scale_of(x, starts, a, variance, floor) if moved else variance


@njit(error_model="numpy")
def log_density(e, s):
    """Log density of t-distributed innovations of scale s."""
    constant = LOG_DENSITY_AT_ZERO - np.log(s)
    return constant - 0.5 * (FREEDOM + 1.0) * np.log1p((e / s) ** 2 / FREEDOM)
