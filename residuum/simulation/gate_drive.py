"""The drive of a gate alone, for studies of hidden effects: voltage in, speed and current out."""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.signal import lfilter

from residuum.kept_loops import njit
from residuum.nearest_names import known_names
from residuum.simulation.gate_drive_effects import EFFECTS
from residuum.simulation.machine import BadSetting, Effect, Machine
from residuum.simulation.signals import Array

PROFILES = ("duty-cycle", "rich")
RATED = 24.0  # V
_STEP = 1e-4  # s, largest integration step
_MEMORY = 60.0  # s of the profile that are kept; longer than any hold, ramp or delay
_PROFILE_POINTS = 4096
_THETA, _OMEGA, _THETA_2, _OMEGA_2, _CURRENT, _HEAT, _DAHL, _LAG = range(8)


class Drive(NamedTuple):
    """The drive's constants, nominal, and the parameters of every hidden effect, all absent."""

    K: float = 0.0696  # V·s/rad = N·m/A
    R: float = 0.7473  # Ω
    J_M: float = 3.5e-5  # kg·m², rotor
    J_L: float = 608.0 * (0.028 / 44) ** 2  # kg·m², gate seen from the rotor: 2.462e-4
    b: float = 0.0
    tau_c: float = 0.0
    tau_s: float = 0.0
    omega_s: float = 20.0
    asymmetry: float = 0.0
    mu: float = 0.0
    drag: float = 0.0
    load: float = 0.0
    tau_p: float = 0.0
    period: float = 1200.0
    phase_p: float = 0.0
    tau_r: float = 0.0
    order: float = 1.0
    phase_r: float = 0.0
    k: float = 0.0
    k3: float = 0.0
    two_bodies: bool = False
    k_t: float = 5.0  # N·m/rad of the transmission, when it is elastic or has a gap
    d_t: float = 3e-3
    gap: float = 0.0
    k_e: float = 0.0
    theta_e: float = 0.0
    d_e: float = 0.0
    tau_h: float = 0.0
    theta_h: float = 1.0
    L: float = 0.0
    v_b: float = 0.0
    r_s: float = 0.0
    h: float = 0.0
    alpha: float = 0.0
    T_w: float = 1.0
    T_lag: float = 0.0
    resonance: float = 0.0
    omega_r: float = 1.0
    zeta: float = 1.0
    tau_x: float = 0.0
    length: float = 1.0


# Effect parameter → field of `Drive`, where the names differ.
_FIELDS: dict[str, dict[str, str]] = {
    "quadratic-drag": {"c": "drag"},
    "constant-load": {"tau_l": "load"},
    "position-load": {"phase": "phase_p"},
    "tooth-ripple": {"phase": "phase_r"},
    "elastic-transmission": {"d": "d_t"},
    "backlash": {"k": "k_t", "d": "d_t"},
    "end-stop": {"k": "k_e", "d": "d_e"},
    "output-lag": {"T": "T_lag"},
    "x-speed-resonance": {"tau_r": "resonance"},
}


