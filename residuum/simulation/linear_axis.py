"""A linear axis: a mass on a guide, moved by a force, usually in closed position control."""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from residuum.kept_loops import njit
from residuum.nearest_names import known_names
from residuum.simulation.machine import BadSetting, Effect, Machine
from residuum.simulation.signals import Array

LOOPS = ("closed", "open")
_SUBSTEPS = 20  # 50 µs at 1 kHz


class Axis(NamedTuple):
    """The axis: nominal mass, and the parameters of every hidden effect, all absent."""

    M: float = 95.0  # kg
    b: float = 0.0
    tau_c: float = 0.0
    tau_s: float = 0.0
    v_s: float = 0.01
    asymmetry: float = 0.0
    drag: float = 0.0
    load: float = 0.0
    amplitude: float = 0.0
    period: float = 1.0
    cogging: float = 0.0
    pitch: float = 0.024
    k: float = 0.0
    k3: float = 0.0
    delay: float = 0.0
    offset: float = 0.0


EFFECTS: dict[str, Effect] = {
    "viscous-friction": Effect({"b": 60.0}, {"b": "N*s/m"}, (15.0, 60.0, 200.0), "force −b v"),
    "coulomb-friction": Effect(
        {"tau_c": 20.0}, {"tau_c": "N"}, (4.0, 20.0, 60.0), "force −tau_c sgn v, with sticking"
    ),
    "stribeck-friction": Effect(
        {"tau_s": 20.0, "tau_c": 20.0, "v_s": 0.01},
        {"tau_s": "N", "tau_c": "N", "v_s": "m/s"},
        (6.0, 20.0, 60.0),
        "force −(tau_c + tau_s exp(−(v/v_s)²)) sgn v",
    ),
    "directional-friction": Effect(
        {"asymmetry": 10.0, "tau_c": 20.0},
        {"asymmetry": "N", "tau_c": "N"},
        (3.0, 10.0, 30.0),
        "Coulomb friction tau_c + asymmetry/2 forwards, tau_c − asymmetry/2 backwards",
    ),
    "quadratic-drag": Effect(
        {"c": 60.0}, {"c": "N*s**2/m**2"}, (15.0, 60.0, 200.0), "force −c v |v|"
    ),
    "constant-load": Effect(
        {"tau_l": 10.0},
        {"tau_l": "N"},
        (2.0, 10.0, 40.0),
        "force −tau_l: an axis that is not level",
    ),
    "position-load": Effect(
        {"amplitude": 10.0, "period": 0.6},
        {"amplitude": "N", "period": "m"},
        (3.0, 10.0, 30.0),
        "−amplitude sin(2π q/period)",
    ),
    "tooth-ripple": Effect(
        {"cogging": 8.0, "pitch": 0.024},
        {"cogging": "N", "pitch": "m"},
        (2.0, 8.0, 25.0),
        "−cogging sin(2π q/pitch)",
    ),
    "linear-spring": Effect(
        {"k": 60.0}, {"k": "N/m"}, (15.0, 60.0, 250.0), "force −k q: a cable carrier"
    ),
    "cubic-spring": Effect(
        {"k3": 1000.0}, {"k3": "N/m**3"}, (250.0, 1000.0, 4000.0), "force −k3 q³"
    ),
    "input-delay": Effect(
        {"delay": 4e-3}, {"delay": "s"}, (1e-3, 4e-3, 1e-2), "the axis sees force(t − delay)"
    ),
    "input-offset": Effect(
        {"offset": 8.0}, {"offset": "N"}, (2.0, 8.0, 30.0), "the axis sees force + offset"
    ),
}
_FIELDS = {"quadratic-drag": {"c": "drag"}, "constant-load": {"tau_l": "load"}}


