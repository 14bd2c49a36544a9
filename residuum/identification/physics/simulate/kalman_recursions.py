"""The compiled recursions of the extended Kalman filter, its smoother and its predictor, for any
`System`.
"""

# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from residuum.identification.physics.simulate.integration import (
    crossed,
    forget,
    integrate,
    lags_of,
    land,
    new_memory,
    observe,
    set_delayed_stages,
    set_directions,
    set_inputs,
    set_stages,
    stand,
)
from residuum.kept_loops import njit


@njit(error_model="numpy", inline="always")
def update(z, P, H, y, k, Y, r, e, V, before, gain):
    """Use the outputs of sample k, one after the other; z and P are overwritten, e[k] and V[k]
    receive the innovations.
    """
    nz = z.shape[0]
    before[:] = z
    for o in range(r.shape[0]):
        if not np.isfinite(Y[k, o]):
            continue
        # Outputs of one sample have independent noises, so they may be used one after the other:
        # each update divides by a number, and no matrix is inverted.
        residual, variance = Y[k, o] - y[o], r[o]
        for i in range(nz):
            # y was observed at the prediction: what earlier outputs of this sample moved since is
            # taken off in its linear part.
            residual -= H[o, i] * (z[i] - before[i])
            gain[i] = 0.0
            for j in range(nz):
                gain[i] += P[i, j] * H[o, j]
        for i in range(nz):
            variance += H[o, i] * gain[i]
        e[k, o], V[k, o] = residual, variance
        for i in range(nz):
            z[i] += gain[i] * residual / variance
            for j in range(nz):
                # gain holds P·Hᵀ, not yet divided: so the update stays symmetric.
                P[i, j] -= gain[i] * gain[j] / variance


@njit(error_model="numpy")
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
        # Half is computed and mirrored: rounding would let the halves drift apart.
        for j in range(i + 1):
            total = Q[i, j]
            for g in range(nz):
                total += work[i, g] * F[j, g]
            P[i, j] = total
            P[j, i] = total


@njit(error_model="numpy")
def kalman_filter(q, U, Y, p, z0, P0, Q, r, columns, sample_time, substeps, hold):
    """Extended Kalman filter of the states and of some parameters that walk at random (the missing
    terms).

    z = (x, w) with w the parameters `columns[NX:]`; `columns` begins with the NX initial-state
    columns. The outputs' noises are independent with variances r; a missing sample is passed over.

    Returns
    -------
    z (n, NZ), P (n, NZ, NZ) : before the sample is used.
    F (n, NZ, NZ) : transition from sample k to k + 1.
    H (n, NY, NZ), e (n, NY), V (n, NY) : output slopes, innovations and their variances (NaN where
        nothing was measured).
    filtered (n, NZ) : after the sample was used.

    A sample is stepped here as `integrate` does it: to call it for one sample costs three times as
    much as the step.
    """
    n, nz, ny = U.shape[0], columns.shape[0], Y.shape[1]
    z, P, F = np.full((n, nz), np.nan), np.zeros((n, nz, nz)), np.zeros((n, nz, nz))
    H, e, V = np.zeros((n, ny, nz)), np.full((n, ny), np.nan), np.full((n, ny), np.nan)
    filtered, y, Hk, work = (
        np.full((n, nz), np.nan),
        np.zeros(ny),
        np.zeros((ny, nz)),
        np.zeros((nz, nz)),
    )
    p, zk, Pk, w, before, gain = (
        p.copy(),
        z0.copy(),
        P0.copy(),
        new_memory(q, nz),
        np.zeros(nz),
        np.zeros(nz),
    )
    x, u, ur, s, m, S, inputs, surfaces, nx = (
        w.x,
        w.u,
        w.ur,
        w.s,
        w.m,
        w.S,
        w.inputs,
        q.surfaces,
        w.x.shape[0],
    )
    at_x, at_u, at_ur, at_p, at_s, at_m = (
        x.ctypes,
        u.ctypes,
        ur.ctypes,
        p.ctypes,
        s.ctypes,
        m.ctypes,
    )
    at_0, at_1, at_2, at_y, at_H = (
        inputs[0].ctypes,
        inputs[1].ctypes,
        inputs[2].ctypes,
        y.ctypes,
        Hk.ctypes,
    )
    at_S, at_columns, at_step, at_work, at_seen = (
        S.ctypes,
        columns.ctypes,
        w.step.ctypes,
        w.work.ctypes,
        w.seen.ctypes,
    )
    ch, lags = 1.0 / substeps, lags_of(q.delays, sample_time, p)
    delayed = lags.shape[0] > 0
    w.step[0] = sample_time / substeps
    # A sample: the prediction is kept, its readings are used, and the state is carried to the next.
    for k in range(n):
        z[k], P[k] = zk, Pk
        place(zk, x, p, columns)
        for i in range(nx):
            for j in range(nz):
                # S begins at the identity, so that after the sample it is the transition F.
                S[i, j] = 1.0 if i == j else 0.0
        set_inputs(q.delays, u, ur, U, k, 0.0, sample_time, hold, p)
        q.observe(at_x, at_u, at_ur, at_p, at_s, at_m, at_seen, at_y, at_H, at_S, at_columns, nz)
        update(zk, Pk, Hk, y, k, Y, r, e, V, before, gain)
        H[k], filtered[k] = Hk, zk
        # Nothing is predicted beyond the record.
        if k == n - 1:
            break
        place(zk, x, p, columns)
        for step in range(substeps):
            c = step * ch
            if set_directions(x, surfaces, s, m):
                # Directions at standstill are chosen by the forces in the middle of the step, as
                # `integrate` does.
                stand(q, w, U, k, c + 0.5 * ch, sample_time, hold, p)
            if delayed:
                set_delayed_stages(inputs, lags, U, k, c, ch, sample_time, hold)
            else:
                set_stages(inputs, U, k, c, ch, sample_time, hold)
            q.advance_slopes(
                at_x, at_0, at_1, at_2, at_p, at_s, at_m, at_work, at_step, at_S, at_columns, nz
            )
            if crossed(x, surfaces, s, m):
                set_inputs(q.delays, u, ur, U, k, c + ch, sample_time, hold, p)
                land(q, w, p, columns)
        forget(S)
        zk[:nx] = x
        F[k, :nx] = S
        for i in range(nx, nz):
            # A missing term walks at random: without news it stays what it was.
            F[k, i, i] = 1.0
        # A filter that diverges leaves NaN behind, and its likelihood says so.
        if not np.isfinite(zk.sum()):
            break
        propagate(F[k], Pk, Q, work)
    return z, P, F, H, e, V, filtered


