"""The electro-mechanical actuator of a sliding gate: motor, worm, nylon gear, shaft, pinion, rack
and a 608 kg gate.
"""

from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import numpy as np

from residuum.kept_loops import njit
from residuum.simulation.machine import BadSetting, Fault, Machine
from residuum.simulation.signals import Array

PAUSE, OPENING, CLOSING = 0, 1, 2
GEAR_TEETH, PINION_TEETH = 44, 14
COUNTS = 1024  # of the encoder, a revolution
_SUBSTEPS = (
    8  # 25 µs: a fortieth of the electrical time constant, a thousandth of the coupling's period
)
_NOISES = 5
_PROFILE_POINTS = 2048  # of one shaft revolution
_RAIL_STEP = 0.005  # m
_ENCODER_WINDOW = 10  # samples over which counts are taken: 2 ms
_ALONE = 0.85  # part of a pitch in which one tooth alone carries the load: 2 − contact ratio 1.15


class Actuator(NamedTuple):
    """Constants of one specimen of gate and actuator; angles, torques and stiffness at the motor's
    shaft.
    """

    R: float = 0.7473  # Ω
    K: float = 0.0696  # V·s/rad = N·m/A
    L: float = 0.6e-3  # H
    J_M: float = 3.5e-5  # kg·m², rotor with worm
    m: float = 608.0  # kg
    # m/rad, pinion radius (14 teeth of module 4 mm) over the gear's teeth
    ratio: float = 0.028 / GEAR_TEETH
    supply: float = 30.9  # V at the motor in steady motion: reaches 4100 rpm under load
    stiffness: float = 3.0  # N·m/rad of nylon gear, shaft and rack mounting
    damping: float = 3.0e-3  # N·m·s/rad of the same
    clearance: float = 1.7  # rad, 1.1 mm at the rack
    motor_friction: float = 0.03  # N·m, brushes and bearings
    viscous: float = 2.0e-5  # N·m·s/rad, grease
    worm_loss: float = 0.5  # part of the transmitted torque that sliding in the worm costs on top
    rolling: float = 50.0  # N, wheels on the rail
    travel: float = 2.85  # m
    ramp: float = 1.0  # s
    pause: float = 7.0  # s
    current_offset: float = 0.0  # A
    rack_tooth: float = 1.2  # m, where the rack is damaged


class Tolerance(NamedTuple):
    """Standard deviation of one specimen to the next, relative where no unit is given."""

    R: float = 0.04
    K: float = 0.025
    J_M: float = 0.05
    supply: float = 0.01
    stiffness: float = 0.15
    clearance: float = 0.25
    motor_friction: float = 0.15
    viscous: float = 0.15
    worm_loss: float = 0.1
    rolling: float = 0.1
    current_offset: float = 0.05  # A


STATE = np.dtype(
    [
        *(
            (name, np.float64)
            for name in ("theta", "omega", "current", "x", "v", "command", "timer", "error")
        ),
        *(
            (name, np.float64)
            for name in ("wind", "mains", "friction", "overload", "clock", "start", "event_time")
        ),
        ("phase", np.int64),
        ("last_phase", np.int64),
        ("braking", np.bool_),
        ("event", np.int64),
        ("event_size", np.float64),
        ("counts", np.float64, (_ENCODER_WINDOW,)),
        ("count_index", np.int64),
    ]
)
_EVENTS = ("cut-short", "obstacle", "supply-sag", "manual-push")
_NO_EVENT, _CUT_SHORT, _OBSTACLE, _SAG, _PUSH = -1, 0, 1, 2, 3


