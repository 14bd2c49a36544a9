"""Generated kernels against CasADi's integrator-free Runge–Kutta and its exact Jacobian, and against cases solved by hand."""

import casadi as ca
import numpy as np
import pytest

from residuum.identification.physics import Experiment, Simulator, load_model, read_model

DRIVE = """name: drive with everything smooth
inputs: {voltage: V}
states: {theta: {unit: rad, rate: omega}, omega: {unit: rad/s}, T: {unit: K}}
parameters:
  K: {value: 0.07, unit: V*s/rad}
  R: {value: 0.75, unit: ohm}
  J: {value: 2.5e-3, unit: kg*m**2}
  C: {value: 20, unit: J/K}
  h: {value: 0.5, unit: W/K}
  a: {value: 0.004, unit: 1/K}
balances:
  shaft: {kind: torque, storage: J * der(omega) * (1 + 0.1 * sin(theta)), terms: {motor: K * i}, position: theta, velocity: omega}
  winding: {kind: voltage, storage: 0, terms: {u: voltage, r: -R * (1 + a * T) * i, e: -K * omega}, current: i}
  copper: {kind: heat, storage: C * der(T), terms: {loss: R * i**2, out: -h * T}, temperature: T}
outputs: {speed: {value: omega, unit: rad/s}, current: {value: i, unit: A}, T: {value: T, unit: K}}
"""


def record(n=400, outputs=3, sample_time=0.01):
    t = np.arange(n) * sample_time
    U = (12 * np.sin(2.0 * t) + 3 * np.sign(np.sin(11 * t)))[:, None]
    return Experiment(U, np.full((n, outputs), np.nan), np.zeros(1), sample_time)


def casadi_trajectory(experiment, values, x0, substeps):
    """Outputs and their Jacobian by (J, K, R, a, d, k_3, omega_0) of the same equations, written here by hand."""
    p = ca.SX.sym("p", 7)
    J, K, R, a, d, k3, _ = ca.vertsplit(p)
    C, h = 20.0, 0.5

    def current(x, u):
        return (u - K * x[1]) / (R * (1 + a * x[2]))

    def f(x, u):
        i = current(x, u)
        torque = K * i - d * x[1] - k3 * (x[0] - 0.1) ** 3 - 0.01 * (x[0] - 0.1) ** 2
        return ca.vertcat(x[1], torque / (J * (1 + 0.1 * ca.sin(x[0]))), (R * i**2 - h * x[2]) / C)

    step = experiment.sample_time / substeps
    x_k, u_k = ca.SX.sym("x", 3), ca.SX.sym("u")
    x = x_k
    for _ in range(substeps):
        k1 = f(x, u_k)
        k2 = f(x + step / 2 * k1, u_k)
        k3_ = f(x + step / 2 * k2, u_k)
        x = x + step / 6 * (k1 + 2 * k2 + 2 * k3_ + f(x + step * k3_, u_k))
    advance = ca.Function("advance", [x_k, u_k, p], [x, ca.jacobian(x, x_k), ca.jacobian(x, p)])
    y = ca.vertcat(x_k[1], current(x_k, u_k), x_k[2])
    observe = ca.Function("observe", [x_k, u_k, p], [y, ca.jacobian(y, x_k), ca.jacobian(y, p)])
    x, S = np.array(x0), np.zeros((3, 7))
    S[1, 6] = 1.0
    Y, dY = [], []
    for u in experiment.U[:, 0]:
        y, C_y, D_y = (np.array(m) for m in observe(x, u, values))
        Y.append(y[:, 0])
        dY.append(C_y @ S + D_y)
        x_next, A, B = (np.array(m) for m in advance(x, u, values))
        x, S = x_next[:, 0], A @ S + B
    return np.array(Y), np.array(dY)


def test_states_and_sensitivities_agree_with_casadi():
    model = read_model(DRIVE).with_effect("viscous-friction", "shaft", {"d": 2e-3})
    model = model.with_effect("cubic-spring", "shaft", {"k_3": 0.03, "k_2": 0.01, "q_0": 0.1})
    names = [
        "J",
        "K",
        "R",
        "a",
        "viscous-friction@shaft.d",
        "cubic-spring@shaft.k_3",
        "initial:omega",
    ]
    start = {"theta": 0.4, "omega": 3.0, "T": 5.0}
    run = Simulator(model).run(record(), start, slopes=names, substeps=3)
    Y, dY = casadi_trajectory(
        record(), [*(model.values[n] for n in names[:-1]), 3.0], list(start.values()), 3
    )
    np.testing.assert_allclose(run.Y, Y, rtol=1e-9, atol=1e-9 * np.abs(Y).max())
    scale = np.abs(dY).max(axis=(0, 1))
    np.testing.assert_allclose(run.dY / scale, dY / scale, rtol=1e-9, atol=1e-9)


