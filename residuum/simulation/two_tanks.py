"""Two tanks in cascade: a pump fills the upper one, which runs into the lower one, which runs
out.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from residuum.kept_loops import njit
from residuum.simulation.machine import BadSetting, Effect, Fault, Machine
from residuum.simulation.signals import Array

_GRAVITY = 9.81
_STEP = 0.1  # s
_HEIGHT = 0.6  # m


class Tanks(NamedTuple):
    """Nominal areas and pump, and the hidden effects' parameters, all absent."""

    A_1: float = 0.0154  # m²
    A_2: float = 0.0154  # m²
    a_1: float = 5.0e-5  # m², outlet of tank 1
    a_2: float = 5.0e-5  # m², outlet of tank 2
    k_p: float = 2.0e-5  # m³/(s·V)
    a_x: float = 0.0
    rim: float = np.inf
    c: float = 0.0
    beta: float = 0.0


EFFECTS: dict[str, Effect] = {
    "outflow": Effect(
        {"a_x": 8e-6},
        {"a_x": "m**2"},
        (2e-6, 8e-6, 2.5e-5),
        "a second outlet at tank 1: flow −a_x √(2 g h_1)",
    ),
    "overflow": Effect(
        {"rim": 0.3}, {"rim": "m"}, (0.38, 0.3, 0.22), "tank 1 runs over at this level into tank 2"
    ),
    "leak": Effect(
        {"c": 2e-5}, {"c": "m**2/s"}, (5e-6, 2e-5, 6e-5), "a seeping bottom of tank 2: flow −c h_2"
    ),
    "pump-nonlinearity": Effect(
        {"beta": 0.03}, {"beta": "1/V"}, (0.01, 0.03, 0.06), "pump flow k_p u (1 − beta u)"
    ),
}


class TwoTanks(Machine):
    r"""Pump voltage in, two levels out, one sample a second.

    .. math::
        A_1 \dot h_1 = k_p u - a_1 \sqrt{2 g h_1}, \qquad
        A_2 \dot h_2 = a_1 \sqrt{2 g h_1} - a_2 \sqrt{2 g h_2}

    u: levels between 2 and 8 V held for 40 to 200 s. Classical Runge–Kutta, 0.1 s; levels stay
    between 0 and 0.6 m. Noise 0.5 mm.

    Parameters
    ----------
    deviation : float
        a_1, a_2 and k_p differ from nominal by uniform factors within ± this.
    noise : float
        Multiplies the level sensors' noise.
    """

    name = "two-tanks"
    record_duration = 4000.0
    sample_time = 1.0
    units: ClassVar[Mapping[str, str]] = {"pump": "V", "level_1": "m", "level_2": "m"}
    effects: ClassVar[Mapping[str, Effect]] = EFFECTS
    faults: ClassVar[Mapping[str, Fault]] = {
        "clogged-outlet": Fault(0.3, "", "part of tank 1's outlet that is blocked", largest=1.0),
    }

    def __init__(
        self,
        seed: int = 0,
        effects: Mapping[str, Mapping[str, float] | str] | None = None,
        faults: Mapping[str, float | None] | None = None,
        exemplar: int = 0,
        *,
        deviation: float = 0.1,
        noise: float = 1.0,
    ) -> None:
        if not (0.0 <= deviation <= 0.5 and 0.0 <= noise <= 100.0):
            raise BadSetting("two-tanks: deviation must be 0 … 0.5 and noise 0 … 100")
        super().__init__(seed, effects, faults, exemplar)
        own = np.random.default_rng([seed, exemplar, 5])
        nominal = Tanks()
        factors = zip(
            ("a_1", "a_2", "k_p"), 1.0 + own.uniform(-deviation, deviation, 3), strict=True
        )
        values: dict[str, Any] = {name: getattr(nominal, name) * factor for name, factor in factors}
        for parameters in self.active_effects.values():
            values.update(parameters)
        self.tanks = nominal._replace(**values)
        self._noise = noise
        self._levels = own
        self._hold = [0.0, 5.0]  # until when [s], which voltage
        self._h = own.uniform(0.05, 0.25, 2)

    def _run(self, n: int) -> dict[str, Array]:
        u = np.empty(n)
        for k in range(n):
            if self._samples + k >= self._hold[0]:
                self._hold = [
                    self._samples + k + self._levels.uniform(40, 200),
                    float(self._levels.uniform(2, 8)),
                ]
            u[k] = self._hold[1]
        tanks = self.tanks._replace(
            a_1=self.tanks.a_1 * (1.0 - self.active_faults.get("clogged-outlet", 0.0))
        )
        out = np.empty((2, n))
        _live(out, self._h, tanks, u, self.sample_time)
        levels = out + 5e-4 * self._noise * self._rng.standard_normal((n, 2)).T
        return {"pump": u, "level_1": levels[0], "level_2": levels[1]}

    def _constants(self) -> dict[str, float]:
        return {
            name: float(getattr(self.tanks, name)) for name in ("A_1", "A_2", "a_1", "a_2", "k_p")
        }


@njit()
def _rates(h_1, h_2, p, u):  # type: ignore[no-untyped-def]
    fall_1, fall_2 = (
        np.sqrt(2.0 * _GRAVITY * max(h_1, 0.0)),
        np.sqrt(2.0 * _GRAVITY * max(h_2, 0.0)),
    )
    pumped = p.k_p * u * (1.0 - p.beta * u)
    over = 2e-2 * max(h_1 - p.rim, 0.0) * np.sqrt(max(h_1 - p.rim, 0.0))  # a weir of 1 cm: m³/s
    rate_1 = (pumped - (p.a_1 + p.a_x) * fall_1 - over) / p.A_1
    rate_2 = (p.a_1 * fall_1 + over - p.a_2 * fall_2 - p.c * max(h_2, 0.0)) / p.A_2
    return rate_1, rate_2


@njit()
def _live(out, h, p, u, Ts):  # type: ignore[no-untyped-def]
    steps = int(np.round(Ts / _STEP))
    for k in range(out.shape[1]):
        out[0, k], out[1, k] = h[0], h[1]
        for _ in range(steps):
            a1, b1 = _rates(h[0], h[1], p, u[k])
            a2, b2 = _rates(h[0] + 0.5 * _STEP * a1, h[1] + 0.5 * _STEP * b1, p, u[k])
            a3, b3 = _rates(h[0] + 0.5 * _STEP * a2, h[1] + 0.5 * _STEP * b2, p, u[k])
            a4, b4 = _rates(h[0] + _STEP * a3, h[1] + _STEP * b3, p, u[k])
            h[0] = min(max(h[0] + _STEP / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4), 0.0), _HEIGHT)
            h[1] = min(max(h[1] + _STEP / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4), 0.0), _HEIGHT)
