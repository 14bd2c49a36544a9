"""The units that machines are recorded in, as pint knows them: a record or a model in these needs
no registry, which costs .3 s.

`identification/unit_registry.py` answers for all others; a test compares every line with it.
"""

from __future__ import annotations

from dataclasses import dataclass

LARGEST_POWER = 16.0
"""Exponent of a word of a unit, all parentheses around it included; the largest in use is the
fourth power of a temperature.
"""


@dataclass(frozen=True)
class NamedUnit:
    """A unit with a name of its own: its symbol, factor and offset to base units, and the base
    units' exponents.
    """

    symbol: str
    scale: float
    base: tuple[tuple[str, float], ...]
    offset: float = 0.0


def _base(**exponents: float) -> tuple[tuple[str, float], ...]:
    return tuple(exponents.items())


_FORCE = _base(kilogram=1, meter=1, second=-2)
_ENERGY = _base(kilogram=1, meter=2, second=-2)
_POWER = _base(kilogram=1, meter=2, second=-3)
_VOLTAGE = _base(kilogram=1, meter=2, second=-3, ampere=-1)
_RESISTANCE = _base(kilogram=1, meter=2, second=-3, ampere=-2)
_INDUCTANCE = _base(kilogram=1, meter=2, second=-2, ampere=-2)
_PRESSURE = _base(kilogram=1, meter=-1, second=-2)
_ACCELERATION = _base(meter=1, second=-2)
_VOLUME = _base(meter=3)
_FREQUENCY = _base(second=-1)
_TIME, _LENGTH, _MASS, _ANGLE = _base(second=1), _base(meter=1), _base(kilogram=1), _base(radian=1)
_CURRENT, _TEMPERATURE = _base(ampere=1), _base(kelvin=1)

# By the registry's name, where `unit_spellings` gives that and not the symbol. Factors stand to the
# last digit that pint has (2π, π/180), for a test compares them.
_LISTED = (
    *(("percent", NamedUnit("%", 0.01, ())), ("delta_degC", NamedUnit("Δ°C", 1.0, _TEMPERATURE))),
    *(
        ("degC", NamedUnit("°C", 1.0, _TEMPERATURE, 273.15)),
        ("kelvin", NamedUnit("K", 1.0, _TEMPERATURE)),
    ),
    *(
        ("radian", NamedUnit("rad", 1.0, _ANGLE)),
        ("revolution", NamedUnit("turn", 6.283185307179586, _ANGLE)),
    ),
    *(
        ("degree", NamedUnit("deg", 0.017453292519943295, _ANGLE)),
        ("hour", NamedUnit("h", 3600.0, _TIME)),
    ),
    *(("minute", NamedUnit("min", 60.0, _TIME)), ("second", NamedUnit("s", 1.0, _TIME))),
    *(
        ("standard_gravity", NamedUnit("g_0", 9.80665, _ACCELERATION)),
        ("L", NamedUnit("l", 1e-3, _VOLUME)),
    ),
    *(
        ("us", NamedUnit("µs", 1e-6, _TIME)),
        ("um", NamedUnit("µm", 1e-6, _LENGTH)),
        ("uA", NamedUnit("µA", 1e-6, _CURRENT)),
    ),
)
_BY_SYMBOL = (
    *(NamedUnit("rad", 1.0, _ANGLE), NamedUnit("deg", 0.017453292519943295, _ANGLE)),
    *(
        NamedUnit("turn", 6.283185307179586, _ANGLE),
        NamedUnit("K", 1.0, _TEMPERATURE),
        NamedUnit("g_0", 9.80665, _ACCELERATION),
    ),
    *(NamedUnit("s", 1.0, _TIME), NamedUnit("ms", 1e-3, _TIME), NamedUnit("µs", 1e-6, _TIME)),
    *(NamedUnit("min", 60.0, _TIME), NamedUnit("h", 3600.0, _TIME)),
    *(NamedUnit("Hz", 1.0, _FREQUENCY), NamedUnit("kHz", 1e3, _FREQUENCY)),
    *(NamedUnit("m", 1.0, _LENGTH), NamedUnit("mm", 1e-3, _LENGTH), NamedUnit("cm", 1e-2, _LENGTH)),
    *(NamedUnit("km", 1e3, _LENGTH), NamedUnit("µm", 1e-6, _LENGTH)),
    *(NamedUnit("kg", 1.0, _MASS), NamedUnit("t", 1e3, _MASS)),
    *(NamedUnit("N", 1.0, _FORCE), NamedUnit("mN", 1e-3, _FORCE), NamedUnit("kN", 1e3, _FORCE)),
    *(
        NamedUnit("J", 1.0, _ENERGY),
        NamedUnit("kJ", 1e3, _ENERGY),
        NamedUnit("MJ", 1e6, _ENERGY),
        NamedUnit("kWh", 3.6e6, _ENERGY),
    ),
    *(NamedUnit("W", 1.0, _POWER), NamedUnit("mW", 1e-3, _POWER), NamedUnit("kW", 1e3, _POWER)),
    *(
        NamedUnit("V", 1.0, _VOLTAGE),
        NamedUnit("mV", 1e-3, _VOLTAGE),
        NamedUnit("kV", 1e3, _VOLTAGE),
    ),
    *(
        NamedUnit("A", 1.0, _CURRENT),
        NamedUnit("mA", 1e-3, _CURRENT),
        NamedUnit("µA", 1e-6, _CURRENT),
    ),
    *(NamedUnit("ohm", 1.0, _RESISTANCE), NamedUnit("mohm", 1e-3, _RESISTANCE)),
    *(NamedUnit("H", 1.0, _INDUCTANCE), NamedUnit("mH", 1e-3, _INDUCTANCE)),
    *(
        NamedUnit("Pa", 1.0, _PRESSURE),
        NamedUnit("kPa", 1e3, _PRESSURE),
        NamedUnit("MPa", 1e6, _PRESSURE),
    ),
    *(
        NamedUnit("bar", 1e5, _PRESSURE),
        NamedUnit("mbar", 1e2, _PRESSURE),
        NamedUnit("l", 1e-3, _VOLUME),
    ),
)
COMMON_UNITS: dict[str, NamedUnit] = {**dict(_LISTED), **{unit.symbol: unit for unit in _BY_SYMBOL}}
"""Name or symbol → unit."""
