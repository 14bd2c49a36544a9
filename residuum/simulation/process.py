"""The process plant: a third-order benchmark under white or multi-level excitation, with sensor and
actuator faults.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import cont2discrete

from residuum.nearest_names import known_names
from residuum.simulation.machine import BadSetting, Fault, Machine
from residuum.simulation.signals import Array

NUMERATOR = 47619.0
DENOMINATOR = (1.0, 234.0136, 6857.1, 5442.2)
INPUTS = ("white", "multi-level")
_LEVELS = np.array([-1.5, -0.5, 0.5, 1.5]) * np.sqrt(0.8)  # equally likely, variance 1
_DWELL = 40  # samples a level is held


class Process(Machine):
    r"""A linear plant sampled at 0.1 s, excited around the operating point 0.

    .. math:: G(s) = \frac{47619}{s^3 + 234.0136 s^2 + 6857.1 s + 5442.2}, \qquad
              y(t) = G u(t) + e(t), \quad \operatorname{var}(u) = 1, \quad \operatorname{var}(Gu) /
              \operatorname{var}(e) = 9

    (Valceschini, eq. 4.10 and the experiment below it). u is held between samples, so the discrete
    model is exact; e is Gaussian, cut at ±3 standard deviations because the source's noise is
    bounded. var(Gu) is the stationary variance under white input, from the Lyapunov equation. The
    actuator fault acts between the recorded u and the plant, the sensor faults on y.

    Parameters
    ----------
    input : {"white", "multi-level"}
        Gaussian white noise, or four levels of variance 1 held for 4 s each.
    signal_to_noise : float
        var(Gu) / var(e) under white input.
    """

    name = "process"
    sample_time = 0.1
    record_duration = 500.0
    units: ClassVar[Mapping[str, str]] = {"u": "", "y": ""}
    faults: ClassVar[Mapping[str, Fault]] = {
        "sensor-offset": Fault(30.0, "", "y reads this much too high"),
        "sensor-drift": Fault(0.2, "1/s", "y runs away at this rate from the moment of the fault"),
        "actuator-gain": Fault(
            0.5, "", "this fraction of the input's effect on the plant is lost", largest=1.0
        ),
        "stuck-sensor": Fault(
            1.0, "", "y keeps the value it had at the moment of the fault", largest=1.0
        ),
    }

    def __init__(
        self,
        seed: int = 0,
        effects: Mapping[str, Mapping[str, float] | str] | None = None,
        faults: Mapping[str, float | None] | None = None,
        exemplar: int = 0,
        *,
        input: str = "white",
        signal_to_noise: float = 9.0,
    ) -> None:
        if input not in INPUTS:
            raise BadSetting(f"process: input {input!r} is not known; {known_names(input, INPUTS)}")
        if not signal_to_noise > 0:
            raise BadSetting(f"process: signal_to_noise is {signal_to_noise!r}; must be positive")
        gain = NUMERATOR * (
            1.0 + 0.05 * np.random.default_rng([exemplar, 7]).uniform(-1, 1) if exemplar else 1.0
        )
        self._gain = gain / DENOMINATOR[-1]
        top = (-DENOMINATOR[1], -DENOMINATOR[2], -DENOMINATOR[3])
        A = np.array([top, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
        B, C = np.array([[1.0], [0.0], [0.0]]), np.array([[0.0, 0.0, gain]])
        self._A, self._B, self._C, *_ = cont2discrete(
            (A, B, C, np.zeros((1, 1))), self.sample_time, "zoh"
        )
        variance = (
            self._C @ solve_discrete_lyapunov(self._A, self._B @ self._B.T) @ self._C.T
        ).item()
        self._noise_std = float(np.sqrt(variance / signal_to_noise))
        self._input = input
        self._state = np.zeros(3)
        self._level = 0.0
        self._drift = 0.0
        self._last_y = 0.0
        super().__init__(seed, effects, faults, exemplar)

    def clear_fault(self, id: str) -> None:
        """Repair the fault `id`; a repaired drift starts from zero again."""
        super().clear_fault(id)
        if id == "sensor-drift":
            self._drift = 0.0

    def _run(self, n: int) -> dict[str, Array]:
        draws = self._rng.standard_normal((n, 2))
        u = draws[:, 0] if self._input == "white" else self._levels(draws[:, 0])
        e = self._noise_std * np.clip(draws[:, 1], -3.0, 3.0)
        y = self._respond((1.0 - self.active_faults.get("actuator-gain", 0.0)) * u) + e
        return {"u": u, "y": self._sense(y)}

    def _levels(self, draws: Array) -> Array:
        quartile = np.searchsorted([-0.6745, 0.0, 0.6745], draws)
        u = np.empty(len(draws))
        for k in range(len(draws)):
            if (self._samples + k) % _DWELL == 0:
                self._level = float(_LEVELS[quartile[k]])
            u[k] = self._level
        return u

    def _respond(self, u: Array) -> Array:
        y = np.empty(len(u))
        A, b, c, x = self._A, self._B[:, 0], self._C[0], self._state
        for k in range(len(u)):
            y[k] = c @ x
            x = A @ x + b * u[k]
        self._state = x
        return y

    def _sense(self, y: Array) -> Array:
        y = y + self.active_faults.get("sensor-offset", 0.0)
        if rate := self.active_faults.get("sensor-drift"):
            drift = self._drift + rate * self.sample_time * np.arange(1, len(y) + 1)
            self._drift = float(drift[-1])
            y = y + drift
        if "stuck-sensor" in self.active_faults:
            y = np.full(len(y), self._last_y)
        self._last_y = float(y[-1])
        return y

    def _constants(self) -> dict[str, float]:
        return {"static_gain": self._gain, "noise_std": self._noise_std}
