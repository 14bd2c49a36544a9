"""Models that engineers published, as plain functions for SciPy: what the YAML files of `published_models` are held against.

Written from the publications, and sharing nothing with `residuum`. Each `Plant` has its rates ẋ = f(x, u, c) and outputs
y = g(x, u, c), with c the size of an effect that the file does not have; c = 0 is the model as it was published.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

Array = npt.NDArray[np.float64]
Equation = Callable[[Array, Array, float], Sequence[float]]
EXACT, SMALLEST = 1e-10, 1e-13
"""Relative tolerance of the integration, and the absolute one as part of a state's size."""


@dataclass(frozen=True)
class Plant:
    """A published machine, how it is driven, and what it hides.

    Parameters
    ----------
    start : mapping of state to first value
        The states in the equations' order, those of the hidden effect last.
    drive : mapping of input to (lowest, highest)
        Levels drawn between them, each held for 1 to 3 times `hold` samples.
    sizes : sequence of float
        How large each state becomes, for the absolute tolerance.
    hidden : str
        `effect@place` in the catalogue, of size `size`.
    noise : float
        Part of each output's standard deviation.
    """

    rates: Equation
    outputs: Equation
    start: Mapping[str, float]
    drive: Mapping[str, tuple[float, float]]
    sizes: Sequence[float]
    sample_time: float
    samples: int
    hold: int
    hidden: str
    size: float
    noise: float = 0.01
    hidden_states: Mapping[str, float] = field(default_factory=dict)

    def driven(self, seed: int) -> Array:
        """Inputs, shape (samples, inputs)."""
        rng = np.random.default_rng(seed)
        U = np.zeros((self.samples, len(self.drive)))
        for j, (low, high) in enumerate(self.drive.values()):
            k = 0
            while k < self.samples:
                held = int(rng.integers(self.hold, 3 * self.hold + 1))
                U[k : k + held, j] = rng.uniform(low, high)
                k += held
        return U

    def simulated(self, U: Array, size: float) -> Array:
        """Outputs with a hidden effect of this size, shape (samples, outputs); inputs are held over each sample."""
        x = np.array([*self.start.values(), *self.hidden_states.values()])
        absolute = SMALLEST * np.array([*self.sizes, *[1.0] * len(self.hidden_states)])
        changes = np.flatnonzero(np.any(np.diff(U, axis=0) != 0.0, axis=1)) + 1
        Y = []
        for first, last in zip([0, *changes], [*changes, len(U)], strict=True):
            u, times = U[first], self.sample_time * np.arange(last - first + 1)
            solved = solve_ivp(
                lambda _, x, u=u: self.rates(x, u, size),
                (0.0, times[-1]),
                x,
                "LSODA",
                times,
                rtol=EXACT,
                atol=absolute,
            )
            if not solved.success:
                raise ArithmeticError(solved.message)
            Y += [self.outputs(at, u, size) for at in solved.y.T[:-1]]
            x = solved.y[:, -1]
        return np.array(Y)


def _quadruple_tank(x: Array, u: Array, c: float) -> Sequence[float]:
    A_1, A_2, a_1, a_2, g = 28.0, 32.0, 0.071, 0.057, 981.0
    k_1, k_2, gamma_1, gamma_2 = 3.33, 3.35, 0.70, 0.60
    q_1, q_2, q_3, q_4 = np.array([a_1, a_2, a_1, a_2]) * np.sqrt(2.0 * g * np.maximum(x, 0.0))
    leak = c * x[0]
    return [
        (gamma_1 * k_1 * u[0] + q_3 - q_1 - leak) / A_1,
        (gamma_2 * k_2 * u[1] + q_4 - q_2) / A_2,
        ((1.0 - gamma_2) * k_2 * u[1] - q_3) / A_1,
        ((1.0 - gamma_1) * k_1 * u[0] - q_4) / A_2,
    ]


