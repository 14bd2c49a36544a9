"""pint's registry of units: what `common_units` does not list, and words that nobody knows.

Three changes suit recorded signals, made in `identification/units.py`: `g` is standard gravity (nobody records grams), `%` is a
hundredth, `count` is a plain number.
"""

from __future__ import annotations

import re
import threading
from typing import Any

import pint

from residuum.identification.common_units import NamedUnit
from residuum.identification.errors import BadUnit

_REGISTRY: pint.UnitRegistry[float] = pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
_OWN = re.compile(r"[A-Za-z_][A-Za-z_]*")
"""A unit that nobody knows: letters alone."""
_MOST_OWN = 1000
_own: set[str] = set()
_lock = threading.Lock()


def factors(text: str) -> tuple[tuple[NamedUnit, float], ...]:
    """The named units with their exponents that a text multiplies; a word that nobody knows becomes a unit of its own.

    Raises whatever pint raises for what is no unit.
    """
    for word in _OWN.findall(text):
        _define_unknown(word)
    return tuple((_named(name), float(power)) for name, power in (1 * _REGISTRY.Unit(text)).unit_items())


def is_own(word: str) -> bool:
    """Whether a word was entered because nobody knew it."""
    return word in _own


def _named(name: str) -> NamedUnit:
    unit = _REGISTRY.Unit(name)
    one: Any = _REGISTRY.Quantity(1.0, _REGISTRY.Unit(f"delta_{name}") if _shifted(name) else unit).to_base_units()
    zero: Any = _REGISTRY.Quantity(0.0, unit).to_base_units().magnitude
    base = tuple((base, float(power)) for base, power in one.unit_items())
    return NamedUnit(f"{unit:~C}".replace("Ω", "ohm"), float(one.magnitude), base, float(zero))


def _shifted(name: str) -> bool:
    """Whether zero in this unit is not zero in base units (°C, °F)."""
    return bool(_REGISTRY.Quantity(0.0, name).to_base_units().magnitude)


def _define_unknown(word: str) -> None:
    """Enter a word into the registry as a unit of its own dimension, where it is none yet."""
    with _lock:
        if word in _REGISTRY:
            return
        if len(_own) >= _MOST_OWN:
            raise BadUnit(f"unit {word!r}: nobody knows it, and {_MOST_OWN} units of their own are in use already")
        _REGISTRY.define(f"{word} = [{word}]")
        _own.add(word)
