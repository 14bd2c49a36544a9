"""The compiled recursions of the extended Kalman filter, its smoother and its predictor, for any `System`."""

# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np
from numba import njit

from residuum.identification.physics.integration import integrate, new_memory, observe, observe_slopes


@njit(cache=True, error_model="numpy", nogil=True)
def linearise(q, w, U, k, z, p, columns, sample_time, hold, y, H):
    """Outputs y and their slopes H by z at sample k."""
    nx = w.x.shape[0]
    w.x[:] = z[:nx]
    for i in range(nx, z.shape[0]):
        p[columns[i]] = z[i]
    observe(q, w, U, k, sample_time, hold, p, y)
    observe_slopes(q, w, p)
    for o in range(y.shape[0]):
        for i in range(z.shape[0]):
            H[o, i] = w.C[o, i] if i < nx else w.D[o, columns[i]]


@njit(cache=True, error_model="numpy", nogil=True)
def update(z, P, H, y, measured, r, e, V):
    """Use the outputs of one sample, one after the other; z and P are overwritten, e and V receive the innovations."""
    nz = z.shape[0]
    before = z.copy()
    gain = np.zeros(nz)
    for o in range(measured.shape[0]):
        if not np.isfinite(measured[o]):
            continue
        residual, variance = measured[o] - y[o], r[o]
        for i in range(nz):
            residual -= H[o, i] * (z[i] - before[i])
            gain[i] = 0.0
            for j in range(nz):
                gain[i] += P[i, j] * H[o, j]
        for i in range(nz):
            variance += H[o, i] * gain[i]
        e[o], V[o] = residual, variance
        for i in range(nz):
            z[i] += gain[i] * residual / variance
            for j in range(nz):
                P[i, j] -= gain[i] * gain[j] / variance


@njit(cache=True, error_model="numpy", nogil=True)
def propagate(F, P, Q, work):
    """P ← F·P·Fᵀ + Q, kept symmetric."""
    nz = P.shape[0]
    for i in range(nz):
        for j in range(nz):
            total = 0.0
            for g in range(nz):
                total += F[i, g] * P[g, j]
            work[i, j] = total
    for i in range(nz):
        for j in range(i + 1):
            total = Q[i, j]
            for g in range(nz):
                total += work[i, g] * F[j, g]
            P[i, j] = total
            P[j, i] = total


@njit(cache=True, error_model="numpy", nogil=True)
def kalman_filter(q, U, Y, p, z0, P0, Q, r, columns, sample_time, substeps, hold):
    """Extended Kalman filter of the states and of some parameters that walk at random (the missing terms).

    z = (x, w) with w the parameters `columns[NX:]`; `columns` begins with the NX initial-state columns. The outputs'
    noises are independent with variances r; a missing sample is passed over.

    Returns
    -------
    z (n, NZ), P (n, NZ, NZ) : before the sample is used.
    F (n, NZ, NZ) : transition from sample k to k + 1.
    H (n, NY, NZ), e (n, NY), V (n, NY) : output slopes, innovations and their variances (NaN where nothing was measured).
    filtered (n, NZ) : after the sample was used.
    """
    n, nz, ny = U.shape[0], columns.shape[0], Y.shape[1]
    z, P, F = np.full((n, nz), np.nan), np.zeros((n, nz, nz)), np.zeros((n, nz, nz))
    H, e, V = np.zeros((n, ny, nz)), np.full((n, ny), np.nan), np.full((n, ny), np.nan)
    filtered, y, work = np.full((n, nz), np.nan), np.zeros(ny), np.zeros((nz, nz))
    p, zk, Pk, w = p.copy(), z0.copy(), P0.copy(), new_memory(q, nz)
    nx, none, none3 = w.x.shape[0], np.zeros((0, 0)), np.zeros((0, 0, 0))
    for k in range(n):
        z[k], P[k] = zk, Pk
        linearise(q, w, U, k, zk, p, columns, sample_time, hold, y, H[k])
        update(zk, Pk, H[k], y, Y[k], r, e[k], V[k])
        filtered[k] = zk
        if k == n - 1:
            break
        w.x[:] = zk[:nx]
        w.S[:] = 0.0
        for i in range(nx):
            w.S[i, i] = 1.0
        for i in range(nx, nz):
            p[columns[i]] = zk[i]
            F[k, i, i] = 1.0
        integrate(q, w, U, k, k + 1, sample_time, substeps, hold, p, columns, none, none, none3)
        zk[:nx] = w.x
        F[k, :nx, :] = w.S
        if not np.isfinite(zk.sum()):
            break
        propagate(F[k], Pk, Q, work)
    return z, P, F, H, e, V, filtered


