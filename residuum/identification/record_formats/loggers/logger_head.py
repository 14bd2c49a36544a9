"""Column heads as loggers write them: the name, and the unit in brackets, in parentheses or after a
slash.
"""

import re
from functools import lru_cache

from residuum.identification.unit_spellings import is_spelled

_BRACKET = re.compile(r"(.*?)[\s_]*\[([^\[\]]*)\]\s*")
_PARENTHESES = re.compile(r"(.*?)[\s_]*\(([^()]*)\)\s*")
_SLASH = re.compile(r"(.*?)\s+(?:/|in)\s+(\S+)\s*")
# symbols that certainly are units: a word in brackets that is none of them may be a remark
_ATOM = re.compile(
    r"1|-|%|°|°[CF]|degC|degF|C|K|[munkMG]?(A|V|W|Hz|N|m|s|Pa|bar|g|rad|VA|Wh|F|H)"
    r"|[µμ](A|V|m|s|F|H)|[kM]?(Ohm|ohm|Ω)|N[mM]|[kM]N|[kmM]?Nm|rpm|deg|min|h|l|L|J|kJ|kg|lb|psi"
    r"|mbar|raw|counts?|ticks|digits?|pu|bool|dB|ppm|mm|cm|km|in|inch|sec|msec|usec"
)
# units that are known as a whole only, for their parts are none
_WHOLE = ("U/min", "1/min", "rev/min", "r/min")
_WORDS = {
    "volt": "V",
    "ampere": "A",
    "amp": "A",
    "second": "s",
    "sec": "s",
    "watt": "W",
    "hertz": "Hz",
    "kelvin": "K",
    "celsius": "°C",
}


def unit_word(text: str) -> str:
    """The symbol of a unit that is written out.

    >>> unit_word("Volts"), unit_word("N")
    ('V', 'N')
    """
    return _WORDS.get(text.lower().removesuffix("s"), text)


# kept: each of a history's windows asks for those of the same columns
@lru_cache(maxsize=4096)
def is_unit(text: str) -> bool:
    """Whether a text is certainly a unit: products and powers of known symbols.

    >>> is_unit("m/s^2"), is_unit("left")
    (True, False)
    """
    parts = [
        re.sub(r"(\^|\*\*)?-?[0-9²³]$", "", part) or part
        for part in re.split(r"(?<!\*)[*](?!\*)|[/·]", text.strip())
    ]
    if text.strip() in _WHOLE or is_spelled(text.strip()):
        return True
    return bool(text.strip()) and all(_ATOM.fullmatch(part) for part in parts)


@lru_cache(maxsize=4096)
def unit_of_head(cell: str) -> tuple[str, str]:
    """Name and unit of a head; what stands in parentheses is one only where it certainly is a unit.

    >>> unit_of_head("speed (rpm)"), unit_of_head("speed (left)")
    (('speed', 'rpm'), ('speed (left)', ''))
    """
    if match := _BRACKET.fullmatch(cell):
        return match[1].strip(), unit_word(match[2].strip())
    for pattern in (_PARENTHESES, _SLASH):
        if (match := pattern.fullmatch(cell)) and is_unit(unit_word(match[2].strip())):
            return match[1].strip(), unit_word(match[2].strip())
    return cell.strip(), ""
