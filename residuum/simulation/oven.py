"""The oven that shrinks film around bottles: six resistances in two cavities, fans, slots, curtains
and a conveyor.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from residuum.kept_loops import njit
from residuum.nearest_names import known_names
from residuum.simulation.machine import BadSetting, Effect, Fault, Machine
from residuum.simulation.signals import Array

PROFILES = ("bounded-noise", "experiment", "steps")
_STEP = 1.0  # s
_PWM_PERIOD = 20.0  # s
_ZERO = 273.15
_CAVITY_1, _CAVITY_2, _HOLE, _WALL, _STORE, _SENSOR = range(6)


class Oven(NamedTuple):
    """Heat capacities [J/K], conductances [W/K] and power [W] of the oven in one configuration."""

    lumped: bool
    P: float = 12e3  # W, six resistances
    C_cavity: float = 8e3
    C_hole: float = 15e3
    C_wall: float = 90e3
    G_slots: float = 400.0  # air that the internal fans drive round cavities and main hole
    G_wall: float = 60.0  # main hole to wall
    G_cavity_wall: float = 20.0  # each cavity to wall
    G_curtains: float = 15.0  # air exchanged through the PVC strips
    G_belt: float = 0.0  # outside air and cold products that the conveyor brings
    G_fans: float = 0.0  # cold air that the external fans lift to the curtains
    G_ambient: float = 25.0  # wall, or the whole lumped oven, to ambient
    T_sensor: float = 25.0  # s, thermocouple
    gamma: float = 0.0
    loss: float = 0.0
    epsilon: float = 0.0
    C_2: float = 1.0
    G_2: float = 0.0
    belt: float = 0.0
    door: float = 0.0


CONFIGURATIONS: dict[str, Oven] = {
    "best": Oven(lumped=False),
    "worst": Oven(lumped=False, G_slots=150.0, G_curtains=45.0, G_belt=25.0, G_fans=15.0),
    "lumped": Oven(lumped=True, C_hole=120e3, G_ambient=45.0),
}
EFFECTS: dict[str, Effect] = {
    "ambient-loss": Effect(
        {"G": 10.0}, {"G": "W/K"}, (3.0, 10.0, 30.0), "heat −G (T − T_ambient) more than nominal"
    ),
    "radiation": Effect(
        {"epsilon": 3e-8},
        {"epsilon": "W/K**4"},
        (1e-8, 3e-8, 1e-7),
        "heat −epsilon (T⁴ − T_ambient⁴), kelvin",
    ),
    "second-heat-store": Effect(
        {"C_2": 6e4, "G_2": 60.0},
        {"C_2": "J/K", "G_2": "W/K"},
        (2e4, 6e4, 2e5),
        "a second store: C_2 dT_2/dt = G_2 (T − T_2)",
    ),
    "conveyor-load": Effect(
        {"G": 15.0},
        {"G": "W/K"},
        (5.0, 15.0, 40.0),
        "heat −G (T − T_ambient) while the conveyor runs: 40 of 70 minutes",
    ),
    "door-opening": Effect(
        {"G": 100.0},
        {"G": "W/K"},
        (30.0, 100.0, 300.0),
        "heat −G (T − T_ambient) in openings of 3 to 10 minutes at random times",
    ),
    "heater-nonlinearity": Effect(
        {"gamma": 0.3}, {"gamma": ""}, (0.1, 0.3, 0.6), "power P duty^(1 + gamma)"
    ),
}
_FIELDS = {
    "ambient-loss": {"G": "loss"},
    "conveyor-load": {"G": "belt"},
    "door-opening": {"G": "door"},
}


class OvenMachine(Machine):
    r"""Duty cycle of six resistances [%] in, one thermocouple at the top of the main hole out.

    .. math::
        C_c \dot T_{c,j} &= P(u)/2 - \tfrac12 G_s (T_{c,j} - T_h) - G_{cw} (T_{c,j} - T_w), \quad j
        = 1, 2 \\ C_h \dot T_h &= \sum_j \tfrac12 G_s (T_{c,j} - T_h) - (G_c + G_b + G_f)(T_h - T_a)
        - G_w (T_h - T_w) \\ C_w \dot T_w &= G_w (T_h - T_w) + \sum_j G_{cw}(T_{c,j} - T_w) - G_a
        (T_w - T_a), \qquad T_{tc} \dot T = T_h - T

    Configurations, as Table 5 of the source must have meant them (its figure is lost): *best* keeps
    the heat — curtains closed, conveyor and external fans off, lateral slots open, so that the fans
    recirculate; *worst* loses it — curtains open for production, conveyor at full speed with cold
    products, external fans on, slots closed. Deflectors direct air without changing its amount
    (Remark 5.1) and have no term. 60 % duty settles near 225 °C and 90 °C. *lumped* is one heat
    store, C dT/dt = P u − G_a (T − T_a), for studies of hidden effects.

    The pulse width modulation has a period of 20 s; the duty saturates at 0 and 100 %; the
    thermocouple adds 0.1 °C of noise and 0.1 °C steps; the ambient wanders by ±3 °C a day. Conveyor
    and door of the hidden effects are not recorded.

    Parameters
    ----------
    configuration : {"best", "worst", "lumped"}
        `configure` changes it while the oven runs.
    profile : {"bounded-noise", "experiment", "steps"}
        Duty of mean 60 % and standard deviation 30 % clipped to 0 … 100 %, new each sample; the
        same with the first and last 400 of every 4800 samples at zero; or levels held for 20 to 90
        minutes. `set_input` overrides it.
    sample_time_s : float
        1 … 60 s.
    """

    name = "oven"
    record_duration = 48 * 3600.0
    units: ClassVar[Mapping[str, str]] = {"duty": "%", "temperature": "°C", "ambient": "°C"}
    effects: ClassVar[Mapping[str, Effect]] = EFFECTS
    faults: ClassVar[Mapping[str, Fault]] = {
        "heater-failure": Fault(1.0, "", "how many of the six resistances are broken", largest=6.0),
        "sensor-offset": Fault(10.0, "°C", "the thermocouple reads this much too high"),
    }

    def __init__(
        self,
        seed: int = 0,
        effects: Mapping[str, Mapping[str, float] | str] | None = None,
        faults: Mapping[str, float | None] | None = None,
        exemplar: int = 0,
        *,
        configuration: str = "best",
        profile: str = "bounded-noise",
        sample_time_s: float = 60.0,
    ) -> None:
        if profile not in PROFILES:
            raise BadSetting(
                f"oven: profile {profile!r} is not known; {known_names(profile, PROFILES)}"
            )
        if not 1.0 <= sample_time_s <= 60.0:
            raise BadSetting(
                f"oven: sample_time_s is {sample_time_s!r}; must be between 1 and 60 s"
            )
        super().__init__(seed, effects, faults, exemplar)
        self.sample_time = float(sample_time_s)
        self._profile = profile
        self._factors = 1.0 + 0.05 * self._tolerance(3)
        self.configure(configuration)
        day = np.random.default_rng([seed, 4])
        self._day = float(day.uniform(0, 2 * np.pi))
        self._door_rng, self._doors = day, [0.0, 0.0]
        self._T = np.full(6, float(self._ambient(np.zeros(1))[0]))
        self._commanded: float | None = None
        self._level, self._level_until = 60.0, 0.0

    def configure(self, configuration: str) -> None:
        """Change the oven's configuration from now on; its temperatures stay."""
        if configuration not in CONFIGURATIONS:
            raise BadSetting(
                f"oven: configuration {configuration!r} is not known;"
                f" {known_names(configuration, CONFIGURATIONS)}"
            )
        nominal = CONFIGURATIONS[configuration]
        P, C, G = self._factors
        values: dict[str, Any] = {
            "P": nominal.P * P,
            "C_hole": nominal.C_hole * C,
            "G_ambient": nominal.G_ambient * G,
        }
        for id, parameters in self.active_effects.items():
            values.update(
                {_FIELDS.get(id, {}).get(name, name): value for name, value in parameters.items()}
            )
        self.oven = nominal._replace(**values)

    def set_input(self, duty: float | None) -> None:
        """Let an outer controller command the duty [%] (clipped to 0 … 100) from now on; None
        returns to the profile.
        """
        self._commanded = None if duty is None else float(np.clip(duty, 0.0, 100.0))

    def _ambient(self, t: Array) -> Array:
        return 20.0 + 3.0 * np.sin(2 * np.pi * t / 86400.0 + self._day)

    def _run(self, n: int) -> dict[str, Array]:
        k = self._samples + np.arange(n)
        draws = self._rng.standard_normal((n, 4))
        duty = self._duty(k, draws[:, 0], draws[:, 3])
        steps = int(np.ceil(self.sample_time / _STEP))
        # exact where the period divides
        t = k[:, None] * self.sample_time + np.arange(steps) * (self.sample_time / steps)
        ambient = self._ambient(k * self.sample_time)
        alive = 1.0 - self.active_faults.get("heater-failure", 0.0) / 6.0
        running = (t % 4200.0 < 2400.0).astype(float)
        out = np.empty(n)
        _live(
            out,
            self._T,
            self.oven,
            duty / 100.0,
            alive,
            ambient,
            running,
            self._openings(t),
            self.sample_time / steps,
            t,
        )
        temperature = out + 0.1 * draws[:, 1] + self.active_faults.get("sensor-offset", 0.0)
        return {
            "duty": duty,
            "temperature": 0.1 * np.round(temperature / 0.1),
            "ambient": 0.1 * np.round((ambient + 0.05 * draws[:, 2]) / 0.1),
        }

    def _duty(self, k: npt.NDArray[np.integer], draws: Array, holds: Array) -> Array:
        if self._commanded is not None:
            return np.full(len(k), self._commanded)
        if self._profile == "steps":
            return self._levels(k * self.sample_time, draws, holds)
        duty = np.clip(60.0 + 30.0 * draws, 0.0, 100.0)
        idle = (k % 4800 < 400) | (k % 4800 >= 4400)
        return np.where(idle, 0.0, duty) if self._profile == "experiment" else duty

    def _levels(self, t: Array, draws: Array, holds: Array) -> Array:
        duty = np.empty(len(t))
        for j, now in enumerate(t):
            if now >= self._level_until:
                self._level = float(np.clip(60.0 + 30.0 * draws[j], 0.0, 100.0))
                self._level_until = now + 60.0 * (55.0 + 35.0 * np.tanh(holds[j]))
            duty[j] = self._level
        return duty

    def _openings(self, t: Array) -> Array:
        """1 while the door is open: openings of 3 to 10 minutes, 20 to 120 minutes apart."""
        while self._doors[-1] < t[-1, -1]:
            opens = self._doors[-1] + 60.0 * self._door_rng.uniform(20, 120)
            self._doors += [opens, opens + 60.0 * self._door_rng.uniform(3, 10)]
        return (np.searchsorted(self._doors, t, side="right") % 2 == 1).astype(float)

    def _constants(self) -> dict[str, float]:
        return {
            name: float(value) for name, value in self.oven._asdict().items() if name[0] in "PCGT"
        }


