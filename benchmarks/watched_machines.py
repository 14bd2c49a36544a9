"""Simulated machines to be watched: windows with and without faults, and the inexact model that an engineer would have of each.

Each model lacks one small effect of its machine, its file's values are 5 % off, and resistances and frictions move with a
temperature that is recorded beside the signals. The machines are those of `residuum.simulation` and a fan of this file; none
shares code with the models. Windows are kept as arrays in a temporary folder, so that they are made once.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numba import njit

from residuum.identification.physics import PhysicalModel, load_model, read_model
from residuum.identification.record import Record
from residuum.simulation import MACHINES

OFF = 1.05
TRAINED_ON = 20
_TEMPERATURES = (0.0, 40.0)
_COPPER, _GREASE = 0.0039, -0.006


@dataclass(frozen=True)
class Fault:
    """A fault: its factor on constants of the machine, or what is done to a channel, and the causes that may be named.

    `reading` is added to a channel, `gain` multiplies it, `noise` is the standard deviation of white noise more in it.
    """

    id: str
    causes: tuple[str, ...]
    kind: str = "physics"
    scaled: Mapping[str, float] | None = None
    set: Mapping[str, float] | None = None
    reading: Mapping[str, float] | None = None
    gain: Mapping[str, float] | None = None
    noise: Mapping[str, float] | None = None
    size: tuple[str, float] | None = None


@dataclass(frozen=True)
class Watched:
    """A machine: how it is made from a seed, where its constants are, the seconds of a window, its model and its faults.

    `own` says of values that stand for an effect left out too which constant of the machine they are by themselves, and how many
    times that in the model's terms.
    """

    name: str
    seconds: float
    make: Callable[[int], Any]
    constants: str
    model: Callable[[], PhysicalModel]
    warm: Mapping[str, float]
    faults: tuple[Fault, ...]
    own: Mapping[str, tuple[str, float]] = field(default_factory=dict)


class Fan:
    """A DC blower: J ω̇ = K i − τ_c − b ω − c ω², R i = u − K ω; 100 Hz, levels of 5 to 22 V with ramps; it never stands."""

    units: ClassVar[Mapping[str, str]] = {"voltage": "V", "speed": "rad/s", "current": "A"}

    def __init__(self, seed: int) -> None:
        own = np.random.default_rng([seed, 11])
        K, R, J, tau_c, c = np.array([0.05, 1.1, 6e-4, 0.012, 1.6e-6]) * (
            1.0 + own.uniform(-0.05, 0.05, 5)
        )
        self.fan = _Constants({"K": K, "R": R, "J": J, "tau_c": tau_c, "c": c, "b": 8e-6})
        self._own, self._noise = own, np.random.default_rng([seed, 12])
        self._knots, self._t, self._x = [(0.0, 8.0)], 0.0, np.array([100.0])
        self._colour = np.zeros(2)

    def simulate(self, seconds: float) -> _Run:
        n = round(100 * seconds)
        t = self._t + 0.01 * np.arange(n)
        while self._knots[-1][0] < t[-1]:
            now, level = self._knots[-1][0], self._own.uniform(5.0, 22.0)
            ramp = now + self._own.choice([0.01, 0.5, 1.5])
            self._knots += [(ramp, level), (ramp + self._own.uniform(0.4, 2.5), level)]
        times, levels = np.array(self._knots).T
        u = np.interp(t, times, levels)
        self._t += seconds
        f = self.fan
        speed, current = _blow(u, self._x, f["K"], f["R"], f["J"], f["tau_c"], f["c"], f["b"])
        draws = self._noise.standard_normal((n, 2))
        for k in range(n):  # an AR(1) of pole 0.6
            self._colour = 0.6 * self._colour + 0.8 * draws[k]
            draws[k] = self._colour
        channels = {
            "voltage": u,
            "speed": speed + 0.5 * draws[:, 0],
            "current": current + 0.03 * draws[:, 1],
        }
        return _Run(channels, self.units, 0.01, float(t[0]))


class Pendulum:
    """A weight on an arm at a motor: J φ̈ = K x − w sin φ − b φ̇ − τ_c sgn φ̇ − k φ, the motor's x behind its current by T_m.

    100 Hz, currents of −0.6 to 0.6 A, with which it never goes over the top; it sticks where it stands and the load is below τ_c.
    """

    units: ClassVar[Mapping[str, str]] = {"current": "A", "angle": "rad"}

    def __init__(self, seed: int) -> None:
        self._own, self._noise = (
            np.random.default_rng([seed, 31]),
            np.random.default_rng([seed, 32]),
        )
        w, K, b, tau_c, T_m = np.array([0.8, 0.4, 0.012, 0.012, 0.008]) * (
            1.0 + self._own.uniform(-0.05, 0.05, 5)
        )
        self.pendulum = _Constants(
            {"w": w, "K": K, "b": b, "tau_c": tau_c, "T_m": T_m, "J": 0.02, "k": 0.0}
        )
        self._t, self._x = 0.0, np.zeros(3)

    def simulate(self, seconds: float) -> _Run:
        n, levels = round(100 * seconds), []
        while sum(map(len, levels)) < n:
            levels.append(np.full(self._own.integers(20, 150), self._own.uniform(-0.6, 0.6)))
        i, t0, p = np.concatenate(levels)[:n], self._t, self.pendulum
        self._t += seconds
        angle = _swing(i, self._x, p["J"], p["w"], p["K"], p["b"], p["tau_c"], p["T_m"], p["k"])
        return _Run(
            {"current": i, "angle": angle + 1e-3 * self._noise.standard_normal(n)},
            self.units,
            0.01,
            t0,
        )


@njit(cache=True)
def _swing(i, x, J, w, K, b, tau_c, T_m, k):  # type: ignore[no-untyped-def]
    angle, h = np.empty(len(i)), 2e-4
    for n in range(len(i)):
        angle[n] = x[0]
        for _ in range(50):
            x[2] += h * (i[n] - x[2]) / T_m
            pushed = x[1] + h * (K * x[2] - w * np.sin(x[0]) - b * x[1] - k * x[0]) / J
            x[1] = np.sign(pushed) * max(abs(pushed) - h * tau_c / J, 0.0)
            x[0] += h * x[1]
    return angle


class _Constants(dict[str, float]):
    def _replace(self, **values: float) -> _Constants:
        return _Constants({**self, **values})


@dataclass(frozen=True)
class _Run:
    channels: Mapping[str, Any]
    units: Mapping[str, str]
    sample_time: float
    t0: float


@njit(cache=True)
def _blow(u, x, K, R, J, tau_c, c, b):  # type: ignore[no-untyped-def]
    n, h = len(u), 1e-3
    speed, current = np.empty(n), np.empty(n)
    for k in range(n):
        speed[k], current[k] = x[0], (u[k] - K * x[0]) / R
        for _ in range(10):
            torque = (
                K * (u[k] - K * x[0]) / R - np.sign(x[0]) * tau_c - b * x[0] - c * x[0] * abs(x[0])
            )
            x[0] += h * torque / J
    return speed, current


def _constant(constants: Any, name: str) -> float:
    return float(constants[name] if isinstance(constants, dict) else getattr(constants, name))


def constant_of(watched: Watched, seed: int, name: str) -> float:
    """A constant of the machine of this seed, without a fault."""
    return _constant(getattr(watched.make(seed), watched.constants), name)


def windows(
    watched: Watched, seed: int, first: int, count: int, fault: Fault | None = None
) -> list[Record]:
    """Windows `first` … of the machine of this seed, damaged from window `first` on; from the cache where they are there."""
    key = repr((watched.name, watched.seconds, dict(watched.warm), seed, first, count, fault))
    path = _folder() / f"{watched.name}-{hashlib.sha256(key.encode()).hexdigest()[:20]}.npz"
    if not path.exists():
        made = _made(watched, seed, first, count, fault)
        data = {f"{k}/{name}": np.asarray(r[name]) for k, r in enumerate(made) for name in r.names}
        units = [f"{name}={unit}" for name, unit in made[0].units.items()]
        np.savez(
            path,
            units=np.array(units),
            times=np.array([[r.sample_time, r.t0] for r in made]),
            **data,
        )
    stored = np.load(path)
    units = dict(text.split("=", 1) for text in stored["units"].tolist())
    return [
        Record(
            {n: stored[f"{k}/{n}"] for n in units},
            units,
            float(Ts),
            t0=float(t0),
            source=f"{watched.name} {first + k}",
        )
        for k, (Ts, t0) in enumerate(stored["times"])
    ]


def _folder() -> Path:
    folder = Path(
        os.environ.get("RESIDUUM_WINDOWS", Path(tempfile.gettempdir()) / "residuum-watched")
    )
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _made(watched: Watched, seed: int, first: int, count: int, fault: Fault | None) -> list[Record]:
    machine, nominal = _run_before(watched, seed, first)
    if fault:
        _break(machine, fault)
    found = []
    for k in range(first, first + count):
        temperature, here = _at_temperature(watched, nominal, seed, k)
        setattr(machine, watched.constants, _damaged(here, fault) if fault else here)
        found.append(_record(watched, machine.simulate(watched.seconds), k, fault, temperature))
    return found


def _run_before(watched: Watched, seed: int, k: int) -> tuple[Any, Any]:
    """The healthy machine of this seed after its windows before k, and its constants."""
    machine = watched.make(seed)
    nominal = getattr(machine, watched.constants)
    for before in range(k):
        setattr(machine, watched.constants, _at_temperature(watched, nominal, seed, before)[1])
        machine.simulate(watched.seconds)
    return machine, nominal


def _break(machine: Any, fault: Fault) -> None:
    """Two bodies begin where their one was."""
    if "two_bodies" in (fault.set or {}):
        machine._y[2:4] = machine._y[0:2]


def _at_temperature(watched: Watched, nominal: Any, seed: int, k: int) -> tuple[float, Any]:
    """The temperature of window k, and the machine's constants at it."""
    temperature = float(np.random.default_rng([seed, k, 21]).uniform(*_TEMPERATURES))
    warm = {
        n: _constant(nominal, n) * (1.0 + a * (temperature - 20.0)) for n, a in watched.warm.items()
    }
    return temperature, nominal._replace(**warm)


