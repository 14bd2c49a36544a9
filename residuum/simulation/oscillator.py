"""An electronic mass–spring–damper with a hardening spring, in the manner of the Silverbox
benchmark.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from residuum.kept_loops import njit
from residuum.nearest_names import known_names
from residuum.simulation.machine import BadSetting, Effect, Machine
from residuum.simulation.signals import Array

PROFILES = ("multisine", "sweep", "noise")
_SUBSTEPS = 8
_OMEGA_0 = 2 * np.pi * 68.6


class Oscillator(NamedTuple):
    """Nominal constants, per volt of spring force, and the hidden effects' parameters, all
    absent.
    """

    M: float = 1.0 / _OMEGA_0**2  # s²
    d: float = 2 * 0.05 / _OMEGA_0  # s
    k: float = 1.0  # V/V
    k3: float = 0.0
    k2: float = 0.0
    drag: float = 0.0
    load: float = 0.0


EFFECTS: dict[str, Effect] = {
    "cubic-spring": Effect({"k3": 2.0}, {"k3": "V/V**3"}, (0.4, 2.0, 8.0), "force −k3 q³"),
    "quadratic-drag": Effect(
        {"c": 3e-6}, {"c": "V*s**2/V**2"}, (6e-7, 3e-6, 1.2e-5), "force −c v |v|"
    ),
    "constant-load": Effect({"tau_l": 0.01}, {"tau_l": "V"}, (0.003, 0.01, 0.04), "force −tau_l"),
    "viscous-friction": Effect(
        {"b": 1e-4}, {"b": "V*s/V"}, (2e-5, 1e-4, 3e-4), "force −b v beyond the nominal damper"
    ),
    "input-offset": Effect(
        {"offset": 0.005}, {"offset": "V"}, (0.001, 0.005, 0.02), "the circuit sees force + offset"
    ),
    "output-offset": Effect(
        {"offset": 0.005},
        {"offset": "V"},
        (0.001, 0.005, 0.02),
        "the recorder reads offset too much",
    ),
    "x-quadratic-spring": Effect(
        {"k2": 0.3}, {"k2": "V/V**2"}, (0.1, 0.3, 1.0), "outside the catalogue: force −k2 q²"
    ),
}
_FIELDS = {"quadratic-drag": {"c": "drag"}, "constant-load": {"tau_l": "load"}}


class OscillatorMachine(Machine):
    r"""Second-order resonance near 68.6 Hz with 5 % damping, sampled at 610.35 Hz.

    .. math:: M \ddot q + d \dot q + k q = F, \qquad k = 1,\ M = 1/\omega_0^2,\ d = 2\zeta/\omega_0

    Integrated by classical Runge–Kutta, 8 steps a sample; the force is held between samples. Noise
    0.3 mV.

    Parameters
    ----------
    profile : {"multisine", "sweep", "noise"}
        Random-phase multisine of odd lines up to 200 Hz (0.05 V RMS), a sweep of rising amplitude
        (0 to 0.15 V), or white noise (0.05 V RMS).
    deviation : float
        M, d and k differ from nominal by uniform factors within ± this.
    """

    name = "oscillator"
    record_duration = 20.0
    sample_time = 1.0 / 610.35
    units: ClassVar[Mapping[str, str]] = {"force": "V", "position": "V"}
    effects: ClassVar[Mapping[str, Effect]] = EFFECTS

    def __init__(
        self,
        seed: int = 0,
        effects: Mapping[str, Mapping[str, float] | str] | None = None,
        faults: Mapping[str, float | None] | None = None,
        exemplar: int = 0,
        *,
        profile: str = "multisine",
        deviation: float = 0.1,
        noise: float = 1.0,
    ) -> None:
        if profile not in PROFILES:
            raise BadSetting(
                f"oscillator: profile {profile!r} is not known; {known_names(profile, PROFILES)}"
            )
        if not (0.0 <= deviation <= 0.5 and 0.0 <= noise <= 100.0):
            raise BadSetting("oscillator: deviation must be 0 … 0.5 and noise 0 … 100")
        super().__init__(seed, effects, faults, exemplar)
        own = np.random.default_rng([seed, exemplar, 5])
        nominal = Oscillator()
        factors = dict(zip("Mdk", 1.0 + own.uniform(-deviation, deviation, 3), strict=True))
        values: dict[str, Any] = {
            name: getattr(nominal, name) * factor for name, factor in factors.items()
        }
        for id, parameters in self.active_effects.items():
            values.update(
                {_FIELDS.get(id, {}).get(name, name): value for name, value in parameters.items()}
            )
        values["d"] += self.active_effects.get("viscous-friction", {}).get("b", 0.0)
        self.circuit = nominal._replace(
            **{name: value for name, value in values.items() if name in Oscillator._fields}
        )
        self._profile, self._noise = profile, noise
        self._lines = np.arange(1, 8192 * 200 // 610, 2)
        self._phases = own.uniform(0, 2 * np.pi, len(self._lines))
        self._y = np.zeros(2)

    def _run(self, n: int) -> dict[str, Array]:
        k = self._samples + np.arange(n)
        draws = self._rng.standard_normal((n, 2))
        force = self._force(k, draws[:, 0])
        applied = force + self.active_effects.get("input-offset", {}).get("offset", 0.0)
        out = np.empty(n)
        _live(out, self._y, self.circuit, applied, self.sample_time)
        offset = self.active_effects.get("output-offset", {}).get("offset", 0.0)
        return {"force": force, "position": out + offset + 3e-4 * self._noise * draws[:, 1]}

    def _force(self, k: npt.NDArray[np.integer], draws: Array) -> Array:
        if self._profile == "noise":
            return 0.05 * draws
        if self._profile == "sweep":
            t = k * self.sample_time % 60.0
            return np.asarray(
                0.15 * t / 60.0 * np.sin(2 * np.pi * (5.0 * t + 0.5 * (200.0 - 5.0) / 60.0 * t**2))
            )
        spectrum = np.zeros(4097, dtype=complex)
        spectrum[self._lines] = np.exp(1j * self._phases)
        period = np.fft.irfft(spectrum, 8192)
        return np.asarray(0.05 * (period / np.std(period))[k % 8192])

    def _constants(self) -> dict[str, float]:
        return {"M": float(self.circuit.M), "d": float(self.circuit.d), "k": float(self.circuit.k)}


@njit()
def _acceleration(q, v, c, F):  # type: ignore[no-untyped-def]
    return (F - c.d * v - c.k * q - c.k2 * q * q - c.k3 * q**3 - c.drag * v * abs(v) - c.load) / c.M


@njit()
def _live(out, y, c, force, Ts):  # type: ignore[no-untyped-def]
    h = Ts / _SUBSTEPS
    q, v = y
    for j in range(len(out)):
        out[j] = q
        F = force[j]
        for _ in range(_SUBSTEPS):
            a1 = _acceleration(q, v, c, F)
            v2 = v + 0.5 * h * a1
            a2 = _acceleration(q + 0.5 * h * v, v2, c, F)
            v3 = v + 0.5 * h * a2
            a3 = _acceleration(q + 0.5 * h * v2, v3, c, F)
            v4 = v + h * a3
            a4 = _acceleration(q + h * v3, v4, c, F)
            q += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    y[0], y[1] = q, v
