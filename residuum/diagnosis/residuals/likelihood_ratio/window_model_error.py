"""What the error of an identified model adds to a window's statistic, compiled for the scans that need it."""

from __future__ import annotations

import numpy as np

from residuum.kept_loops import njit

STEP, RAMP, TEMPLATE = 0, 1, 2


@njit()
def _last(ring, now, count):  # type: ignore[no-untyped-def]
    """The `count` values of a ring that end at position `now`, oldest first."""
    size = len(ring)
    at = (now - count + 1) % size
    values = np.empty(count)
    for i in range(count):
        values[i] = ring[at]
        at += 1
        if at == size:
            at = 0
    return values


@njit(fastmath={"reassoc"})
def _square_norm(root, w, total, enough):  # type: ignore[no-untyped-def]
    """total + ‖Bᵀ w‖², or a part of it that is `enough`: the largest directions come first, so that it soon is."""
    for j in range(root.shape[0]):
        row, part = root[j], 0.0
        for k in range(len(w)):
            part += row[k] * w[k]
        total += part * part
        if total > enough:
            break
    return total


@njit()
def model_error(template, white_input, now, count, delay, root, level, enough, shape):  # type: ignore[no-untyped-def]
    """v (Σ p)² + ‖Bᵀ w‖², Σ_g = B Bᵀ, over the `count` samples that end at ring position `now`, or a part of it that is `enough`.

    `shape` says whether the fault is a step, a ramp or the template; for a step w follows from lag to lag by one sample that
    enters and one that leaves.
    """
    m = root.shape[1]
    past = _last(white_input, now - delay, count + m)
    w = np.zeros(m)
    sum_p = 0.0
    if shape == STEP:
        sum_p = float(count)
        for i in range(count):
            w[0] += past[m + i]
        for k in range(1, m):
            w[k] = w[k - 1] + past[m - k] - past[m - k + count]
    else:
        shapes = np.arange(1.0, count + 1.0) if shape == RAMP else _last(template, now, count)
        for i in range(count):
            p = shapes[i]
            sum_p += p
            for k in range(m):
                w[k] += p * past[m + i - k]
    return _square_norm(root, w, level * sum_p * sum_p, enough)


@njit()
def mean_square(white_input, now, count, delay, root):  # type: ignore[no-untyped-def]
    """Mean of φᵀ Σ_g φ over (at most eight points of) the window."""
    points, m = min(count, 8), root.shape[1]
    total = 0.0
    for point in range(points):
        phi = _last(white_input, now - (point * count) // points - delay, m)[::-1].copy()
        total = _square_norm(root, phi, total, np.inf)
    return total / points