class GateDrive(Machine):
    r"""A rigid motor drive; everything else is a hidden effect.

    .. math:: R i = u - K \omega, \qquad J \dot\omega = K i, \qquad \dot\theta = \omega

    with K = 0.0696 V·s/rad, R = 0.7473 Ω, J = 3.5e-5 + 608 (0.028/44)² = 2.812e-4 kg·m² at the
    rotor. Each hidden effect of `EFFECTS` adds its term. Coulomb-like friction is the hard sign:
    the body sticks at zero speed while the other torques stay within the breakaway torque. Smooth
    stretches are integrated by classical Runge–Kutta with steps of at most 0.1 ms; a step in which
    ω changes its sign is cut at the crossing (secant, to 1e-9 s). With an elastic transmission or a
    gap, friction acts on the rotor, loads, springs and stops on the gate's side.

    The recorded voltage is the command, held between samples; the recorded outputs are taken at the
    sample's start.

    Parameters
    ----------
    profile : {"duty-cycle", "rich"}
        Open 6 s, pause 2 s, close 6 s, pause 1 s with 1 s ramps to 24 V; or random levels, ramps,
        holds and reversals.
    rate : float
        Samples a second [Hz], 50 … 10 000.
    deviation : float
        K, R and J differ from nominal by a uniform factor within ± this (drawn from seed and
        exemplar).
    noise : float
        Multiplies the sensor noise: 0.3 rad/s on speed, 0.05 A on current (standard deviations).
    noise_color : float
        ρ of the noise's AR(1), e_k = ρ e_{k−1} + …, at the same standard deviation; 0 is white.
    quantisation : float
        Multiplies the sensors' steps of 0.1 rad/s and 0.01 A.
    pwm : bool
        Whether the motor also sees the 100 Hz ripple (2 V) of its bridge, which the recorded
        command does not show.
    initial : {"random", "rest"}
        Unknown start: speed of N(0, 5) rad/s and any angle, or zero.
    """

    name = "gate-drive"
    record_duration = 30.0
    units: ClassVar[Mapping[str, str]] = {"voltage": "V", "speed": "rad/s", "current": "A"}
    effects: ClassVar[Mapping[str, Effect]] = EFFECTS

    def __init__(
        self,
        seed: int = 0,
        effects: Mapping[str, Mapping[str, float] | str] | None = None,
        faults: Mapping[str, float | None] | None = None,
        exemplar: int = 0,
        *,
        profile: str = "duty-cycle",
        rate: float = 500.0,
        deviation: float = 0.1,
        noise: float = 1.0,
        noise_color: float = 0.0,
        quantisation: float = 1.0,
        pwm: bool = False,
        initial: str = "random",
    ) -> None:
        if profile not in PROFILES:
            raise BadSetting(
                f"gate-drive: profile {profile!r} is not known; {known_names(profile, PROFILES)}"
            )
        if initial not in ("random", "rest"):
            raise BadSetting(f"gate-drive: initial {initial!r} must be random or rest")
        for name, value, low, high in (
            ("rate", rate, 50.0, 1e4),
            ("deviation", deviation, 0.0, 0.5),
            ("noise", noise, 0.0, 100.0),
            ("noise_color", noise_color, 0.0, 0.9999),
            ("quantisation", quantisation, 0.0, 100.0),
        ):
            if not low <= value <= high:
                raise BadSetting(
                    f"gate-drive: {name} is {value!r}; must be between {low:g} and {high:g}"
                )
        super().__init__(seed, effects, faults, exemplar)
        self.sample_time = 1.0 / rate
        self._profile, self._pwm = profile, pwm
        self._noise, self._color, self._steps = noise, noise_color, quantisation
        own = np.random.default_rng([seed, exemplar, 5])
        self.drive = self._composed(Drive(), 1.0 + own.uniform(-deviation, deviation, 3))
        self._table = _random_profile(own)
        self._y = np.zeros(8)
        if initial == "random":
            self._y[_THETA], self._y[_OMEGA] = own.uniform(0, 100), 5.0 * own.standard_normal()
            self._y[_THETA_2], self._y[_OMEGA_2], self._y[_LAG] = (
                self._y[_THETA],
                self._y[_OMEGA],
                self._y[_OMEGA],
            )
        self._profile_rng = np.random.default_rng([seed, exemplar, 6])
        self._knots = [(0.0, 0.0), (0.3, 0.0)]
        self._colored = self._rng.standard_normal(2)
        self._walk = 0.0

    def _composed(self, nominal: Drive, factors: Array) -> Drive:
        values: dict[str, Any] = {
            "K": nominal.K * factors[0],
            "R": nominal.R * factors[1],
            "J_M": nominal.J_M * factors[2],
            "J_L": nominal.J_L * factors[2],
        }
        for id, parameters in self.active_effects.items():
            for name, value in parameters.items():
                field = _FIELDS.get(id, {}).get(name, name)
                if field in Drive._fields:
                    values[field] = value
        if "elastic-transmission" in self.active_effects:
            values["k_t"] = 1.0 / self.active_effects["elastic-transmission"]["compliance"]
        values["two_bodies"] = bool({"elastic-transmission", "backlash"} & set(self.active_effects))
        return nominal._replace(**values)

    def _run(self, n: int) -> dict[str, Array]:
        k = self._samples + np.arange(n)
        u = self._command(k * self.sample_time)
        draws = self._rng.standard_normal((n, 3))
        walk = np.zeros(n)
        if rate := self.active_effects.get("x-random-walk-load", {}).get("rate"):
            walk = self._walk + rate * np.sqrt(self.sample_time) * np.cumsum(draws[:, 2])
            self._walk = walk[-1]
        steps = int(np.ceil(self.sample_time / _STEP - 1e-9))
        fine = (k[:, None] + np.arange(steps) / steps) * self.sample_time
        applied = self._seen(fine)
        self._knots = [knot for knot in self._knots if knot[0] > fine[0, 0] - _MEMORY]
        out = np.empty((2, n))
        _live(out, self._y, self.drive, applied, walk, self._table, self.sample_time / steps)
        return {"voltage": u, **self._sensed(out, draws[:, :2])}

    def _command(self, t: Array) -> Array:
        """The voltage command at times t [s]."""
        if self._profile == "duty-cycle":
            knots = np.array([0.0, 1.0, 5.0, 6.0, 8.0, 9.0, 13.0, 14.0, 15.0])
            return np.interp(t % 15.0, knots, RATED * np.array([0, 1, 1, 0, 0, -1, -1, 0, 0]))
        draw = self._profile_rng
        while self._knots[-1][0] < t.max():
            start = self._knots[-1][0]
            level = 0.0 if draw.random() < 0.2 else draw.uniform(-RATED, RATED)
            ramp = 1e-6 if draw.random() < 0.4 else draw.uniform(0.05, 0.6)
            self._knots += [(start + ramp, level), (start + ramp + draw.uniform(0.2, 1.5), level)]
        times, levels = np.array(self._knots).T
        return np.asarray(np.interp(t, times, levels))

    def _seen(self, fine: Array) -> Array:
        """What the motor sees on the integration grid, shape (n, steps): the held command after the
        input's effects.
        """
        late = fine - self.active_effects.get("input-delay", {}).get("delay", 0.0)
        held = np.floor(late / self.sample_time + 1e-6) * self.sample_time
        u = np.where(
            held < 0, 0.0, self._command(np.maximum(held, 0.0).ravel()).reshape(held.shape)
        )
        if width := self.active_effects.get("input-dead-zone", {}).get("width"):
            u = np.sign(u) * np.maximum(np.abs(u) - width, 0.0)
        if limit := self.active_effects.get("input-saturation", {}).get("limit"):
            u = np.clip(u, -limit, limit)
        u = u + self.active_effects.get("input-offset", {}).get("offset", 0.0)
        if self._pwm:
            duty = np.clip(np.abs(u) / (1.05 * RATED), 0.0, 1.0)
            u = u + 2.0 * 4.0 * duty * (1.0 - duty) * (
                4.0 * np.abs((fine * 100.0) % 1.0 - 0.5) - 1.0
            )
        return u

    def _sensed(self, out: Array, draws: Array) -> dict[str, Array]:
        rho = self._color
        fresh = np.sqrt(1.0 - rho**2)
        colored, _ = lfilter([fresh], [1.0, -rho], draws, axis=0, zi=rho * self._colored[None, :])
        self._colored = colored[-1]
        speed, current = out
        if "output-absolute" in self.active_effects:
            speed = np.abs(speed)
        speed = speed + self.active_effects.get("output-offset", {}).get("offset", 0.0)
        speed = speed + 0.3 * self._noise * colored[:, 0]
        current = current + 0.05 * self._noise * colored[:, 1]
        step = self.active_effects.get("output-quantisation", {}).get("step", 0.1 * self._steps)
        return {"speed": _rounded(speed, step), "current": _rounded(current, 0.01 * self._steps)}

    def _constants(self) -> dict[str, float]:
        drive = self.drive
        return {"K": float(drive.K), "R": float(drive.R), "J": float(drive.J_M + drive.J_L)}