@njit()
def _slope(dT, T, o, power, ambient, running, open_door):  # type: ignore[no-untyped-def]
    hole = T[_HOLE]
    hot, cold = hole + _ZERO, ambient + _ZERO
    lost = (o.loss + o.belt * running + o.door * open_door) * (hole - ambient) + o.epsilon * (
        hot**4 - cold**4
    )
    lost += o.G_2 * (hole - T[_STORE])
    dT[_STORE] = o.G_2 * (hole - T[_STORE]) / o.C_2
    dT[_SENSOR] = (hole - T[_SENSOR]) / o.T_sensor
    if o.lumped:
        dT[_HOLE] = (power - o.G_ambient * (hole - ambient) - lost) / o.C_hole
        dT[_CAVITY_1], dT[_CAVITY_2], dT[_WALL] = 0.0, 0.0, 0.0
        return
    into_hole, into_wall = 0.0, o.G_wall * (hole - T[_WALL])
    for j in range(2):
        air = 0.5 * o.G_slots * (T[j] - hole)
        side = o.G_cavity_wall * (T[j] - T[_WALL])
        dT[j] = (0.5 * power - air - side) / o.C_cavity
        into_hole += air
        into_wall += side
    outside = (o.G_curtains + o.G_belt + o.G_fans) * (hole - ambient)
    dT[_HOLE] = (into_hole - outside - o.G_wall * (hole - T[_WALL]) - lost) / o.C_hole
    dT[_WALL] = (into_wall - o.G_ambient * (T[_WALL] - ambient)) / o.C_wall


@njit()
def _live(out, T, o, duty, alive, ambient, running, open_door, h, t):  # type: ignore[no-untyped-def]
    first, second = np.empty(6), np.empty(6)
    for k in range(len(out)):
        out[k] = T[_SENSOR]
        for j in range(t.shape[1]):
            since = t[k, j] % _PWM_PERIOD  # the heaters are on for the first part of each period
            on = min(max((duty[k] * _PWM_PERIOD - since) / h, 0.0), 1.0)
            power = o.P * alive * (on if o.gamma == 0.0 else duty[k] ** (1.0 + o.gamma))
            _slope(first, T, o, power, ambient[k], running[k, j], open_door[k, j])
            _slope(second, T + h * first, o, power, ambient[k], running[k, j], open_door[k, j])
            T += 0.5 * h * (first + second)
