"""Integration of generated equations: RK4 with exact sensitivities and exact standstill, Kalman
filter and smoother.

Everything here is compiled once for all models. A model's own equations arrive as a `System`:
compiled functions called by address, so a new structure compiles only its equations (a fraction of
a second), never the integrator.

Sensitivities S = ∂x/∂θ obey dS/dt = A·S + B and are stepped by the same Runge–Kutta scheme, so they
are the exact derivatives of the *computed* trajectory. Columns are chosen by `columns`: j < NP is
parameter j, NP + i the initial value of state i.

Arrays: U (n, inputs), p (NP,), x (NX,), S (NX, columns), A (NX, NX), B (NX, NP + NX; the last NX
columns stay zero), C (NY, NX), D (NY, NP + NX). `u` has one element more than there are inputs: the
time since the record's start.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator"

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import types
from numba.extending import typeof_impl

from residuum.kept_loops import njit

Array = npt.NDArray[np.float64]

# Far below anything that counts, and far above 2e-308, where numbers lose digits and time.
FORGOTTEN = 1e-200
"""Magnitude below which a sensitivity is zero."""


class System(NamedTuple):
    """A model's compiled equations, each `function(x, u, ur, p, s, m, …)` writing through the
    pointers that follow.

    `rates`(dx) · `slopes`(dx, A, B) · `initial`(x, A, B): own states of effects · `outputs`(y) ·
    `output_slopes`(C, D) · `signals`(z); `advance`, `advance_slopes` and `observe` are those of
    `stepping_code`. `sizes` = (NX, NU, NP, NY, NZ); `surfaces`: states that can stand still;
    `delays`: for each input the parameter that delays it, or −1; `own`: states of effects, whose
    initial values follow from the others; `remembered`: those of them that go on in an experiment
    which follows another one in time.
    """

    rates: Any
    slopes: Any
    initial: Any
    outputs: Any
    output_slopes: Any
    signals: Any
    advance: Any
    advance_slopes: Any
    observe: Any
    sizes: npt.NDArray[np.int64]
    surfaces: npt.NDArray[np.int64]
    delays: npt.NDArray[np.int64]
    own: npt.NDArray[np.int64]
    remembered: npt.NDArray[np.int64]


@typeof_impl.register(System)
def _type_of_system(system, context):
    """The numba type that all systems share: found once, for numba would look at every part of a
    system in every call.
    """
    if not _SYSTEM:
        _SYSTEM.append(types.NamedTuple([typeof_impl(part, context) for part in system], System))
    return _SYSTEM[0]


_SYSTEM: list[types.NamedTuple] = []


class Memory(NamedTuple):
    """Working arrays of one run, so that no step allocates.

    x : state; u, ur : inputs (time last) and their slopes; s, m : direction of each surface, and 0
    where it sticks. k, A, B, C, D : rates and Jacobians at one point; S : sensitivities of the
    state, (NX, columns). inputs : u and ur at the beginning, the middle and the end of a step; step
    : its length. work, seen : of the generated `advance` and `observe`.
    """

    x: Array
    u: Array
    ur: Array
    s: Array
    m: Array
    k: Array
    A: Array
    B: Array
    C: Array
    D: Array
    S: Array
    inputs: Array
    step: Array
    work: Array
    seen: Array


@njit()
def new_memory(q, count):
    """Working arrays for `count` sensitivity columns."""
    nx, nu, n_p, ny, ns = q.sizes[0], q.sizes[1], q.sizes[2], q.sizes[3], q.surfaces.shape[0]
    # Columns of A and B together, as `stepping_code` lays them out in its working memory.
    width = n_p + 2 * nx
    return Memory(
        np.zeros(nx),
        np.zeros(nu + 1),
        np.zeros(nu + 1),
        np.zeros(ns + 1),
        np.zeros(ns + 1),
        np.zeros(nx),
        np.zeros((nx, nx)),
        np.zeros((nx, n_p + nx)),
        np.zeros((ny, nx)),
        np.zeros((ny, n_p + nx)),
        np.zeros((nx, count)),
        np.zeros((3, 2 * (nu + 1))),
        np.zeros(1),
        np.zeros(5 * nx + 4 * nx * width),
        np.zeros(ny * width),
    )


@njit(error_model="numpy", inline="always")
def interpolated(U, j, position, delayed):
    """Input j at a position in samples, and its step from the sample before that to the one
    after.
    """
    # Before the record its first sample holds, after it the last one: nothing is extrapolated.
    last = U.shape[0] - 1
    position = min(max(position, 0.0), float(last))
    i = min(int(position), max(last - 1, 0))
    # On a sample the slope is that to the left, where a longer delay leads.
    if delayed and position == i and i > 0:
        i = i - 1
    step = U[min(i + 1, last), j] - U[i, j]
    return U[i, j] + (position - i) * step, step


@njit(error_model="numpy")
def set_inputs(delays, u, ur, U, k, c, sample_time, hold, p):
    """Inputs at time (k + c) samples: held (`hold` 0) or linear between samples (1); delayed ones
    interpolated.

    A held signal delayed by a fraction of a sample takes, over the sample, its mean: the same
    interpolation. Before the record began, its first sample is taken to have lasted.
    """
    for j in range(U.shape[1]):
        # A held input stays at its sample k whatever part c of the step has passed.
        position = k + c * hold[j]
        delayed = delays[j] >= 0
        if delayed:
            position = position - p[delays[j]] / sample_time
        u[j], step = interpolated(U, j, position, delayed)
        # Before the record began the first sample lasted: no slope there.
        ur[j] = 0.0 if position <= 0.0 else step / sample_time
    # The time is the last input: equations may name it.
    u[U.shape[1]] = (k + c) * sample_time


@njit(error_model="numpy")
def lags_of(delays, sample_time, p):
    """Delay of each input in samples; none where one is not delayed, −1 of each that is not where
    others are.
    """
    lags = np.full(delays.shape[0], -1.0)
    some = False
    for j in range(delays.shape[0]):
        if delays[j] >= 0:
            lags[j] = p[delays[j]] / sample_time
            some = True
    return lags if some else lags[:0]


@njit(error_model="numpy", inline="always")
def set_stages(inputs, U, k, c, ch, sample_time, hold):
    """Inputs of a step of `ch` samples from (k + c) samples on, none of them delayed."""
    # At the last sample there is no next one: the input stays.
    following = min(k + 1, U.shape[0] - 1)
    for i in range(3):
        # Runge and Kutta ask for the beginning, the middle and the end of a step.
        at = c + 0.5 * i * ch
        for j in range(U.shape[1]):
            inputs[i, j] = U[k, j] + at * hold[j] * (U[following, j] - U[k, j])
        inputs[i, U.shape[1]] = (k + at) * sample_time


@njit(error_model="numpy", inline="always")
def set_delayed_stages(inputs, lags, U, k, c, ch, sample_time, hold):
    """Inputs of a step where some are delayed, with their slopes, as `set_inputs` has them."""
    width = U.shape[1] + 1
    for i in range(3):
        at = c + 0.5 * i * ch
        for j in range(U.shape[1]):
            position = k + at * hold[j] - max(lags[j], 0.0)
            inputs[i, j], step = interpolated(U, j, position, lags[j] >= 0.0)
            inputs[i, width + j] = 0.0 if position <= 0.0 else step / sample_time
        inputs[i, U.shape[1]] = (k + at) * sample_time


@njit(error_model="numpy", inline="always")
def slip_or_stick(rates, at_x, at_u, at_ur, at_p, at_s, at_m, at_k, at_A, at_B, s, m, k, i, j):
    """Slip where f⁺ > 0 or f⁻ < 0, stick otherwise, for surface j, whose state i is zero (f⁺ = f⁻:
    no friction, no sticking).

    Returns f⁺ and f⁻, the state's rates on both sides.
    """
    m[j] = 1.0
    s[j] = 1.0
    rates(at_x, at_u, at_ur, at_p, at_s, at_m, at_k, at_A, at_B)
    # The rate on the side v > 0, that of f⁺.
    forward = k[i]
    s[j] = -1.0
    rates(at_x, at_u, at_ur, at_p, at_s, at_m, at_k, at_A, at_B)
    # The rate on the side v < 0, that of f⁻.
    backward = k[i]
    # Where both sides drive away from zero the stronger one decides.
    if forward > 0.0 and forward + backward >= 0.0:
        s[j] = 1.0
    elif backward < 0.0:
        s[j] = -1.0
    else:
        s[j] = 0.0
        # Without friction at the surface there is nothing that could hold it: it passes through.
        m[j] = 1.0 if forward == backward else 0.0
    return forward, backward


@njit(error_model="numpy")
def resolve_standstill(q, w, p, j):
    """`slip_or_stick` by the inputs in `w`."""
    x, u, ur, s, m, k, A, B = w.x, w.u, w.ur, w.s, w.m, w.k, w.A, w.B
    i = q.surfaces[j]
    return slip_or_stick(
        q.rates,
        x.ctypes,
        u.ctypes,
        ur.ctypes,
        p.ctypes,
        s.ctypes,
        m.ctypes,
        k.ctypes,
        A.ctypes,
        B.ctypes,
        s,
        m,
        k,
        i,
        j,
    )


@njit(error_model="numpy", inline="always")
def set_directions(x, surfaces, s, m):
    """Direction of every surface: the sign of its state. True when one of them stands still."""
    standing = False
    for j in range(surfaces.shape[0]):
        v = x[surfaces[j]]
        # An exact zero is a standstill: the state was set to it by `land`, or begins there.
        s[j] = 1.0 if v > 0.0 else (-1.0 if v < 0.0 else 0.0)
        m[j] = 1.0
        standing = standing or v == 0.0
    return standing


@njit(error_model="numpy", inline="always")
def crossed(x, surfaces, s, m):
    """Whether a step has left the side of a surface that it was computed for."""
    has_crossed = False
    for j in range(surfaces.shape[0]):
        has_crossed = has_crossed or (m[j] > 0.0 and s[j] * x[surfaces[j]] < 0.0)
    return has_crossed


@njit(error_model="numpy")
def stand(q, w, U, k, c, sample_time, hold, p):
    """Directions of the surfaces that stand still, by the forces at time (k + c) samples (the
    middle of the step).
    """
    set_inputs(q.delays, w.u, w.ur, U, k, c, sample_time, hold, p)
    for j in range(q.surfaces.shape[0]):
        if w.s[j] == 0.0:
            resolve_standstill(q, w, p, j)


@njit(error_model="numpy")
def land(q, w, p, columns):
    """After a step: bring every surface that was crossed, and where the machine sticks, to zero.

    Where it slips on, the rest of the step after the crossing was walked at the rate of the side
    that it left: the state is scaled to the rate of the side that it is on, and its derivatives
    with it (the saltation of Aizerman and Gantmacher 1958).
    """
    for j in range(q.surfaces.shape[0]):
        i = q.surfaces[j]
        reached, side = w.x[i], w.s[j]
        # It rests, or is still on its side: nothing to land.
        if w.m[j] == 0.0 or side * reached >= 0.0:
            continue
        w.x[i] = 0.0
        forward, backward = resolve_standstill(q, w, p, j)
        # The rates on the side that it came from, and on the one that it may go on to.
        left, entered = (forward, backward) if side > 0.0 else (backward, forward)
        if w.m[j] == 0.0:
            # At rest the state is zero whatever the parameters: its derivatives are, too.
            w.S[i, :] = 0.0
        elif left * entered > 0.0:
            # x ← reached·entered/left; so S is scaled, and the change of that ratio with the
            # parameters is added: −reached·entered/left² ∂left and reached/left ∂entered.
            there_side = w.s[j]
            w.S[i, :] *= entered / left
            add_rate_slopes(q, w, p, columns, j, side, -reached * entered / left**2)
            add_rate_slopes(q, w, p, columns, j, there_side, reached / left)
            # Last: the derivatives above are those at zero, where x[i] stood until here.
            w.x[i] = reached * entered / left
        else:
            w.x[i] = reached


@njit(error_model="numpy")
def add_rate_slopes(q, w, p, columns, j, side, factor):
    """Add to the derivatives of surface j's state those of its rate on one side, times a factor."""
    i = q.surfaces[j]
    w.s[j] = side
    q.slopes(
        w.x.ctypes,
        w.u.ctypes,
        w.ur.ctypes,
        p.ctypes,
        w.s.ctypes,
        w.m.ctypes,
        w.k.ctypes,
        w.A.ctypes,
        w.B.ctypes,
    )
    for c in range(columns.shape[0]):
        slope = w.B[i, columns[c]]
        for state in range(w.x.shape[0]):
            # At the crossing the own state is zero whatever the parameters: only the others carry
            # slopes.
            if state != i:
                slope += w.A[i, state] * w.S[state, c]
        w.S[i, c] += factor * slope


