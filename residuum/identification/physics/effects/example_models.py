"""Small models, one a balance kind, that the effects' examples stand on."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Example:
    """A model file's text with the effect in it, for the conformance test: the input moves as
    `profile` says.

    `profile` is `sweep` (both directions, standstill between) or `steps` (between zero and
    `amplitude`).
    """

    model: str
    amplitude: float
    profile: str = "sweep"
    sample_time: float = 0.01
    duration: float = 10.0


_AXIS = """
name: example axis
inputs: {force: N}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters: {M: {value: 2.0, unit: kg, lower: 0.1, upper: 100}}
balances:
  axis: {kind: force, storage: M * der(v), terms: {drive: force}, position: q, velocity: v}
outputs: {position: {value: q, unit: m}, velocity: {value: v, unit: m/s}}
"""

_DRIVE = """
name: example drive
inputs: {voltage: V}
states: {theta: {unit: rad, rate: omega}, omega: {unit: rad/s}}
parameters:
  K: {value: 0.07, unit: V*s/rad, lower: 0}
  R: {value: 0.75, unit: ohm, lower: 0}
  J: {value: 2.5e-3, unit: kg*m**2, lower: 0}
balances:
  shaft:
    {kind: torque, storage: J * der(omega), terms: {motor: K * i}, position: theta, velocity: omega}
  winding:
    kind: voltage
    storage: 0
    terms: {supply: voltage, resistance: -R * i, back_emf: -K * omega}
    current: i
outputs: {speed: {value: omega, unit: rad/s}, current: {value: i, unit: A}}
"""

_OVEN = """
name: example oven
inputs: {power: W}
states: {T: {unit: °C}}
parameters:
  C: {value: 2000, unit: J/K, lower: 1}
  h: {value: 5, unit: W/K, lower: 0}
  T_a: {value: 20, unit: °C, fixed: true}
balances:
  chamber:
    kind: heat
    storage: C * der(T)
    terms: {heater: power, loss: -h * (T - T_a)}
    temperature: T
    ambient: T_a
outputs: {temperature: {value: T, unit: °C}}
initial: {T: 20}
"""

_TANK = """
name: example tank
inputs: {pump: V}
states: {level: {unit: m}}
parameters:
  A: {value: 0.02, unit: m**2, lower: 1e-4}
  k: {value: 1e-4, unit: m**3/s/V, lower: 0}
balances: {tank: {kind: volume, storage: A * der(level), terms: {inflow: k * pump}, level: level}}
outputs: {level: {value: level, unit: m}}
initial: {level: 0.1}
"""


def axis_example() -> Example:
    """A mass driven to and fro."""
    return Example(_AXIS, amplitude=10.0)


def drive_example() -> Example:
    """A DC drive driven to and fro."""
    return Example(_DRIVE, amplitude=12.0, sample_time=0.005)


def oven_example() -> Example:
    """A heated chamber, heating switched on and off."""
    return Example(_OVEN, amplitude=1000.0, profile="steps", sample_time=10.0, duration=6000.0)


def tank_example() -> Example:
    """A tank, pump switched on and off."""
    return Example(_TANK, amplitude=5.0, profile="steps", sample_time=1.0, duration=600.0)