def machine_window(
    watched: Watched, machine: Any, seed: int, k: int, scaled: Mapping[str, float]
) -> Record:
    """The next window, number k, of a machine, some of its constants scaled; it is left as it was made."""
    nominal = getattr(machine, watched.constants)
    temperature, here = _at_temperature(watched, nominal, seed, k)
    setattr(machine, watched.constants, _damaged(here, Fault("worn", (), scaled=scaled)))
    run = machine.simulate(watched.seconds)
    setattr(machine, watched.constants, nominal)
    return _record(watched, run, k, None, temperature)


def record_of(watched: Watched, seed: int, k: int, fault: Fault, begins: float) -> Record:
    """Window k of the machine of this seed, in which a fault begins after this share of it."""
    machine, nominal = _run_before(watched, seed, k)
    temperature, here = _at_temperature(watched, nominal, seed, k)
    setattr(machine, watched.constants, here)
    head = machine.simulate(begins * watched.seconds)
    _break(machine, fault)
    setattr(machine, watched.constants, _damaged(here, fault))
    tail = machine.simulate((1.0 - begins) * watched.seconds)
    healthy, faulty = (
        _record(watched, run, k, which, temperature) for run, which in ((head, None), (tail, fault))
    )
    joined = {name: np.concatenate([healthy[name], faulty[name]]) for name in healthy.names}
    return Record(
        joined, dict(healthy.units), head.sample_time, t0=head.t0, source=f"{watched.name} {k}"
    )


