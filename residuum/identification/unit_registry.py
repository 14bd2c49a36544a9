"""pint's registry of units: what `common_units` does not list, and words that nobody knows.

`unit_spellings` puts a text into the registry's spelling first. The registry itself reads nearly any word as a prefix and a unit
(`pH`: picohenry, `pct`: pico-centitonne), so only symbols that are listed and names that are written out are taken from it.
"""

from __future__ import annotations

import re
import threading
from typing import Any

import pint

from residuum.identification.common_units import NamedUnit
from residuum.identification.errors import BadUnit
from residuum.identification.unit_spellings import KNOWN_SYMBOLS, LOOKALIKES

_REGISTRY: pint.UnitRegistry[float] = pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
_WORD = re.compile(r"(?<![A-Za-z0-9_µΔ])[A-Za-z_µΔ][A-Za-z_µΔ0-9]*")
_NAME = 4
"""Letters of a name that is written out, at least."""
_MOST_OWN = 1000
_own: set[str] = set()
_lock = threading.Lock()


def factors(text: str) -> tuple[tuple[NamedUnit, float], ...]:
    """The named units with their exponents that a text multiplies; a word that nobody knows becomes a unit of its own.

    Raises whatever pint raises for what is no unit.
    """
    text = _WORD.sub(lambda found: _trusted(found[0]), text)
    return tuple((_named(name), float(power)) for name, power in (1 * _REGISTRY.Unit(text)).unit_items())


def is_own(word: str) -> bool:
    """Whether a word was entered because nobody knew it."""
    return word in _own


def _named(name: str) -> NamedUnit:
    unit = _REGISTRY.Unit(name)
    one: Any = _REGISTRY.Quantity(1.0, _REGISTRY.Unit(f"delta_{name}") if _shifted(name) else unit).to_base_units()
    zero: Any = _REGISTRY.Quantity(0.0, unit).to_base_units().magnitude
    base = tuple((base, float(power)) for base, power in one.unit_items())
    return NamedUnit(_symbol(unit), float(one.magnitude), base, float(zero))


def _symbol(unit: Any) -> str:
    """The short symbol of a unit, or its name where the symbol would not be read back as this unit (`kn` of the knot)."""
    short = f"{unit:~C}".replace("Ω", "ohm")
    return short if short in KNOWN_SYMBOLS or short in _own or not short.isascii() else f"{unit:C}"


def _shifted(name: str) -> bool:
    """Whether zero in this unit is not zero in base units (°C, °F)."""
    return bool(_REGISTRY.Quantity(0.0, name).to_base_units().magnitude)


def _trusted(word: str) -> str:
    """The word where the registry means by it what a person does, else a unit of its own that the registry does not know."""
    if word in _own or word in KNOWN_SYMBOLS or _is_name(word):
        return word
    own = word if word not in _REGISTRY else f"own_{word}"
    _define(own)
    return own


def _is_name(word: str) -> bool:
    """Whether a word is the written-out name of one unit, with a written-out prefix at most."""
    if len(word) < _NAME or word in LOOKALIKES or word not in _REGISTRY:
        return False
    return any(
        len(name) >= _NAME and f"{prefix}{name}" in (word, word.removesuffix("s"))
        for prefix, name, _ in _REGISTRY.parse_unit_name(word)
    )


def _define(word: str) -> None:
    """Enter a word into the registry as a unit of its own dimension, where it is none yet."""
    with _lock:
        if word in _own:
            return
        if len(_own) >= _MOST_OWN:
            raise BadUnit(f"unit {word!r}: nobody knows it, and {_MOST_OWN} units of their own are in use already")
        _REGISTRY.define(f"{word} = [{word}]")
        _own.add(word)