@njit(cache=True, error_model="numpy", nogil=True)
def smooth(z, P, F, H, e, V):
    """Smoothed z and the diagonal of its covariance by the adjoint recursion of Bryson and Frazier (nothing is inverted)."""
    n, nz = z.shape
    Z, variance = np.zeros((n, nz)), np.zeros((n, nz))
    adjoint, Adjoint, work = np.zeros(nz), np.zeros((nz, nz)), np.zeros((nz, nz))
    gains, none = np.zeros((e.shape[1], nz)), np.zeros((nz, nz))
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            adjoint = transposed_times(F[k], adjoint)
            propagate(F[k].T, Adjoint, none, work)
        output_gains(P[k].copy(), H[k], e[k], V[k], gains)
        for o in range(e.shape[1] - 1, -1, -1):
            if np.isfinite(e[k, o]):
                pass_output(adjoint, Adjoint, H[k, o], gains[o], e[k, o], V[k, o])
        for i in range(nz):
            Z[k, i] = z[k, i]
            variance[k, i] = P[k, i, i]
            for j in range(nz):
                Z[k, i] -= P[k, i, j] * adjoint[j]
                for g in range(nz):
                    variance[k, i] -= P[k, i, j] * Adjoint[j, g] * P[k, g, i]
            variance[k, i] = max(variance[k, i], 0.0)
    return Z, variance


@njit(cache=True, error_model="numpy", nogil=True)
def transposed_times(F, v):
    """Fᵀ·v."""
    out = np.zeros(v.shape[0])
    for i in range(v.shape[0]):
        for j in range(v.shape[0]):
            out[j] += F[i, j] * v[i]
    return out


@njit(cache=True, error_model="numpy", nogil=True)
def output_gains(P, H, e, V, gains):
    """Kalman gain P·Hᵀ/V of each output of one sample, taken one after the other; P is overwritten."""
    nz = P.shape[0]
    for o in range(e.shape[0]):
        if not np.isfinite(e[o]):
            continue
        for i in range(nz):
            total = 0.0
            for j in range(nz):
                total += P[i, j] * H[o, j]
            gains[o, i] = total / V[o]
        for i in range(nz):
            for j in range(nz):
                P[i, j] -= gains[o, i] * gains[o, j] * V[o]


@njit(cache=True, error_model="numpy", nogil=True)
def pass_output(adjoint, Adjoint, a, gain, e, V):
    """Carry the adjoint vector and matrix back across one used output with slope a."""
    nz = a.shape[0]
    inner, Ag = e / V, np.zeros(nz)
    for i in range(nz):
        inner += gain[i] * adjoint[i]
        for j in range(nz):
            Ag[i] += Adjoint[i, j] * gain[j]
    quadratic = 1.0 / V
    for i in range(nz):
        quadratic += gain[i] * Ag[i]
    for i in range(nz):
        adjoint[i] -= a[i] * inner
        for j in range(nz):
            Adjoint[i, j] += a[i] * a[j] * quadratic - a[i] * Ag[j] - Ag[i] * a[j]


@njit(cache=True, error_model="numpy", nogil=True)
def predict_ahead(q, U, filtered, p, columns, steps, sample_time, substeps, hold):
    """Outputs at sample k + steps predicted from the filtered state at k, shape (n, NY); NaN in the first `steps` rows."""
    n, w = U.shape[0], new_memory(q, 0)
    Y = np.full((n, q.sizes[3]), np.nan)
    nx, p, no_columns = w.x.shape[0], p.copy(), np.zeros(0, dtype=np.int64)
    none, none3 = np.zeros((0, 0)), np.zeros((0, 0, 0))
    for k in range(n - steps):
        w.x[:] = filtered[k, :nx]
        for i in range(nx, columns.shape[0]):
            p[columns[i]] = filtered[k, i]
        integrate(q, w, U, k, k + steps, sample_time, substeps, hold, p, no_columns, none, none, none3)
        observe(q, w, U, k + steps, sample_time, hold, p, Y[k + steps])
    return Y