def _damaged(constants: Any, fault: Fault) -> Any:
    scaled = {n: _constant(constants, n) * f for n, f in (fault.scaled or {}).items()}
    return constants._replace(**scaled, **(fault.set or {}))


def _record(watched: Watched, run: Any, k: int, fault: Fault | None, temperature: float) -> Record:
    channels, units = dict(run.channels), dict(run.units)
    if fault is not None:
        channels |= _misread(channels, fault, k)
    if watched.warm:
        n = len(next(iter(channels.values())))
        draws = np.random.default_rng([k, 22]).standard_normal(n)
        channels["temperature"], units["temperature"] = temperature + 0.2 * draws, "degC"
    return Record(channels, units, run.sample_time, t0=run.t0, source=f"{watched.name} {k}")


def _misread(channels: Mapping[str, Any], fault: Fault, k: int) -> dict[str, Any]:
    """The channels that the fault's sensors read otherwise in window k."""
    rng = np.random.default_rng([k, 23])
    found = {name: channels[name] + added for name, added in (fault.reading or {}).items()}
    found |= {name: channels[name] * factor for name, factor in (fault.gain or {}).items()}
    return found | {
        name: channels[name] + std * rng.standard_normal(len(channels[name]))
        for name, std in (fault.noise or {}).items()
    }