class GateActuator(Machine):
    r"""Opens, pauses 7 s, closes, pauses, and so on; seen by the motor's own sensors at 5 kHz.

    Motor side (θ, ω) and gate side (x, v) are two bodies that touch through teeth with clearance g:

    .. math::
        L \dot i &= V - R i - K \omega \\
        J_M \dot\omega &= K i - T - (\tau_m + \mu_w |T|) \operatorname{sgn}\omega - d\,\omega \\
        m \dot v &= T/\bar\tau - (F_r(1 + \text{profile}(x))) \operatorname{sgn} v + F_{wind} \\
        \delta &= \theta - x/\bar\tau - e(\varphi), \quad
        T = k\,(\delta \mp g/2) + c\,\dot\delta \text{ beyond the clearance, else } 0

    with the hard sign, φ = θ/44 the shaft angle and e(φ) the transmission error: gear eccentricity
    (0.05 mm at the gear's 40 mm radius), tooth-to-tooth errors of 44 nylon and 14 steel teeth (0.02
    mm), worm run-out. The rail's profile is fixed for a specimen (4 N RMS, waves of 0.1 to 1.5 m,
    as 0.7 mm/m unevenness gives). Wind is a random force of 6 N with 1 s memory: gusts of 1.3 m/s
    on a breeze of 4 m/s press 4 m² of gate sideways by 32 N, a fifth of which the guides turn into
    drag. The mains wander by 0.5 % with 3 s memory, friction differs by 3 % from one movement to
    the next. The bridge's pulse width modulation leaves a triangular ripple of 100 Hz. The encoder
    has 1024 counts a revolution, counted over 2 ms; current and voltage are quantised to 15 mA and
    10 mV.

    How each fault acts. Sliding gates are mounted with 1.5 mm between pinion and rack, so that the
    gate does not rest on the pinion; that leaves 1.1 mm of clearance and a contact ratio of about
    1.15: 85 % of a pitch is carried by one tooth alone. Where that tooth is gone, the motor loses
    its load for 39 ms, runs ahead by what the load had cost it (some 7 rad/s of 429), and is caught
    by the next tooth: a pulse in speed, a dip, then a peak in current. The pinion tooth comes once
    a shaft revolution (1.55 Hz), the rack tooth once a movement at one place. A notch in the gear's
    nylon lets two teeth spread (0.25 mm at full depth) and halves the stiffness around it: the
    transmission error has a bump once a revolution. Missing teeth count as 1, the source's saw cut
    through 80 % of the radius as 0.8. These numbers come from geometry and mounting rules, but the
    tolerances of the drawings were taken for standard deviations, so that these gears are coarser
    than a maker's. ISO 1328-1 gives for grade 9, usual for moulded nylon and cut steel, a run-out
    of 60 µm, hence an eccentricity of 30 µm at most (here 50 µm on average), and single pitch
    deviations of 22 and 24 µm, the largest of a gear and a difference of two teeth, hence 6 and 8
    µm a tooth (here 20 µm): gears of grade 9 have `tooth_errors` of .25 to .4, about 0.3. The
    errors lie at the very frequencies of F₁ and F₂: with 1.0 a linear SVM on these two finds the
    rack's one pulse in none of 40 movements, with 0.3 in 27, and on the bench in 31 of 37 (`python
    -m reproduction gate_actuator`, Table 7 row by row). A gate that sways after the tooth (1 to 4
    Hz, up to 5 mm/s) or a smooth rail change nothing. The default stays coarse: it is the harder
    case, and limits, recordings and campaigns were made with it.

    Parameters
    ----------
    temperature : float
        Of motor and gear [°C]: copper +0.39 %/K, magnets −0.1 %/K, grease friction −0.8 %/K from 20
        °C.
    wear : float
        0 (new) to 1: clearance three times, friction 1.3 times, tooth errors twice.
    tooth_errors : float
        0 to 4: eccentricity and tooth errors of gear and pinion over those above; 0.3 is ISO 1328-1
        grade 9.
    """

    name = "gate-actuator"
    sample_time = 1.0 / 5000.0
    units: ClassVar[Mapping[str, str]] = {
        "speed": "rad/s",
        "current": "A",
        "voltage": "V",
        "phase": "",
    }
    faults: ClassVar[Mapping[str, Fault]] = {
        "gear-notch": Fault(
            0.8, "", "notch in the nylon gear, as a fraction of its radius", largest=1.0
        ),
        "pinion-tooth": Fault(1.0, "", "part of one pinion tooth that is missing", largest=1.0),
        "rack-tooth": Fault(1.0, "", "part of one rack tooth that is missing", largest=1.0),
    }
    events: ClassVar[Mapping[str, Fault]] = {
        "cut-short": Fault(
            0.5, "", "the user stops the next movement at this fraction of the way", largest=0.9
        ),
        "obstacle": Fault(
            0.5, "", "the gate hits an obstacle at this fraction of the way", largest=0.9
        ),
        "supply-sag": Fault(
            6.0, "V", "the supply falls by this for 1.5 s in the next movement", largest=20.0
        ),
        "manual-push": Fault(150.0, "N", "somebody pushes the moving gate for 2 s", largest=400.0),
    }

    def __init__(
        self,
        seed: int = 0,
        effects: Mapping[str, Mapping[str, float] | str] | None = None,
        faults: Mapping[str, float | None] | None = None,
        exemplar: int = 0,
        *,
        temperature: float = 20.0,
        wear: float = 0.0,
        tooth_errors: float = 1.0,
    ) -> None:
        if not 0.0 <= tooth_errors <= 4.0:
            raise BadSetting(
                f"gate-actuator: tooth_errors is {tooth_errors!r}; must be between 0 and 4"
            )
        if not -30.0 <= temperature <= 120.0:
            raise BadSetting(
                f"gate-actuator: temperature is {temperature!r} °C; must be between -30 and 120"
            )
        if not 0.0 <= wear <= 1.0:
            raise BadSetting(f"gate-actuator: wear is {wear!r}; must be between 0 and 1")
        super().__init__(seed, effects, faults, exemplar)
        self.actuator = _aged(self._specimen(), temperature, wear)
        parts = np.random.default_rng([exemplar, 11])
        self._teeth = _transmission_error(parts) * (1.0 + wear) * tooth_errors
        self._rail = _rail_profile(parts, self.actuator.travel)
        self._state = np.zeros(1, STATE)
        self._state["timer"] = self.actuator.pause - 1.0
        self._state["last_phase"] = CLOSING
        self._state["friction"] = 1.0
        self._state["event"] = _NO_EVENT
        self._shaft_origin = float(self._rng.uniform(0, 2 * np.pi))
        self.position: Array = np.zeros(0)

    def _specimen(self) -> Actuator:
        nominal, spread = Actuator(), Tolerance()
        draws = dict(zip(Tolerance._fields, self._tolerance(len(spread)), strict=True))
        relative = {
            name: getattr(nominal, name) * (1.0 + getattr(spread, name) * draw)
            for name, draw in draws.items()
            if name != "current_offset"
        }
        return nominal._replace(
            **relative, current_offset=spread.current_offset * draws["current_offset"]
        )

    def _run(self, n: int) -> dict[str, Array]:
        if self._pending and self._state["event"][0] == _NO_EVENT:
            id = next(iter(self._pending))
            self._state["event"], self._state["event_size"] = (
                _EVENTS.index(id),
                self._pending.pop(id),
            )
        damage = tuple(
            self.active_faults.get(id, 0.0) for id in ("gear-notch", "pinion-tooth", "rack-tooth")
        )
        noise = self._rng.standard_normal((n, _NOISES))
        out = np.empty((5, n))
        _live(
            out,
            self._state,
            self.actuator,
            self._teeth,
            self._rail,
            damage,
            noise,
            self._shaft_origin,
        )
        self.position = out[4]
        return dict(zip(self.units, out[:4], strict=True))

    def _constants(self) -> dict[str, float]:
        return {**self.actuator._asdict(), "gear_teeth": GEAR_TEETH, "pinion_teeth": PINION_TEETH}


