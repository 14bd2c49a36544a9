"""pint's registry of units: what `common_units` does not list, and words that nobody knows.

`unit_spellings` puts a text into the registry's spelling first. The registry itself reads nearly
any word as a prefix and a unit (`pH`: picohenry, `pct`: pico-centitonne), so only symbols that are
listed and names that are written out are taken from it. It is asked for single words alone: a whole
text it would compute (`9**9**9`). Nothing that is asked is entered into it.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any

import pint

from residuum.identification.common_units import NamedUnit
from residuum.identification.errors import BadUnit
from residuum.identification.unit_grammar import read_product
from residuum.identification.unit_spellings import KNOWN_SYMBOLS, LOOKALIKES

_REGISTRY: pint.UnitRegistry[float] = pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
_WORD = re.compile(r"[A-Za-z_µΔ][A-Za-z_µΔ0-9]*")
# letters of a name that is written out, at least
_NAME = 4


def factors(text: str) -> tuple[tuple[NamedUnit, float], ...]:
    """The named units with their exponents that a text multiplies; a word that nobody knows becomes
    a unit of its own.

    Raises BadUnit for what is no product of words, or one beyond the bounds of `unit_grammar`.
    """
    return tuple((_named(word), power) for word, power in read_product(text))


@lru_cache(maxsize=4096)
def _named(word: str) -> NamedUnit:
    """The unit that a word names: the registry's where it means what a person does, else one of its
    own dimension.
    """
    if word in KNOWN_SYMBOLS or _is_name(word) or (not _WORD.fullmatch(word) and _is_known(word)):
        return _of_registry(word)
    if not _WORD.fullmatch(word):
        raise BadUnit(f"unit {word!r}: not a known unit")
    own = f"own_{word}" if _is_known(word) else word
    return NamedUnit(own, 1.0, ((own, 1.0),))


def _of_registry(name: str) -> NamedUnit:
    unit = _REGISTRY.Unit(name)
    unity: Any = _REGISTRY.Quantity(
        1.0, _REGISTRY.Unit(f"delta_{name}") if _shifted(name) else unit
    ).to_base_units()
    zero: Any = _REGISTRY.Quantity(0.0, unit).to_base_units().magnitude
    base = tuple((base, float(power)) for base, power in unity.unit_items())
    return NamedUnit(_symbol(unit), float(unity.magnitude), base, float(zero))


def _symbol(unit: Any) -> str:
    """The short symbol of a unit, or its name where the symbol would not be read back as this unit
    (`kn` of the knot).
    """
    short = f"{unit:~C}".replace("Ω", "ohm")
    return short if short in KNOWN_SYMBOLS or not short.isascii() else f"{unit:C}"


def _shifted(name: str) -> bool:
    """Whether zero in this unit is not zero in base units (°C, °F)."""
    return bool(_REGISTRY.Quantity(0.0, name).to_base_units().magnitude)


def _is_known(word: str) -> bool:
    """Whether the registry reads a word in any way."""
    return bool(_REGISTRY.parse_unit_name(word))


def _is_name(word: str) -> bool:
    """Whether a word is the written-out name of one unit, with a written-out prefix at most."""
    if len(word) < _NAME or word in LOOKALIKES:
        return False
    return any(
        len(name) >= _NAME and f"{prefix}{name}" in (word, word.removesuffix("s"))
        for prefix, name, _ in _REGISTRY.parse_unit_name(word)
    )