@njit(error_model="numpy", inline="always")
def place(z, x, p, columns):
    """The states of z go to x, its missing terms to their places in p."""
    for i in range(z.shape[0]):
        if i < x.shape[0]:
            x[i] = z[i]
        else:
            p[columns[i]] = z[i]


@njit(error_model="numpy")
def smooth(z, P, F, H, e, V):
    """Smoothed z and the diagonal of its covariance by the adjoint recursion of Bryson and Frazier
    (nothing is inverted).
    """
    n, nz = z.shape
    Z, variance = np.zeros((n, nz)), np.zeros((n, nz))
    adjoint, Adjoint, work = np.zeros(nz), np.zeros((nz, nz)), np.zeros((nz, nz))
    gains, none, Pk, beside = (
        np.zeros((e.shape[1], nz)),
        np.zeros((nz, nz)),
        np.zeros((nz, nz)),
        np.zeros(nz),
    )
    # Backwards: the adjoint gathers what all later readings say of the state at k.
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            transposed_times(F[k], adjoint, beside)
            propagate(F[k].T, Adjoint, none, work)
        # The gains of the outputs are those of the forward pass: computed anew, for to keep them
        # would cost n·NY·NZ.
        Pk[:] = P[k]
        output_gains(Pk, H[k], e[k], V[k], gains)
        # The last output used is the first to be passed on the way back.
        for o in range(e.shape[1] - 1, -1, -1):
            if np.isfinite(e[k, o]):
                pass_output(adjoint, Adjoint, H[k, o], gains[o], e[k, o], V[k, o], beside)
        for i in range(nz):
            Z[k, i] = z[k, i]
            variance[k, i] = P[k, i, i]
            for j in range(nz):
                Z[k, i] -= P[k, i, j] * adjoint[j]
                for g in range(nz):
                    variance[k, i] -= P[k, i, j] * Adjoint[j, g] * P[k, g, i]
            # A difference of nearly equal numbers may end below zero by rounding.
            variance[k, i] = max(variance[k, i], 0.0)
    return Z, variance


@njit(error_model="numpy", inline="always")
def transposed_times(F, v, work):
    """v ← Fᵀ·v."""
    work[:] = 0.0
    for i in range(v.shape[0]):
        for j in range(v.shape[0]):
            work[j] += F[i, j] * v[i]
    v[:] = work


@njit(error_model="numpy", inline="always")
def output_gains(P, H, e, V, gains):
    """Kalman gain P·Hᵀ/V of each output of one sample, taken one after the other; P is
    overwritten.
    """
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


@njit(error_model="numpy", inline="always")
def pass_output(adjoint, Adjoint, a, gain, e, V, Ag):
    """Carry the adjoint vector and matrix back across one used output with slope a."""
    nz = a.shape[0]
    # λ ← λ − a·(e/V + gᵀλ) and Λ ← (I − g aᵀ)ᵀ Λ (I − g aᵀ) + a aᵀ/V, g the gain: Bryson and
    # Frazier.
    inner = e / V
    Ag[:] = 0.0
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


@njit(error_model="numpy")
def predict_ahead(q, U, filtered, p, columns, steps, sample_time, substeps, hold):
    """Outputs at sample k + steps predicted from the filtered state at k, shape (n, NY); NaN in the
    first `steps` rows.
    """
    n, w = U.shape[0], new_memory(q, 0)
    Y = np.full((n, q.sizes[3]), np.nan)
    nx, p, no_columns = w.x.shape[0], p.copy(), np.zeros(0, dtype=np.int64)
    none, none3 = np.zeros((0, 0)), np.zeros((0, 0, 0))
    # Each prediction is a simulation of its own from the filtered state, with the terms held as
    # they were there.
    for k in range(n - steps):
        w.x[:] = filtered[k, :nx]
        for i in range(nx, columns.shape[0]):
            p[columns[i]] = filtered[k, i]
        integrate(
            q, w, U, k, k + steps, sample_time, substeps, hold, p, no_columns, none, none, none3
        )
        observe(q, w, U, k + steps, sample_time, hold, p, Y[k + steps])
    return Y