class LinearAxis(Machine):
    r"""A mass that integrates twice: in closed loop its force says little, in open loop its
    position runs away.

    .. math:: \dot q = v, \qquad M \dot v = F, \qquad M = 95\ \text{kg} \pm 10\%

    The controller samples at the recording's rate with the measured q and v, within ±400 N: F = K_p
    (w − q) + K_v (ẇ − v) + K_i ∫(w − q) + M_nominal ẅ. Its reference w goes from one random place
    to the next within ±0.4 m by quintic motions of at most 0.8 m/s and 3 m/s², and rests between
    them. Dry friction is the hard sign: it is taken from the speed after the smooth forces of a 50
    µs step acted, at most all of it, so that it can stop the mass but never drive it. Position is
    quantised to 5 µm, velocity has noise of 1 mm/s; the recorded force is the command.

    Parameters
    ----------
    loop : {"closed", "open"}
        Open: force levels of ±60 N for 0.1 to 0.5 s, each followed by its reverse.
    rate : float
        Samples a second [Hz], 200 … 5000.
    deviation : float
        M differs from nominal by a uniform factor within ± this.
    noise : float
        Multiplies the sensors' noise.
    """

    name = "linear-axis"
    record_duration = 30.0
    units: ClassVar[Mapping[str, str]] = {"force": "N", "position": "m", "velocity": "m/s"}
    effects: ClassVar[Mapping[str, Effect]] = EFFECTS

    def __init__(
        self,
        seed: int = 0,
        effects: Mapping[str, Mapping[str, float] | str] | None = None,
        faults: Mapping[str, float | None] | None = None,
        exemplar: int = 0,
        *,
        loop: str = "closed",
        rate: float = 1000.0,
        deviation: float = 0.1,
        noise: float = 1.0,
    ) -> None:
        if loop not in LOOPS:
            raise BadSetting(f"linear-axis: loop {loop!r} is not known; {known_names(loop, LOOPS)}")
        if not (200.0 <= rate <= 5000.0 and 0.0 <= deviation <= 0.5 and 0.0 <= noise <= 100.0):
            raise BadSetting(
                "linear-axis: rate must be 200 … 5000 Hz, deviation 0 … 0.5, noise 0 … 100"
            )
        super().__init__(seed, effects, faults, exemplar)
        self.sample_time = 1.0 / rate
        self._loop, self._noise = loop, noise
        own = np.random.default_rng([seed, exemplar, 5])
        values: dict[str, Any] = {"M": Axis().M * (1.0 + own.uniform(-deviation, deviation))}
        for id, parameters in self.active_effects.items():
            values.update(
                {_FIELDS.get(id, {}).get(name, name): value for name, value in parameters.items()}
            )
        self.axis = Axis()._replace(**values)
        self._moves = own
        self._knots = [(0.0, 0.2, 0.0, 0.0)]  # start, end, from, to
        # q, v, ∫e, measured q, measured v
        self._x = np.array([0.02 * own.standard_normal(), 0.0, 0.0, 0.0, 0.0])
        self._late = np.zeros(int(np.floor(self.axis.delay * rate)) + 2)

    def _run(self, n: int) -> dict[str, Array]:
        t = (self._samples + np.arange(n)) * self.sample_time
        w = self._reference(t)
        draws = self._rng.standard_normal((n, 2)) * self._noise
        out = np.empty((3, n))
        _live(
            out, self._x, self.axis, w, self._loop == "closed", draws, self._late, self.sample_time
        )
        return dict(zip(self.units, out, strict=True))

    def _reference(self, t: Array) -> Array:
        """(w, ẇ, ẅ) in closed loop, (F, 0, 0) in open loop; shape (3, n)."""
        while self._knots[-1][1] <= t[-1]:
            self._knots += self._next_move(*self._knots[-1][1::2])
        self._knots = [knot for knot in self._knots if knot[1] > t[0]]
        start, end, a, b = np.array(self._knots).T
        at = np.searchsorted(end, t, side="right")
        if self._loop == "open":
            return np.stack([b[at], np.zeros(len(t)), np.zeros(len(t))])
        T = end[at] - start[at]
        s = (t - start[at]) / T
        way = b[at] - a[at]
        return np.stack(
            [
                a[at] + way * s**3 * (10 - 15 * s + 6 * s**2),
                way / T * 30 * s**2 * (1 - s) ** 2,
                way / T**2 * 60 * s * (1 - s) * (1 - 2 * s),
            ]
        )

    def _next_move(self, now: float, place: float) -> list[tuple[float, float, float, float]]:
        draw = self._moves
        if self._loop == "open":
            level, hold = draw.uniform(20, 60) * draw.choice([-1, 1]), draw.uniform(0.1, 0.5)
            ends = now + hold * np.array([1.0, 3.0, 4.0])
            starts = [now, *ends[:-1]]
            return [
                (float(s), float(e), 0.0, float(f))
                for s, e, f in zip(starts, ends, (level, -level, level), strict=True)
            ]
        target = draw.uniform(-0.4, 0.4)
        way = abs(target - place)
        moving = max(1.875 * way / draw.uniform(0.1, 0.8), np.sqrt(5.774 * way / 3.0), 0.05)
        dwell = draw.uniform(0.1, 0.6)
        return [
            (now, now + moving, place, target),
            (now + moving, now + moving + dwell, target, target),
        ]

    def _constants(self) -> dict[str, float]:
        return {"M": float(self.axis.M)}


@njit()
def _force(q, v, a):  # type: ignore[no-untyped-def]
    """Everything but drive and dry friction, against positive motion [N]."""
    periodic = a.amplitude * np.sin(2 * np.pi * q / a.period) + a.cogging * np.sin(
        2 * np.pi * q / a.pitch
    )
    return a.load + a.b * v + a.drag * v * abs(v) + a.k * q + a.k3 * q**3 + periodic


@njit()
def _dry(v, direction, a):  # type: ignore[no-untyped-def]
    return max(a.tau_c + 0.5 * a.asymmetry * direction + a.tau_s * np.exp(-((v / a.v_s) ** 2)), 0.0)


@njit()
def _move(x, a, F, h):  # type: ignore[no-untyped-def]
    """One step: midpoint rule for what is smooth, then dry friction takes speed away, at most all
    of it.
    """
    q, v = x[0], x[1]
    middle = v + 0.5 * h / a.M * (F - _force(q, v, a) - np.sign(v) * _dry(v, np.sign(v), a))
    free = v + h / a.M * (F - _force(q + 0.5 * h * v, middle, a))
    grip = h / a.M * _dry(middle, np.sign(free), a)
    after = free - np.sign(free) * min(grip, abs(free))
    x[0] = q + 0.5 * h * (v + after)
    x[1] = after


@njit()
def _live(out, x, a, w, closed, draws, late, Ts):  # type: ignore[no-untyped-def]
    h = Ts / _SUBSTEPS
    whole = int(np.floor(a.delay / Ts))
    split = int(np.round((a.delay / Ts - whole) * _SUBSTEPS))
    for k in range(out.shape[1]):
        position = 5e-6 * np.round((x[0] + 2e-6 * draws[k, 0]) / 5e-6)
        velocity = x[1] + 1e-3 * draws[k, 1]
        F = w[0, k]
        if closed:
            error = w[0, k] - position
            x[2] += Ts * error
            F = 40e3 * error + 3e3 * (w[1, k] - velocity) + 150e3 * x[2] + 95.0 * w[2, k]
            F = min(max(F, -400.0), 400.0)
        for j in range(len(late) - 1, 0, -1):
            late[j] = late[j - 1]
        late[0] = F
        out[0, k], out[1, k], out[2, k] = F, position, velocity
        for j in range(_SUBSTEPS):
            _move(x, a, late[whole + (1 if j < split else 0)] + a.offset, h)