def _battery_branches(s: float) -> tuple[float, float, float, float]:
    R_s = 0.3208 * np.exp(-29.14 * s) + 0.04669
    R_l = 6.603 * np.exp(-155.2 * s) + 0.04984
    C_s = -752.9 * np.exp(-13.51 * s) + 703.6
    C_l = -6056.0 * np.exp(-27.12 * s) + 4475.0
    return R_s, R_l, C_s, C_l


def _battery(x: Array, u: Array, c: float) -> Sequence[float]:
    s, U_s, U_l = x
    R_s, R_l, C_s, C_l = _battery_branches(s)
    i = u[0] + c
    return [-i / 3060.0, (i - U_s / R_s) / C_s, (i - U_l / R_l) / C_l]


def _battery_voltage(x: Array, u: Array, c: float) -> Sequence[float]:
    s, U_s, U_l = x
    open_circuit = -1.031 * np.exp(-35.0 * s) + 3.685 + 0.2156 * s - 0.1178 * s**2 + 0.3201 * s**3
    R = 0.1562 * np.exp(-24.37 * s) + 0.07446
    return [open_circuit - U_s - U_l - R * (u[0] + c)]


def _cylinder(x: Array, u: Array, c: float) -> Sequence[float]:
    z, v, p_A, p_B = x
    A_A, A_B, E, C_v, C_L, p_S, p_T = 1.26e-3, 7.7e-4, 1.0e9, 2.0e-9, 2.0e-13, 8.0e6, 5.0e5
    edge_A, edge_B = (p_S - p_A, p_B - p_T) if u[0] >= 0.0 else (p_A - p_T, p_S - p_B)
    q_A = C_v * u[0] * np.sign(edge_A) * np.sqrt(abs(edge_A))
    q_B = C_v * u[0] * np.sign(edge_B) * np.sqrt(abs(edge_B))
    leakage = C_L * (p_A - p_B)
    friction = c * np.tanh(v / 1e-5)
    return [
        v,
        (A_A * p_A - A_B * p_B - 600.0 * v - friction) / 60.0,
        E / (1.9e-4 + A_A * z) * (q_A - A_A * v - leakage),
        E / (5.0e-4 - A_B * z) * (-q_B + A_B * v + leakage),
    ]


def _joint(x: Array, u: Array, c: float) -> Sequence[float]:
    theta_m, omega_m, theta_1, omega_1 = x
    spring = 0.18 * (theta_m - theta_1)
    return [
        omega_m,
        (0.08 * u[0] - 4.6e-3 * omega_m - spring) / 3.7e-3,
        omega_1,
        (spring - 0.031 * np.sin(theta_1) - c * omega_1) / 9.3e-3,
    ]


def _wind_turbine(x: Array, u: Array, c: float) -> Sequence[float]:
    omega_r, omega_g, twist = x[:3]
    wind, torque = u[:2]
    beta = x[3] if c else u[2]
    tip = omega_r * 57.5 / wind
    inverse = 1.0 / (tip + 0.08 * beta) - 0.035 / (beta**3 + 1.0)
    C_p = 0.5176 * (116.0 * inverse - 0.4 * beta - 5.0) * np.exp(-21.0 * inverse) + 0.0068 * tip
    aerodynamic = 0.5 * 1.225 * np.pi * 57.5**2 * wind**3 * C_p / omega_r
    slip = omega_r - omega_g / 95.0
    shaft = 2.7e9 * twist + 9.45e5 * slip
    return [
        (aerodynamic - shaft - 7.11 * omega_r) / 5.5e7,
        (shaft / 95.0 - 45.6 * omega_g - torque) / 390.0,
        slip,
        (u[2] - beta) / c if c else 0.0,
    ]


def _heat_pump(x: Array, u: Array, c: float) -> Sequence[float]:
    T_r, T_f, T_w, T_2 = x
    UA_ra, UA_fr, UA_wf = 7.7778, 173.33, 7.7778
    return [
        (UA_fr * (T_f - T_r) - UA_ra * (T_r - u[1]) + 0.9 * u[2] - c * (T_r - T_2)) / 8.10e5,
        (UA_wf * (T_w - T_f) - UA_fr * (T_f - T_r) + 0.1 * u[2]) / 3.315e6,
        (3.0 * u[0] - UA_wf * (T_w - T_f)) / 8.36e5,
        c * (T_r - T_2) / 4e6,
    ]