def _aged(a: Actuator, temperature: float, wear: float) -> Actuator:
    warmer = temperature - 20.0
    grease = np.exp(-0.008 * warmer) * (1.0 + 0.3 * wear)
    return a._replace(
        R=a.R * (1.0 + 0.0039 * warmer),
        K=a.K * (1.0 - 0.001 * warmer),
        clearance=a.clearance * (1.0 + 2.0 * wear),
        motor_friction=a.motor_friction * grease,
        viscous=a.viscous * grease,
        worm_loss=a.worm_loss * (1.0 + 0.3 * wear),
    )


def _transmission_error(parts: np.random.Generator) -> Array:
    """e(φ) over one shaft revolution [rad at the motor], shape (_PROFILE_POINTS,), from the
    drawings' tolerances.
    """
    phi = np.linspace(0.0, 2 * np.pi, _PROFILE_POINTS, endpoint=False)
    at_gear, at_rack = GEAR_TEETH / 0.040, GEAR_TEETH / 0.028  # rad at the motor a metre of error
    eccentric = 0.05e-3 * at_gear * parts.rayleigh(0.8) * np.sin(phi + parts.uniform(0, 2 * np.pi))
    nylon = 0.02e-3 * at_gear * _tooth_errors(phi, GEAR_TEETH, parts)
    steel = 0.02e-3 * at_rack * _tooth_errors(phi, PINION_TEETH, parts)
    run_out = 0.003 * np.sin(GEAR_TEETH * phi + parts.uniform(0, 2 * np.pi))
    return eccentric + nylon + steel + run_out


def _tooth_errors(phi: Array, teeth: int, parts: np.random.Generator) -> Array:
    """Random pitch errors of unit size, smooth from tooth to tooth, periodic in φ."""
    errors = parts.standard_normal(teeth)
    place = phi / (2 * np.pi) * teeth
    left = np.floor(place).astype(int)
    blend = 0.5 - 0.5 * np.cos(np.pi * (place - left))
    return (1 - blend) * errors[left % teeth] + blend * errors[(left + 1) % teeth]


