"""Physical units of channels and parameters: parsing, checking, converting.

Units are written as engineers write them in column heads (`rad/s`, `N*m`, `°C`, `%`, `rpm`, `g`).
The registry is pint's, with three changes that suit recorded signals: `g` is standard gravity
(nobody records grams), `%` is a dimensionless hundredth, and `count` is dimensionless.
"""

import re
import threading
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pint

from residuum.identification.errors import BadUnit

_REGISTRY: pint.UnitRegistry[float] = pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
_SPELLINGS = {
    "": "dimensionless",
    "1": "dimensionless",
    "-": "dimensionless",
    "%": "percent",
    "g": "standard_gravity",
    "°C": "degC",
    "degC": "degC",
    "C": "degC",
    "°F": "degF",
    "°": "degree",
    "Ω": "ohm",
    "rpm": "revolution/minute",
    "1/min": "revolution/minute",
    "raw": "dimensionless",
    "bool": "dimensionless",
    "count": "dimensionless",
}
_LONGEST = 80
_OWN = re.compile(r"[A-Za-z_][A-Za-z_]*")
"""A unit that nobody knows: letters alone."""
_MISREAD = re.compile(r"\b(pu|digits?)\b")
"""Units of their own that the registry would read as a prefix and a unit (`pu`: pico-dalton)."""
_MOST_OWN = 1000
_own: set[str] = set()
_lock = threading.Lock()


@lru_cache(maxsize=1024)
def parse_unit(text: str) -> pint.Unit:
    """Return the unit that `text` names; a word that nobody knows (`ticks`) is a unit of its own dimension.

    Raises BadUnit when the text is no unit, or one whose size in base units is no number; the message repeats the text.

    >>> compatible("ticks/s", "ticks/min"), compatible("ticks", "rad")
    (True, False)

    >>> str(parse_unit("N·m/A").dimensionality) == str(parse_unit("V*s/rad").dimensionality)
    True
    """
    spelled = text.strip()
    if len(spelled) > _LONGEST:
        raise BadUnit(f"unit {spelled[:20]!r}…: longer than {_LONGEST} characters")
    spelled = _SPELLINGS.get(spelled, spelled).replace("·", "*").replace("Ω", "ohm").replace("°C", "delta_degC")
    spelled = _MISREAD.sub(r"own_\1", spelled).replace("²", "**2").replace("³", "**3").replace("^", "**")
    for word in _OWN.findall(spelled):
        _define_unknown(word)
    try:
        unit = _REGISTRY.Unit(spelled)
        factor: Any = _REGISTRY.get_base_units(unit)[0]
        if not 0 < factor < np.inf:
            raise OverflowError(spelled)
        return unit
    except Exception as error:  # pint raises many unrelated types (tokenizer, attribute, definition errors)
        raise BadUnit(f"unit {text!r}: not a known unit") from error


def _define_unknown(word: str) -> None:
    """Enter a word into the registry as a unit of its own dimension, where it is none yet."""
    with _lock:
        if word in _REGISTRY:
            return
        if len(_own) >= _MOST_OWN:
            raise BadUnit(f"unit {word!r}: nobody knows it, and {_MOST_OWN} units of their own are in use already")
        _REGISTRY.define(f"{word} = [{word}]")
        _own.add(word)


def compatible(first: str, second: str) -> bool:
    """Whether values in unit `first` can be converted to unit `second`."""
    return bool(parse_unit(first).dimensionality == parse_unit(second).dimensionality)


def convert(values: npt.ArrayLike, source: str, target: str, *, what: str = "value") -> npt.NDArray[np.float64]:
    """Convert absolute values from unit `source` to unit `target` (°C to K shifts, rpm to rad/s scales).

    Raises BadUnit when the two are incompatible; `what` names the quantity in the message.

    >>> float(convert(60.0, "rpm", "rad/s"))  # doctest: +ELLIPSIS
    6.283...
    >>> float(convert(20.0, "°C", "K"))
    293.15
    """
    array = np.asarray(values, dtype=float)
    if source == target:
        return array
    if not compatible(source, target):
        raise BadUnit(f"{what}: unit {_shown(source)} cannot be converted to {_shown(target)}")
    return np.asarray(_REGISTRY.Quantity(array, parse_unit(source)).to(parse_unit(target)).magnitude, dtype=float)


def _shown(unit: str) -> str:
    return repr(unit) if unit else "none"