def test_a_first_order_lag_is_its_exponential():
    """The oven at constant duty: T(t) = T_a + P/h (1 − exp(−t h/C))."""
    model = load_model("oven").with_values({"h": 40.0})
    n, sample_time = 200, 30.0
    ambient = np.full(n, 22.0)
    e = Experiment(
        np.column_stack([np.full(n, 50.0), ambient]),
        np.full((n, 1), np.nan),
        np.zeros(2),
        sample_time,
    )
    run = Simulator(model).run(e, {"T": 22.0}, slopes=["h"], substeps=8)
    t = np.arange(n) * sample_time
    P, C, h = 6000.0, 120000.0, 40.0
    np.testing.assert_allclose(run.Y[:, 0], 22.0 + P / h * (1 - np.exp(-t * h / C)), atol=1e-9)
    by_h = -P / h**2 * (1 - np.exp(-t * h / C)) + P / h * t / C * np.exp(-t * h / C)
    np.testing.assert_allclose(run.dY[:, 0, 0], by_h, atol=1e-9)


def test_sliding_mass_stops_where_coulomb_says_and_stays():
    """v₀²/(2 τ_c/M) of travel; then, pushed below τ_c, not a micrometre more; above it, it breaks away."""
    model = (
        load_model("linear-axis")
        .with_values({"M": 2.0})
        .with_effect("coulomb-friction", "axis", {"tau_c": 4.0})
    )
    n, sample_time = 3000, 1e-3
    U = np.zeros((n, 1))
    U[1000:2000], U[2000:] = 3.9, 6.0
    e = Experiment(U, np.full((n, 2), np.nan), np.zeros(1), sample_time)
    run = Simulator(model).run(
        e, {"q": 0.0, "v": 1.0}, slopes=["coulomb-friction@axis.tau_c", "initial:v"]
    )
    q, v = run.Y.T
    assert q[1000] == pytest.approx(0.25, abs=2e-6)
    assert np.ptp(q[1000:2001]) == 0.0
    assert np.all(v[1000:2001] == 0.0)
    assert v[-1] == pytest.approx(1.0 * 0.999, abs=2e-3)
    np.testing.assert_allclose(
        run.dY[1500, 0], [-(1.0**2) * 2 / (2 * 4.0**2), 1.0 * 2 / 4.0], atol=3e-3
    )


def test_current_does_not_flow_below_the_brush_drop():
    model = load_model("gate-drive").with_effect("brush-drop", "winding", {"V_b": 2.0})
    u = np.array([0.0, 1.9, -1.9, 3.0, -3.0])[:, None]
    X = np.zeros((5, 2))
    e = Experiment(u, np.full((5, 2), np.nan), np.zeros(1), 0.01)
    i = Simulator(model).look(e, X)["i"]
    np.testing.assert_allclose(i, np.array([0, 0, 0, 1.0, -1.0]) / model.values["R"], rtol=1e-12)


def test_delay_shifts_the_input():
    model = load_model("process").with_effect("input-delay", "u", {"delay": 0.5})
    U = np.zeros((200, 1))
    U[20:] = 1.0
    e = Experiment(U, np.full((200, 1), np.nan), np.zeros(1), 0.1)
    delayed = Simulator(model).run(e, substeps=20).Y[:, 0]
    plain = Simulator(load_model("process")).run(e, substeps=20).Y[:, 0]
    np.testing.assert_allclose(delayed[5:], plain[:-5], atol=1e-12)


def test_a_diverging_model_is_a_value():
    unstable = read_model(
        """name: runaway
inputs: {u: ''}
states: {x: {unit: ''}}
parameters: {T: {value: 1, unit: s}}
balances: {b: {kind: signal, storage: T * der(x), terms: {grow: x**3, u: u}}}
outputs: {x: {value: x}}
"""
    )
    e = Experiment(np.ones((500, 1)), np.full((500, 1), np.nan), np.zeros(1), 0.1)
    run = Simulator(unstable).run(e, {"x": 2.0})
    assert not run.finite
    assert np.isfinite(run.Y[0]).all()