@njit(error_model="numpy")
def integrate(  # noqa: PLR0912
    q, w, U, first, last, sample_time, substeps, hold, p, columns, X, Y, dY
):
    """From sample `first` to `last`, `substeps` Runge–Kutta steps a sample; w.x and, for the
    columns, w.S are overwritten.

    States, outputs and output slopes before each sample's steps, and at the last, go to the rows of
    X, Y and dY, from the first row on (of no rows: nothing is kept). Stops where a state ceases to
    be finite. Arrays are bound once, what every step needs is inlined, and inputs are looked up the
    long way only where one is delayed: each of these would cost more than the step.
    """
    x, u, ur, s, m, S, inputs, surfaces, count = (
        w.x,
        w.u,
        w.ur,
        w.s,
        w.m,
        w.S,
        w.inputs,
        q.surfaces,
        columns.shape[0],
    )
    at_x, at_u, at_ur, at_p, at_s, at_m = (
        x.ctypes,
        u.ctypes,
        ur.ctypes,
        p.ctypes,
        s.ctypes,
        m.ctypes,
    )
    at_0, at_1, at_2 = inputs[0].ctypes, inputs[1].ctypes, inputs[2].ctypes
    at_1r, at_k, at_A, at_B = inputs[1, U.shape[1] + 1 :].ctypes, w.k.ctypes, w.A.ctypes, w.B.ctypes
    at_S, at_columns, at_step, at_work, at_seen = (
        S.ctypes,
        columns.ctypes,
        w.step.ctypes,
        w.work.ctypes,
        w.seen.ctypes,
    )
    # ch: the part of a sample that a step takes.
    recording, ch, lags = X.shape[0] > 0, 1.0 / substeps, lags_of(q.delays, sample_time, p)
    delayed = lags.shape[0] > 0
    w.step[0] = sample_time / substeps
    # Slopes of inputs that are not delayed stay zero: no stage writes them.
    inputs[:] = 0.0
    for k in range(first, last + 1):
        if recording:
            # A state that is not finite stays so: the rows behind keep their NaN.
            if not keep(x, X[k - first]):
                return
            if delayed:
                set_inputs(q.delays, u, ur, U, k, 0.0, sample_time, hold, p)
            else:
                u[: U.shape[1]] = U[k]
                u[U.shape[1]] = k * sample_time
            at_y, at_dy = Y[k - first].ctypes, dY[k - first].ctypes
            q.observe(
                at_x, at_u, at_ur, at_p, at_s, at_m, at_seen, at_y, at_dy, at_S, at_columns, count
            )
        # The last sample is observed, but nothing is known of the inputs after it.
        if k == last:
            return
        for step in range(substeps):
            c = step * ch
            if delayed:
                set_delayed_stages(inputs, lags, U, k, c, ch, sample_time, hold)
            else:
                set_stages(inputs, U, k, c, ch, sample_time, hold)
            if set_directions(x, surfaces, s, m):  # by the forces in the middle of the step
                for j in range(surfaces.shape[0]):
                    if s[j] == 0.0:
                        slip_or_stick(
                            q.rates,
                            at_x,
                            at_1,
                            at_1r,
                            at_p,
                            at_s,
                            at_m,
                            at_k,
                            at_A,
                            at_B,
                            s,
                            m,
                            w.k,
                            surfaces[j],
                            j,
                        )
            if count > 0:
                q.advance_slopes(
                    at_x,
                    at_0,
                    at_1,
                    at_2,
                    at_p,
                    at_s,
                    at_m,
                    at_work,
                    at_step,
                    at_S,
                    at_columns,
                    count,
                )
            else:
                q.advance(at_x, at_0, at_1, at_2, at_p, at_s, at_m, at_work, at_step)
            if crossed(x, surfaces, s, m):
                set_inputs(q.delays, u, ur, U, k, c + ch, sample_time, hold, p)
                land(q, w, p, columns)
        if count > 0:
            # Once a sample: decayed sensitivities would slow every step down.
            forget(S)