def _rounded(values: Array, step: float) -> Array:
    return step * np.round(values / step) if step > 0 else values


def _random_profile(own: np.random.Generator) -> Array:
    """A periodic random function of unit RMS whose correlation length is 4 of its points."""
    spectrum = np.fft.rfft(own.standard_normal(_PROFILE_POINTS))
    order = np.arange(len(spectrum))
    smooth = np.fft.irfft(
        spectrum * np.exp(-0.5 * (order * 4 * 2 * np.pi / _PROFILE_POINTS) ** 2), _PROFILE_POINTS
    )
    return np.asarray(smooth / np.std(smooth))


@njit()
def _current(y, d, u):  # type: ignore[no-untyped-def]
    """Armature current without inductance; brushes block it below their drop."""
    e = u - d.K * y[_OMEGA]
    free = max(abs(e) - d.v_b, 0.0) * np.sign(e)
    R = d.R * (1.0 + d.alpha * y[_HEAT])
    return free / (R + d.r_s) if free * u > 0.0 else free / R


@njit()
def _load(theta, omega, d, walk, table):  # type: ignore[no-untyped-def]
    """Torque of loads, springs and stops against positive motion."""
    tau = d.load + walk + d.k * theta + d.k3 * theta**3
    tau += d.tau_p * np.sin(2 * np.pi * theta / d.period + d.phase_p) + d.tau_r * np.sin(
        d.order * theta + d.phase_r
    )
    if d.k_e > 0.0 and theta > d.theta_e:
        tau += max(d.k_e * (theta - d.theta_e) + d.d_e * omega, 0.0)
    if d.tau_x > 0.0:
        place = theta / d.length * 4.0
        left = np.floor(place)
        blend = place - left
        first = int(left) % len(table)
        tau += d.tau_x * ((1.0 - blend) * table[first] + blend * table[(first + 1) % len(table)])
    return tau