# --- models and faults


def _off(model: PhysicalModel) -> PhysicalModel:
    """All values of the file 5 % off, every other one upwards."""
    values = {n: p.value for n, p in model.all_parameters.items() if n not in ("g", "T_a", "N")}
    return model.with_values(
        {n: v * (OFF if k % 2 else 2.0 - OFF) for k, (n, v) in enumerate(values.items())}
    )


def _drive() -> PhysicalModel:
    return _off(load_model("gate-drive").with_effect("coulomb-friction", "shaft", {"tau_c": 0.02}))


def _axis() -> PhysicalModel:
    model = load_model("linear-axis").with_effect("coulomb-friction", "axis", {"tau_c": 20.0})
    return _off(model.with_effect("viscous-friction", "axis", {"d": 60.0}))


def _oven() -> PhysicalModel:
    return _off(load_model("oven"))


def _tanks() -> PhysicalModel:
    return _off(load_model("two-tanks"))


_FAN = """
name: fan
inputs: {voltage: V}
states: {omega: {unit: rad/s}}
parameters:
  K: {value: 0.05, unit: V*s/rad, lower: 0.001}
  R: {value: 1.1, unit: ohm, lower: 0.01}
  J: {value: 6.0e-4, unit: kg*m**2, lower: 1.0e-6}
  c: {value: 1.6e-6, unit: N*m*s**2/rad**2, lower: 0}
  tau_c: {value: 0.012, unit: N*m, lower: 0}
balances:
  shaft: {kind: torque, storage: J * der(omega), terms: {motor: K * i, air: -c * omega * abs(omega), dry: -tau_c * sign(omega)}, velocity: omega}
  winding: {kind: voltage, storage: 0, terms: {supply: voltage, resistance: -R * i, back_emf: -K * omega}, current: i}
outputs:
  speed: {value: omega, unit: rad/s}
  current: {value: i, unit: A}
"""  # noqa: E501


_PENDULUM = """
name: pendulum
inputs: {current: A}
states: {phi: {unit: rad, rate: v}, v: {unit: rad/s}}
parameters:
  J: {value: 0.02, unit: kg*m**2, fixed: true}
  w: {value: 0.8, unit: N*m, lower: 0.01}
  K: {value: 0.4, unit: N*m/A, lower: 0.01}
  b: {value: 0.012, unit: N*m*s/rad, lower: 0}
balances:
  arm:
    kind: torque
    storage: J * der(v)
    terms: {motor: K * current, weight: -w * sin(phi), air: -b * v}
    position: phi
    velocity: v
outputs: {angle: {value: phi, unit: rad}}
"""


def _pendulum() -> PhysicalModel:
    return _off(read_model(_PENDULUM, "pendulum.yaml"))


def _fan() -> PhysicalModel:
    return _off(read_model(_FAN, "fan.yaml"))


def _drive_machine(seed: int) -> Any:
    effects = {"coulomb-friction": {}, "quadratic-drag": {"c": 2e-8}}
    return MACHINES["gate-drive"](seed, effects, profile="rich", noise_color=0.5, deviation=0.05)


def _axis_machine(seed: int) -> Any:
    effects = {"coulomb-friction": {}, "viscous-friction": {}, "position-load": "small"}
    return MACHINES["linear-axis"](seed, effects, rate=250.0, deviation=0.05)


def _oven_machine(seed: int) -> Any:
    return MACHINES["oven"](seed, {"radiation": "small"}, configuration="lumped", profile="steps")


def _tanks_machine(seed: int) -> Any:
    return MACHINES["two-tanks"](seed, {"pump-nonlinearity": "small"}, deviation=0.05)


def _pair(
    id: str, name: str, causes: tuple[str, ...], size: str | None = None
) -> tuple[Fault, ...]:
    return tuple(
        Fault(f"{id} {sign}20 %", causes, scaled={name: f}, size=(size, f) if size else None)
        for sign, f in (("+", 1.2), ("−", 0.8))
    )


def _sensor(channel: str, offset: float) -> Fault:
    return Fault(
        f"{channel} offset 1 %",
        (f"offset@{channel}",),
        "sensor",
        reading={channel: offset},
        size=("offset", offset),
    )