def _rail_profile(parts: np.random.Generator, travel: float) -> Array:
    """Extra rolling force [N] every 5 mm from 0.5 m before the closed position: waves of 0.1 to 1.5
    m, 4 N RMS.
    """
    x = np.arange(-0.5, travel + 0.5, _RAIL_STEP)
    wavelength = np.geomspace(0.1, 1.5, 24)
    phase = parts.uniform(0, 2 * np.pi, (24, 1))
    waves = np.sqrt(wavelength)[:, None] * np.sin(2 * np.pi * x / wavelength[:, None] + phase)
    force = waves.sum(axis=0)
    return np.asarray(4.0 * force / np.std(force))


@njit()
def _between(table: Array, place: float) -> float:  # type: ignore[no-untyped-def, unused-ignore]
    left = int(np.floor(place))
    left = min(max(left, 0), len(table) - 2)
    blend = min(max(place - left, 0.0), 1.0)
    return (1.0 - blend) * table[left] + blend * table[left + 1]


@njit()
def _window(distance: float, half_width: float, edge: float) -> float:
    """1 inside ± half_width, 0 outside, straight edges."""
    return min(max((half_width + edge - abs(distance)) / edge, 0.0), 1.0)


@njit()
def _around(angle: float) -> float:
    """The angle between −π and π."""
    return angle - 2 * np.pi * np.floor((angle + np.pi) / (2 * np.pi))


@njit()
def _coulomb(speed: float, change: float) -> float:
    """Speed after dry friction took `change` ≥ 0 from it; friction stops a body but never drives
    it.
    """
    if speed > change:
        return speed - change
    return speed + change if speed < -change else 0.0


@njit()
def _mesh_torque(s, a, teeth, damage, shaft, dt):  # type: ignore[no-untyped-def]
    """Torque T through the teeth, with transmission error, clearance and what damaged teeth do to
    both.
    """
    notch, pinion, rack = damage
    place = shaft / (2 * np.pi) * _PROFILE_POINTS % _PROFILE_POINTS
    left = int(place)
    error = teeth[left % _PROFILE_POINTS] * (1 - place + left) + teeth[
        (left + 1) % _PROFILE_POINTS
    ] * (place - left)
    k = a.stiffness
    if notch > 0.0:
        near = _around(shaft - 1.0) / (2 * np.pi / GEAR_TEETH)
        bump = np.exp(-0.5 * near * near)
        error += notch * 0.25e-3 / 0.040 * GEAR_TEETH * bump
        k *= 1.0 - 0.5 * notch * bump
    gap = 0.5 * a.clearance
    lost = 0.0
    if pinion > 0.0:
        near = _around(shaft - 1.0) / (2 * np.pi / PINION_TEETH)
        lost = pinion * _window(near, 0.5 * _ALONE * pinion, 0.08)
    if rack > 0.0:
        near = (s.x - a.rack_tooth) / (a.ratio * GEAR_TEETH * 2 * np.pi / PINION_TEETH)
        lost = max(lost, rack * _window(near, 0.5 * _ALONE * rack, 0.08))
    gap += 1.5 * lost
    delta = s.theta - s.x / a.ratio - error
    rate = s.omega - s.v / a.ratio - (error - s.error) / dt
    s.error = error
    if delta > gap:
        return max(k * (delta - gap) + a.damping * rate, 0.0)
    if delta < -gap:
        return min(k * (delta + gap) + a.damping * rate, 0.0)
    return 0.0


@njit()
def _start(s, draw):  # type: ignore[no-untyped-def]
    """A movement the other way than the last one, with a friction of its own."""
    s.phase = OPENING if s.last_phase == CLOSING else CLOSING
    s.last_phase = s.phase
    s.timer, s.command, s.overload, s.start, s.event_time = 0.0, 0.0, 0.0, s.x, 0.0
    s.braking = False
    s.friction = 1.0 + 0.03 * draw


@njit()
def _is_to_brake(s, a):  # type: ignore[no-untyped-def]
    """Whether the way that is left is what a ramp from this speed takes, or the movement is cut
    short.
    """
    to_go = a.travel - s.x if s.phase == OPENING else s.x
    whole = a.travel - s.start if s.phase == OPENING else s.start
    # a ramp down covers half of its time at this speed; 15 mm are left to spare
    if to_go < 0.5 * a.ramp * abs(s.v) + 0.015:
        return True
    return s.event == _CUT_SHORT and to_go < (1.0 - s.event_size) * whole