@njit(error_model="numpy")
def forget(S):
    """Sensitivities that have decayed to nothing are zero: a processor takes forty times as long
    for numbers that underflow.
    """
    for i in range(S.shape[0]):
        for c in range(S.shape[1]):
            if abs(S[i, c]) < FORGOTTEN:
                S[i, c] = 0.0


@njit(error_model="numpy", inline="always")
def keep(x, row):
    """Copy the state into its row; whether it is finite."""
    finite = True
    for i in range(x.shape[0]):
        row[i] = x[i]
        finite = finite and np.isfinite(x[i])
    return finite


@njit(error_model="numpy")
def start(q, w, U, sample_time, hold, p, x0):
    """w.x = x0 with the effects' own states set from it, x0 being their deviation; w.A and w.B then
    hold their derivatives.
    """
    w.x[:] = x0
    w.A[:] = 0.0
    w.B[:] = 0.0
    set_inputs(q.delays, w.u, w.ur, U, 0, 0.0, sample_time, hold, p)
    q.initial(
        w.x.ctypes,
        w.u.ctypes,
        w.ur.ctypes,
        p.ctypes,
        w.s.ctypes,
        w.m.ctypes,
        w.x.ctypes,
        w.A.ctypes,
        w.B.ctypes,
    )
    # What x0 holds of an own state is its deviation from where the equation lets it begin.
    for i in q.own:
        w.x[i] += x0[i]


