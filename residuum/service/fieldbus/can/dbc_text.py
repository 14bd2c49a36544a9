"""The text of a DBC file without what would make cantools refuse the whole of it for one message's sake."""

from __future__ import annotations

import re

_STATEMENT = r'(?:[^;"]|"[^"]*")*;'
_MESSAGE = re.compile(r"^BO_ +(?P<id>\d+) +(?P<name>\w+) *:.*\n?(?P<signals>(?:[ \t]+SG_.*\n?|[ \t]*\n)*)", re.MULTILINE)
_PAGED = re.compile(r"^[ \t]+SG_ +(?P<signal>\w+) +m\d* *:", re.MULTILINE)
_MULTIPLEXER = re.compile(r"^[ \t]+SG_ +\w+ +(?:m\d+)?M *:", re.MULTILINE)
_SIGNAL = re.compile(r"^[ \t]+SG_ +(\w+)", re.MULTILINE)
_CHOICES = re.compile(rf"^VAL_ +(?P<id>\d+) +(?P<signal>\w+) {_STATEMENT}", re.MULTILINE)
_EXTENDED = 1 << 31
_INDEPENDENT = "VECTOR__INDEPENDENT_SIG_MSG"


def usable_text(text: str) -> tuple[str, dict[str, str]]:
    """The text without messages of impossible identifiers, or with pages that no signal names, and without value tables of
    signals that no message has. Also why each message was left out, by its name.

    >>> text, why = usable_text("BO_ 2048 late: 8 A\\n SG_ x : 0|8@1+ (1,0) [0|0] \\"\\" A\\nBO_ 7 kept: 8 A\\n")
    >>> text, why["late"][:45]
    ('BO_ 7 kept: 8 A\\n', 'identifier 2048 is longer than 11 bits and is')
    """
    found = list(_MESSAGE.finditer(text))
    why = {
        message["name"]: said
        for message in found
        if (said := _impossible(int(message["id"]), message["name"]) or _unnamed_page(message["signals"]))
    }
    there = {(m["id"], name) for m in found if m["name"] not in why for name in _SIGNAL.findall(m["signals"])}
    if not why and all((choices["id"], choices["signal"]) in there for choices in _CHOICES.finditer(text)):
        return text, {}
    text = _CHOICES.sub(lambda choices: choices[0] if (choices["id"], choices["signal"]) in there else "", text)
    return _MESSAGE.sub(lambda message: "" if message["name"] in why else message[0], text), why


def _unnamed_page(signals: str) -> str:
    paged = _PAGED.search(signals)
    if paged is None or _MULTIPLEXER.search(signals):
        return ""
    return f"signal {paged['signal']!r} is on a page, and no signal names the page: mark that one with M"


def _impossible(identifier: int, name: str) -> str:
    if name == _INDEPENDENT:
        return ""
    if identifier >= _EXTENDED:
        return f"identifier {identifier} is longer than 29 bits: correct it" if identifier - _EXTENDED > 0x1FFFFFFF else ""
    if identifier <= 0x7FF:
        return ""
    return f"identifier {identifier} is longer than 11 bits and is not marked as extended: add {_EXTENDED} to it"
