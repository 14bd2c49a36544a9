"""How the innovations of a model's Kalman filter answer to a change of a parameter, of a balance, of an input or a reading."""

# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from residuum.identification.physics.simulate.integration import (
    crossed,
    forget,
    lags_of,
    land,
    new_memory,
    set_delayed_stages,
    set_directions,
    set_inputs,
    set_stages,
    stand,
)
from residuum.kept_loops import njit


@njit(error_model="numpy")
def one_step_slopes(q, U, before, after, p, walking, columns, sample_time, substeps, hold):
    """What parameters do within one sample, along the track of a filter.

    Parameters
    ----------
    before, after : array, shape (n, NZ)
        States (NX first) and walking terms before and after each sample was used, as `kalman_filter` gives them.
    walking : array of int
        Places of the walking terms among the parameters p.
    columns : array of int, shape (m,)
        Parameters that the outputs are differentiated by.

    Returns
    -------
    G (n, NX, m) : ∂x(k + 1)/∂θ from the state after sample k.
    C (n, NY, m) : ∂y(k)/∂θ at the state before sample k.
    """
    n, m, ny = U.shape[0], columns.shape[0], q.sizes[3]
    p, w = p.copy(), new_memory(q, m)
    x, u, ur, s, mm, S, inputs, surfaces = w.x, w.u, w.ur, w.s, w.m, w.S, w.inputs, q.surfaces
    nx = x.shape[0]
    G, C = np.zeros((n, nx, m)), np.zeros((n, ny, m))
    y, Hk = np.zeros(ny), np.zeros((ny, m))
    at_x, at_u, at_ur, at_p, at_s, at_m = x.ctypes, u.ctypes, ur.ctypes, p.ctypes, s.ctypes, mm.ctypes
    at_0, at_1, at_2, at_y, at_H = inputs[0].ctypes, inputs[1].ctypes, inputs[2].ctypes, y.ctypes, Hk.ctypes
    at_S, at_columns, at_step, at_work, at_seen = S.ctypes, columns.ctypes, w.step.ctypes, w.work.ctypes, w.seen.ctypes
    ch, lags = 1.0 / substeps, lags_of(q.delays, sample_time, p)
    delayed = lags.shape[0] > 0
    w.step[0] = sample_time / substeps
    for k in range(n):
        S[:] = 0.0
        put(before[k], x, p, walking)
        set_inputs(q.delays, u, ur, U, k, 0.0, sample_time, hold, p)
        q.observe(at_x, at_u, at_ur, at_p, at_s, at_m, at_seen, at_y, at_H, at_S, at_columns, m)
        C[k] = Hk
        if k == n - 1:
            break
        put(after[k], x, p, walking)
        for step in range(substeps):
            c = step * ch
            if set_directions(x, surfaces, s, mm):
                stand(q, w, U, k, c + 0.5 * ch, sample_time, hold, p)
            if delayed:
                set_delayed_stages(inputs, lags, U, k, c, ch, sample_time, hold)
            else:
                set_stages(inputs, U, k, c, ch, sample_time, hold)
            q.advance_slopes(at_x, at_0, at_1, at_2, at_p, at_s, at_m, at_work, at_step, at_S, at_columns, m)
            if crossed(x, surfaces, s, mm):
                set_inputs(q.delays, u, ur, U, k, c + ch, sample_time, hold, p)
                land(q, w, p, columns)
        forget(S)
        G[k] = S
    return G, C


@njit(error_model="numpy", inline="always")
def put(z, x, p, walking):
    """The states of z go to x, its walking terms to their places in p."""
    nx = x.shape[0]
    for i in range(nx):
        x[i] = z[i]
    for j in range(walking.shape[0]):
        p[walking[j]] = z[nx + j]


@njit(error_model="numpy")
def innovation_slopes(P, F, H, e, V, G, C, base, M):  # noqa: PLR0912  one pass over the samples, compiled
    """Derivative of the normalised innovations e/√V by the sizes of m causes, with the filter's gains held.

    Cause j adds M(k, j) times the column base[j] ≥ 0 of G and C, or, where base[j] = −1 − o, M(k, j) to the reading of output o.

    Returns
    -------
    J (n, NY, m) : zero where nothing was measured.
    """
    n, ny, nz = H.shape
    nx, m = G.shape[1], base.shape[0]
    J, D, moved = np.zeros((n, ny, m)), np.zeros((nz, m)), np.zeros((nz, m))
    gain, Pk = np.zeros(nz), np.zeros((nz, nz))
    for k in range(n):
        Pk[:] = P[k]
        for o in range(ny):
            if not np.isfinite(e[k, o]):
                continue
            scale = 1.0 / np.sqrt(V[k, o])
            for i in range(nz):
                total = 0.0
                for g in range(nz):
                    total += Pk[i, g] * H[k, o, g]
                gain[i] = total / V[k, o]
            for i in range(nz):
                for g in range(nz):
                    Pk[i, g] -= gain[i] * gain[g] * V[k, o]
            for j in range(m):
                b = base[j]
                seen = C[k, o, b] * M[k, j] if b >= 0 else (M[k, j] if b == -1 - o else 0.0)
                for i in range(nz):
                    seen += H[k, o, i] * D[i, j]
                J[k, o, j] = seen * scale
                for i in range(nz):
                    D[i, j] -= gain[i] * seen
        if k == n - 1:
            break
        for i in range(nz):
            for j in range(m):
                moved[i, j] = 0.0
            for g in range(nz):
                f = F[k, i, g]
                if f != 0.0:
                    for j in range(m):
                        moved[i, j] += f * D[g, j]
            if i < nx:
                for j in range(m):
                    if base[j] >= 0:
                        moved[i, j] += G[k, i, base[j]] * M[k, j]
        D[:] = moved
    return J