@njit(error_model="numpy")
def start_slopes(q, w, columns):
    """Sensitivities of the initial states: identity, and for the effects' own the chain rule
    besides.
    """
    parameters = w.B.shape[1] - w.x.shape[0]
    for c in range(columns.shape[0]):
        for i in range(w.x.shape[0]):
            w.S[i, c] = 1.0 if columns[c] == parameters + i else 0.0
    # ∂x_own/∂θ = ∂init/∂θ + ∂init/∂x · S, by the chain rule.
    for i in q.own:
        for c in range(columns.shape[0]):
            w.S[i, c] += w.B[i, columns[c]]
            for j in range(w.x.shape[0]):
                w.S[i, c] += w.A[i, j] * w.S[j, c]
    # The stepping code reads only what it writes, and counts on zeros elsewhere.
    w.A[:] = 0.0
    w.B[:] = 0.0


@njit(error_model="numpy")
def observe(q, w, U, k, sample_time, hold, p, y):
    """Outputs of w.x at sample k."""
    set_inputs(q.delays, w.u, w.ur, U, k, 0.0, sample_time, hold, p)
    q.outputs(
        w.x.ctypes,
        w.u.ctypes,
        w.ur.ctypes,
        p.ctypes,
        w.s.ctypes,
        w.m.ctypes,
        y.ctypes,
        w.A.ctypes,
        w.B.ctypes,
    )