@njit()
def _transmitted(y, d):  # type: ignore[no-untyped-def]
    """Torque from rotor to gate through the elastic transmission and its gap."""
    twist, rate = y[_THETA] - y[_THETA_2], y[_OMEGA] - y[_OMEGA_2]
    half = 0.5 * d.gap
    if half == 0.0:
        return d.k_t * twist + d.d_t * rate
    if twist > half:
        return max(d.k_t * (twist - half) + d.d_t * rate, 0.0)
    if twist < -half:
        return min(d.k_t * (twist + half) + d.d_t * rate, 0.0)
    return 0.0


@njit()
def _driving(y, d, u, walk, table):  # type: ignore[no-untyped-def]
    """(torque on the rotor without dry friction, current)."""
    i = y[_CURRENT] if d.L > 0.0 else _current(y, d, u)
    omega = y[_OMEGA]
    tau = d.K * i - d.b * omega - d.drag * omega * abs(omega) - d.tau_h * y[_DAHL]
    if d.resonance > 0.0 and omega != 0.0:
        away = (omega * omega - d.omega_r * d.omega_r) / (2.0 * d.zeta * d.omega_r * omega)
        tau -= d.resonance * np.sign(omega) / (1.0 + away * away)
    tau -= _transmitted(y, d) if d.two_bodies else _load(y[_THETA], omega, d, walk, table)
    return tau, i


@njit()
def _friction(omega, direction, i, d):  # type: ignore[no-untyped-def]
    """Dry friction ≥ 0 against motion in `direction`."""
    level = d.tau_c + 0.5 * d.asymmetry * direction + d.mu * abs(d.K * i)
    if d.tau_s > 0.0:
        level += d.tau_s * np.exp(-((omega / d.omega_s) ** 2))
    return max(level, 0.0)