@njit()
def _move_on(s, a, dt, draw):  # type: ignore[no-untyped-def]
    """The controller: pause, start, ramp, brake before the end, stop."""
    s.timer += dt
    if s.phase == PAUSE:
        if s.timer >= a.pause:
            _start(s, draw)
        return
    if _is_to_brake(s, a):
        s.braking = True
    step = a.supply / a.ramp * dt
    s.command = max(s.command - step, 0.0) if s.braking else min(s.command + step, a.supply)
    s.overload = s.overload + dt if abs(s.current) > 10.0 and s.timer > 1.2 * a.ramp else 0.0
    if (s.braking and s.command == 0.0) or s.overload > 0.1:
        s.phase, s.timer, s.command, s.event = PAUSE, 0.0, 0.0, _NO_EVENT


@njit()
def _happening(s, a, dt):  # type: ignore[no-untyped-def]
    """(supply drop [V], extra force on the gate [N]) of the operating event that is on."""
    if s.phase == PAUSE or s.event < _OBSTACLE:
        return 0.0, 0.0
    heading = 1.0 if s.phase == OPENING else -1.0
    whole = a.travel - s.start if s.phase == OPENING else s.start
    travelled = heading * (s.x - s.start)
    if s.event == _OBSTACLE:
        into = travelled - s.event_size * whole
        return 0.0, -heading * max(2.0e4 * into + 2.0e3 * heading * s.v, 0.0) if into > 0.0 else 0.0
    if travelled < 0.4 * whole:
        return 0.0, 0.0
    s.event_time += dt
    if s.event == _SAG:
        return (s.event_size if s.event_time < 1.5 else 0.0), 0.0
    return 0.0, heading * s.event_size if s.event_time < 2.0 else 0.0


@njit()
def _live(out, state, a, teeth, rail, damage, noise, shaft_origin):  # type: ignore[no-untyped-def]
    s = state[0]
    Ts = 1.0 / 5000.0
    dt = Ts / _SUBSTEPS
    for j in range(out.shape[1]):
        _move_on(s, a, Ts, noise[j, 0])
        sag, force = _happening(s, a, Ts)
        s.wind += -Ts / 1.0 * s.wind + 6.0 * np.sqrt(2.0 * Ts / 1.0) * noise[j, 1]
        s.mains += -Ts / 3.0 * s.mains + 0.005 * np.sqrt(2.0 * Ts / 3.0) * noise[j, 2]
        s.clock += Ts
        duty = s.command / (1.05 * a.supply)
        triangle = 4.0 * abs((s.clock * 100.0) % 1.0 - 0.5) - 1.0
        heading = -1.0 if s.phase == CLOSING else 1.0
        bridge = max(s.command * (1.0 + s.mains) - (sag if s.command > 0 else 0.0), 0.0)
        V = heading * bridge + 2.0 * 4.0 * duty * (1.0 - duty) * triangle
        # the bridge limits the current to 20 A
        V = min(max(V, a.K * s.omega - 20.0 * a.R), a.K * s.omega + 20.0 * a.R)
        rolling = a.rolling * s.friction + _between(rail, (s.x + 0.5) / _RAIL_STEP)
        for _ in range(_SUBSTEPS):
            T = _mesh_torque(s, a, teeth, damage, shaft_origin + s.theta / GEAR_TEETH, dt)
            s.current += dt / a.L * (V - a.K * s.omega - a.R * s.current)
            omega = s.omega + dt / a.J_M * (a.K * s.current - T - a.viscous * s.friction * s.omega)
            s.omega = _coulomb(
                omega, dt / a.J_M * (a.motor_friction * s.friction + a.worm_loss * abs(T))
            )
            s.v = _coulomb(
                s.v + dt / a.m * (T / a.ratio + s.wind + force), dt / a.m * max(rolling, 0.0)
            )
            s.theta += dt * s.omega
            s.x += dt * s.v
        _measure(out, j, s, a, V, noise)


@njit()
def _measure(out, j, s, a, V, noise):  # type: ignore[no-untyped-def]
    """Encoder, shunt and voltage divider with their noise and steps."""
    count = np.floor(s.theta * COUNTS / (2 * np.pi))
    oldest = s.counts[s.count_index]
    s.counts[s.count_index] = count
    s.count_index = (s.count_index + 1) % _ENCODER_WINDOW
    out[0, j] = (count - oldest) * 2 * np.pi / COUNTS / (_ENCODER_WINDOW / 5000.0)
    out[1, j] = 0.015 * np.round((s.current + a.current_offset + 0.05 * noise[j, 3]) / 0.015)
    out[2, j] = 0.01 * np.round((V + 0.03 * noise[j, 4]) / 0.01)
    out[3, j] = s.phase
    out[4, j] = s.x