def _coil(x: Array, u: Array, c: float) -> Sequence[float]:
    T_co, T_z, T_w = x
    stream = 0.192 * 1.25 * 1005.0
    flow = u[0] * (u[0] / 1e-4) ** c
    T_m = 0.25 * u[1] + 0.75 * T_z
    heat = flow * 998.0 * 4180.0 * 10.0
    return [
        (heat + 40.0 * (u[1] - T_co) + stream * (T_m - T_co)) / 4500.0,
        (stream * (T_co - T_z) + 36.0 * (T_w - T_z)) / 47100.0,
        (36.0 * (T_z - T_w) + 36.0 * (u[1] - T_w)) / 70000.0,
    ]


def _pump_station(x: Array, u: Array, c: float) -> Sequence[float]:
    Q, h = x
    flows = [0.0, 0.0315451, 0.0630902, 0.0946353, 0.1261804, 0.1577255, 0.1892706]
    heads = [101.6, 98.778, 90.311, 76.2, 56.444, 31.044, 0.0]
    head = u[0] ** 2 * np.interp(Q / u[0], flows, heads)
    overflow = c * max(h - 2.5, 0.0) ** 1.5
    return [(head - 30.0 - h - 900.0 * Q * abs(Q)) / 3200.0, (Q - u[1] - overflow) / 60.0]


def _fuel_cell(x: Array, u: Array, c: float) -> Sequence[float]:
    p_H, p_O, p_W = x[:3]
    used = 0.996e-6 * u[0]
    return [
        (u[1] - 4.22e-5 * p_H - 2.0 * used) / (4.22e-5 * 3.37),
        (u[2] - 2.11e-5 * p_O - used) / (2.11e-5 * 6.74),
        (2.0 * used - 7.716e-6 * p_W) / (7.716e-6 * 18.418),
        1.0,
    ]


def _fuel_cell_voltage(x: Array, u: Array, c: float) -> Sequence[float]:
    p_H, p_O, p_W, t = x
    nernst = 0.6 + 0.0148 * np.log(p_H * np.sqrt(p_O) / p_W)
    return [88.0 * nernst - 0.4777 * np.log(0.0136 * u[0]) - 0.2778 * u[0] + c * t]


def _turbo_engine(x: Array, u: Array, c: float) -> Sequence[float]:
    p_1, p_2, P_c = x
    egr, opening, fuel = u[0], u[1] + c, u[2]
    W_c = 0.0025 * P_c / (p_1**0.285 - 1.0)
    W_t = opening * p_2
    P_t = 391.365 * (1.0 - (1.0 / p_2) ** 0.285) * W_t
    return [
        143.91 * (W_c + egr - 0.028 * p_1),
        1715.5 * (0.028 * p_1 + fuel - egr - W_t),
        (P_t - P_c) / 0.15,
    ]