@njit()
def _slope(dy, y, d, u, walk, table, direction):  # type: ignore[no-untyped-def]
    """dy/dt with the direction of sliding given; direction 0 is a rotor that sticks."""
    tau, i = _driving(y, d, u, walk, table)
    omega = y[_OMEGA]
    dy[_THETA] = omega
    inertia = d.J_M if d.two_bodies else d.J_M + d.J_L
    dy[_OMEGA] = (
        0.0 if direction == 0.0 else (tau - direction * _friction(omega, direction, i, d)) / inertia
    )
    dy[_THETA_2], dy[_OMEGA_2] = 0.0, 0.0
    if d.two_bodies:
        dy[_THETA_2] = y[_OMEGA_2]
        dy[_OMEGA_2] = (
            _transmitted(y, d) - _load(y[_THETA_2], y[_OMEGA_2], d, walk, table)
        ) / d.J_L
    R = d.R * (1.0 + d.alpha * y[_HEAT]) + (d.r_s if u * i > 0.0 else 0.0)
    dy[_CURRENT] = 0.0
    if d.L > 0.0:
        dy[_CURRENT] = (u - d.K * omega - R * i - d.v_b * np.tanh(i / 0.05)) / d.L
    dy[_HEAT] = d.h * d.R * i * i - y[_HEAT] / d.T_w
    dy[_DAHL] = (omega - abs(omega) * y[_DAHL]) / d.theta_h
    dy[_LAG] = (omega - y[_LAG]) / d.T_lag if d.T_lag > 0.0 else 0.0


@njit()
def _runge_kutta(y, d, u, walk, table, direction, h, work):  # type: ignore[no-untyped-def]
    """work[4] := y after one classical step of length h."""
    _slope(work[0], y, d, u, walk, table, direction)
    work[4] = y + 0.5 * h * work[0]
    _slope(work[1], work[4], d, u, walk, table, direction)
    work[4] = y + 0.5 * h * work[1]
    _slope(work[2], work[4], d, u, walk, table, direction)
    work[4] = y + h * work[2]
    _slope(work[3], work[4], d, u, walk, table, direction)
    work[4] = y + h / 6.0 * (work[0] + 2.0 * work[1] + 2.0 * work[2] + work[3])


@njit()
def _direction(y, d, u, walk, table):  # type: ignore[no-untyped-def]
    """Where the rotor slides: the sign of its speed, or at standstill where the torque breaks it
    away; 0 sticks.
    """
    if y[_OMEGA] != 0.0:
        return np.sign(y[_OMEGA])
    tau, i = _driving(y, d, u, walk, table)
    sign = np.sign(tau)
    return sign if abs(tau) > _friction(0.0, sign, i, d) else 0.0


@njit()
def _until_crossing(y, d, u, walk, table, direction, h, work):  # type: ignore[no-untyped-def]
    """work[4] := y at the instant in (0, h] when ω reaches zero; returns that instant (secant with
    bisection's bracket).
    """
    early, late, before, after = 0.0, h, y[_OMEGA], work[4, _OMEGA]
    at = late
    for _ in range(40):
        at = early + (late - early) * before / (before - after)
        at = min(max(at, early + 0.05 * (late - early)), late - 0.05 * (late - early))
        _runge_kutta(y, d, u, walk, table, direction, at, work)
        now = work[4, _OMEGA]
        if now * direction > 0.0:
            early, before = at, now
        else:
            late, after = at, now
        if late - early < 1e-9:
            break
    work[4, _OMEGA] = 0.0
    return at


@njit()
def _step(y, d, u, walk, table, h, work, hard):  # type: ignore[no-untyped-def]
    """Advance y by h, cutting the step where dry friction changes its sign."""
    left = h
    for _ in range(8):
        direction = _direction(y, d, u, walk, table) if hard else 1.0
        _runge_kutta(y, d, u, walk, table, direction, left, work)
        crossed = hard and direction != 0.0 and work[4, _OMEGA] * direction < 0.0
        if crossed and y[_OMEGA] != 0.0:
            left -= _until_crossing(y, d, u, walk, table, direction, left, work)
            y[:] = work[4]
            if left <= 1e-9:
                return
        else:
            y[:] = work[4]
            if crossed:
                y[_OMEGA] = 0.0
            return


@njit()
def _live(out, y, d, applied, walk, table, h):  # type: ignore[no-untyped-def]
    hard = d.tau_c + d.tau_s + abs(d.asymmetry) + d.mu > 0.0
    work = np.empty((5, 8))
    for k in range(out.shape[1]):
        out[0, k] = y[_LAG] if d.T_lag > 0.0 else y[_OMEGA]
        out[1, k] = y[_CURRENT] if d.L > 0.0 else _current(y, d, applied[k, 0])
        for j in range(applied.shape[1]):
            _step(y, d, applied[k, j], walk[k], table, h, work, hard)