@njit(error_model="numpy")
def observe_slopes(q, w, p):
    """C and D of the outputs of w.x (the inputs are those that `observe` set)."""
    q.output_slopes(
        w.x.ctypes,
        w.u.ctypes,
        w.ur.ctypes,
        p.ctypes,
        w.s.ctypes,
        w.m.ctypes,
        w.C.ctypes,
        w.D.ctypes,
        w.B.ctypes,
    )


@njit(error_model="numpy")
def remember(q, w, U, sample_time, hold, p, columns, memory):
    """Values and sensitivities of the remembered states a sample after an experiment's last, in the
    columns of `memory`.

    The derivatives by first states are left out: they are those of this experiment, not of the
    next.
    """
    set_inputs(q.delays, w.u, w.ur, U, U.shape[0] - 1, 0.0, sample_time, hold, p)
    q.rates(
        w.x.ctypes,
        w.u.ctypes,
        w.ur.ctypes,
        p.ctypes,
        w.s.ctypes,
        w.m.ctypes,
        w.k.ctypes,
        w.A.ctypes,
        w.B.ctypes,
    )
    parameters = w.B.shape[1] - w.x.shape[0]
    for number in range(q.remembered.shape[0]):
        i = q.remembered[number]
        # One explicit step of a sample: between two experiments there is no input to integrate
        # along.
        memory[number, columns.shape[0]] = w.x[i] + sample_time * w.k[i]
        for c in range(columns.shape[0]):
            memory[number, c] = w.S[i, c] if columns[c] < parameters else 0.0


@njit(error_model="numpy")
def recall(q, w, memory):
    """The remembered states as they were left."""
    count = memory.shape[1] - 1
    for number in range(q.remembered.shape[0]):
        w.x[q.remembered[number]] = memory[number, count]
        for c in range(count):
            w.S[q.remembered[number], c] = memory[number, c]