DRIVE = Watched(
    "gate-drive", 15.0, _drive_machine, "drive", _drive, {"R": _COPPER, "tau_c": _GREASE},
    (
        *_pair("R", "R", ("R",), "R"), *_pair("K", "K", ("K",), "K"), *_pair("gate's inertia", "J_L", ("m",), "m"),
        Fault("friction +30 %", ("coulomb-friction@shaft",), scaled={"tau_c": 1.3}, size=("coulomb-friction@shaft.tau_c", 1.3)),
        _sensor("speed", 3.45), _sensor("current", 0.3),
        Fault("speed reads 4 % more", ("gain@speed",), "sensor", gain={"speed": 1.04}, size=("gain", 0.04)),
        Fault("current noisier", ("noise@current",), "sensor", noise={"current": 0.15}, size=("noise", 0.15)),
        Fault("new play", ("backlash@shaft", "elastic-transmission@shaft"), set={"two_bodies": True, "gap": 0.5}),
    ),
    {"m": ("J_L", (44 / (0.028 * (2.0 - OFF))) ** 2)},  # m makes up for the rotor's inertia too, held at the file's
)  # fmt: skip
AXIS = Watched(
    "linear-axis", 10.0, _axis_machine, "axis", _axis, {"tau_c": _GREASE, "b": _GREASE},
    (
        *_pair("M", "M", ("M",), "M"), *_pair("viscous", "b", ("viscous-friction@axis",), "viscous-friction@axis.d"),
        Fault("friction +30 %", ("coulomb-friction@axis",), scaled={"tau_c": 1.3}, size=("coulomb-friction@axis.tau_c", 1.3)),
        _sensor("velocity", 0.016),
        Fault("new spring", ("linear-spring@axis",), set={"k": 60.0}),
    ),
)  # fmt: skip
OVEN = Watched(
    "oven", 8 * 3600.0, _oven_machine, "oven", _oven, {},
    (
        *_pair("loss", "G_ambient", ("h",), "h"), *_pair("heat capacity", "C_hole", ("C",), "C"),
        *_pair("power", "P", ("gain@duty", "P")), _sensor("temperature", 2.5),
    ),
    {"h": ("G_ambient", 2.0 - OFF), "C": ("C_hole", 2.0 - OFF)},  # the power's rating, which fixes both, is 5 % off
)  # fmt: skip
TANKS = Watched(
    "two-tanks", 600.0, _tanks_machine, "tanks", _tanks, {},
    (
        *_pair("upper outlet", "a_1", ("a_1",), "a_1"), *_pair("lower outlet", "a_2", ("a_2",), "a_2"),
        *_pair("pump", "k_p", ("k_p", "gain@pump"), "k_p"), _sensor("level_1", 0.006), _sensor("level_2", 0.006),
        Fault("leak", ("leak@lower", "outflow@lower"), set={"c": 1.5e-5}),
    ),
)  # fmt: skip
FAN = Watched(
    "fan", 20.0, Fan, "fan", _fan, {"R": _COPPER, "tau_c": _GREASE},
    (
        *_pair("R", "R", ("R",), "R"), *_pair("K", "K", ("K",), "K"), *_pair("J", "J", ("J",), "J"),
        *_pair("air", "c", ("c", "quadratic-drag@shaft"), "c"),
        Fault("friction +30 %", ("tau_c", "coulomb-friction@shaft"), scaled={"tau_c": 1.3}, size=("tau_c", 1.3)),
        _sensor("speed", 4.0), _sensor("current", 0.1),
    ),
)  # fmt: skip
PENDULUM = Watched(
    "pendulum", 15.0, Pendulum, "pendulum", _pendulum, {"b": _GREASE, "tau_c": _GREASE},
    (
        *_pair("weight", "w", ("w",)), *_pair("torque constant", "K", ("K", "gain@current")),
        Fault("air × 2", ("b", "viscous-friction@arm"), scaled={"b": 2.0}),
        Fault("friction × 2", ("coulomb-friction@arm",), scaled={"tau_c": 2.0}),
        Fault("friction gone", ("coulomb-friction@arm",), scaled={"tau_c": 0.01}),
        Fault("motor × 4 slower", ("input-lag@current", "delay@current", "lag@angle", "delay@angle"), scaled={"T_m": 4.0}),
        Fault("new spring", ("linear-spring@arm", "cubic-spring@arm"), set={"k": 0.1}),
        _sensor("angle", 0.01),
    ),
)  # fmt: skip
WATCHED = {w.name: w for w in (DRIVE, AXIS, OVEN, TANKS, FAN, PENDULUM)}