PLANTS = {
    "quadruple-tank": Plant(
        _quadruple_tank,
        lambda x, u, c: [0.5 * x[0], 0.5 * x[1]],
        {"h_1": 12.4, "h_2": 12.7, "h_3": 1.8, "h_4": 1.4},
        {"v_1": (1.5, 4.5), "v_2": (1.5, 4.5)},
        (10.0, 10.0, 1.0, 1.0),
        sample_time=2.0,
        samples=1000,
        hold=40,
        hidden="leak@tank_1",
        size=0.4,
    ),
    "battery-cell": Plant(
        _battery,
        _battery_voltage,
        {"s": 0.9, "U_s": 0.0, "U_l": 0.0},
        {"i": (-0.5, 0.8)},
        (1.0, 0.05, 0.05),
        sample_time=2.0,
        samples=1500,
        hold=30,
        hidden="input-offset@i",
        size=0.05,
        noise=0.01,
    ),
    "hydraulic-cylinder": Plant(
        _cylinder,
        lambda x, u, c: [x[0], x[2], x[3]],
        {"x": 0.1, "v": 0.0, "p_A": 2.6e6, "p_B": 4.25e6},
        {"y": (-15.0, 15.0)},
        (0.1, 0.1, 1e6, 1e6),
        sample_time=1e-3,
        samples=2000,
        hold=60,
        hidden="coulomb-friction@piston",
        size=300.0,
    ),
    "robot-joint": Plant(
        _joint,
        lambda x, u, c: [x[0], x[1], x[2]],
        {"theta_m": 0.0, "omega_m": 0.0, "theta_1": 0.0, "omega_1": 0.0},
        {"u": (-0.8, 0.8)},
        (1.0, 5.0, 1.0, 5.0),
        sample_time=0.02,
        samples=1500,
        hold=30,
        hidden="viscous-friction@link",
        size=2e-3,
    ),
    "wind-turbine": Plant(
        _wind_turbine,
        lambda x, u, c: [x[0], x[1]],
        {"omega_r": 1.2, "omega_g": 114.0, "twist": 5e-4},
        {"wind": (9.0, 11.0), "tau_g": (8e3, 1.6e4), "beta": (0.0, 4.0)},
        (1.0, 100.0, 1e-3),
        sample_time=0.1,
        samples=2000,
        hold=100,
        hidden="input-lag@beta",
        size=2.0,
        hidden_states={"pitch": 2.0},
    ),
    "heat-pump": Plant(
        _heat_pump,
        lambda x, u, c: [x[0], x[2]],
        {"T_r": 20.0, "T_f": 21.0, "T_w": 30.0},
        {"W_c": (0.0, 150.0), "T_a": (-5.0, 10.0), "sun": (0.0, 400.0)},
        (10.0, 10.0, 10.0),
        sample_time=900.0,
        samples=1200,
        hold=12,
        hidden="second-heat-store@rooms",
        size=60.0,
        hidden_states={"T_2": 20.0},
    ),
    "hvac-coil": Plant(
        _coil,
        lambda x, u, c: [x[0], x[1]],
        {"T_co": 20.0, "T_z": 18.0, "T_w": 12.0},
        {"f_w": (2e-5, 2e-4), "T_o": (0.0, 10.0)},
        (10.0, 10.0, 10.0),
        sample_time=5.0,
        samples=1500,
        hold=40,
        hidden="input-power@f_w",
        size=0.4,
    ),
    "pump-station": Plant(
        _pump_station,
        lambda x, u, c: [x[0], x[1]],
        {"Q": 0.09, "h": 2.0},
        {"n": (0.85, 1.1), "demand": (0.05, 0.15)},
        (0.1, 1.0),
        sample_time=10.0,
        samples=1500,
        hold=30,
        hidden="overflow@tank",
        size=0.08,
    ),
    "fuel-cell": Plant(
        _fuel_cell,
        _fuel_cell_voltage,
        {"p_H": 1.2, "p_O": 1.2, "p_W": 2.0},
        {"I": (10.0, 40.0), "q_H": (1.3e-4, 2.2e-4), "q_O": (6.5e-5, 1.1e-4)},
        (1.0, 1.0, 1.0),
        sample_time=0.5,
        samples=1500,
        hold=40,
        hidden="output-drift@voltage",
        size=2e-3,
        hidden_states={"t": 0.0},
    ),
    "turbo-engine": Plant(
        _turbo_engine,
        lambda x, u, c: [x[0], x[1]],
        {"p_1": 2.0, "p_2": 2.5, "P_c": 5.0},
        {"W_egr": (0.0, 0.006), "W_t": (0.017, 0.023), "W_f": (1e-3, 3e-3)},
        (1.0, 1.0, 1.0),
        sample_time=0.02,
        samples=1500,
        hold=25,
        hidden="input-offset@W_t",
        size=0.0015,
    ),
}