@njit(error_model="numpy")
def begin(q, w, U, starts, j, p, X0, sample_times, holds, follows, columns, memory):
    """State and sensitivities at the first sample of experiment j, laid out as in `simulate`."""
    # A window of the same record goes on where the one before ended.
    goes_on = q.remembered.shape[0] > 0 and follows[j] != 0
    if goes_on:
        before = U[starts[j - 1] : starts[j]]
        remember(q, w, before, sample_times[j - 1], holds[j - 1], p, columns, memory)
    # What another experiment left in the working arrays must not reach this one.
    w.s[:] = 0.0
    w.m[:] = 0.0
    start(q, w, U[starts[j] : starts[j + 1]], sample_times[j], holds[j], p, X0[j])
    start_slopes(q, w, columns)
    if goes_on:
        recall(q, w, memory)


@njit(error_model="numpy")
def simulate(q, U, starts, p, X0, sample_times, substeps, holds, follows, columns):
    """States X (n, NX), outputs Y (n, NY) and dY = ∂Y/∂θ (n, NY, columns) at the samples of several
    experiments.

    Experiment j has rows starts[j] … starts[j + 1] − 1 of all these and of U, and its own first
    state X0[j], sample time, sub-steps and hold; one call for all, since a call costs as much as
    hundreds of steps. NaN after a state ceases to be finite. In one that `follows` the one before
    in time, what effects remember (heat, strain) goes on.
    """
    n, w = U.shape[0], new_memory(q, columns.shape[0])
    # NaN first: what an experiment that diverges does not reach stays so.
    X, Y = np.full((n, q.sizes[0]), np.nan), np.full((n, q.sizes[3]), np.nan)
    dY = np.full((n, q.sizes[3], columns.shape[0]), np.nan)
    memory = np.zeros((q.remembered.shape[0], columns.shape[0] + 1))
    for j in range(X0.shape[0]):
        a, b, h = starts[j], starts[j + 1], sample_times[j]
        begin(q, w, U, starts, j, p, X0, sample_times, holds, follows, columns, memory)
        integrate(
            q,
            w,
            U[a:b],
            0,
            b - a - 1,
            h,
            substeps[j],
            holds[j],
            p,
            columns,
            X[a:b],
            Y[a:b],
            dY[a:b],
        )
    return X, Y, dY


@njit(error_model="numpy")
def evaluate_signals(q, U, X, p, sample_time, hold):
    """Signals Z (n, NZ) along given states."""
    Z, w = np.zeros((U.shape[0], q.sizes[4])), new_memory(q, 0)
    for k in range(U.shape[0]):
        w.x[:] = X[k]
        set_inputs(q.delays, w.u, w.ur, U, k, 0.0, sample_time, hold, p)
        q.signals(
            w.x.ctypes,
            w.u.ctypes,
            w.ur.ctypes,
            p.ctypes,
            w.s.ctypes,
            w.m.ctypes,
            Z[k].ctypes,
            w.A.ctypes,
            w.B.ctypes,
        )
    return Z


@njit(error_model="numpy")
def evaluate_outputs(q, U, X, p, sample_time, hold):
    """Outputs Y (n, NY) along given states."""
    Y, w = np.zeros((U.shape[0], q.sizes[3])), new_memory(q, 0)
    for k in range(U.shape[0]):
        w.x[:] = X[k]
        observe(q, w, U, k, sample_time, hold, p, Y[k])
    return Y


@njit(error_model="numpy")
def rate_slopes(q, U, starts, X, p, sample_times, holds, samples):
    """A = ∂f/∂x at the given samples of several experiments laid out as in `simulate`, for the
    choice of sub-steps.

    Samples (experiments, count) are counted from each experiment's first; shape of A (experiments,
    count, NX, NX).
    """
    w = new_memory(q, 0)
    out = np.zeros((samples.shape[0], samples.shape[1], q.sizes[0], q.sizes[0]))
    for j in range(samples.shape[0]):
        a, b = starts[j], starts[j + 1]
        part, h, hold = U[a:b], sample_times[j], holds[j]
        for i in range(samples.shape[1]):
            k = samples[j, i]
            w.x[:] = X[a + k]
            # At standstill the slopes are those of the direction that the forces choose.
            if set_directions(w.x, q.surfaces, w.s, w.m):
                stand(q, w, part, k, 0.0, h, hold, p)
            set_inputs(q.delays, w.u, w.ur, part, k, 0.0, h, hold, p)
            q.slopes(
                w.x.ctypes,
                w.u.ctypes,
                w.ur.ctypes,
                p.ctypes,
                w.s.ctypes,
                w.m.ctypes,
                w.k.ctypes,
                w.A.ctypes,
                w.B.ctypes,
            )
            out[j, i] = w.A
    return out
