"""The text of a DBC file without what would make cantools refuse the whole of it for one message's
or one line's sake.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from cantools.database import load_string
from cantools.database.can.database import Database
from cantools.database.errors import Error as DatabaseError

# Raw numbers of a CAN signal that say that there is no value: not available, error, reserved.
# SAE J1939-71 (extended frames) keeps the top of every number's range for them: from 0xFB,
# 0xFB00, 0xFB000000 on, binary 10 and 11 of two bits, 0xE and 0xF of four. Other buses send all
# ones, or the ends of a signed number. Whatever the scaling, such a number is one only if its
# value lies outside of the range that the DBC file declares; where the file calls a message
# J1939's and declares no range it always is. There an error (0xFE…) and what is not available
# (0xFF…) are none of a number of 8 bits and more also where the range holds all that the bits do.
# A value table may name one.

_NAMED = re.compile(
    r"(?i)\b(sna|n/a|not avail\w*|unavailable|no value|signal invalid|invalid signal)\b"
)
# First bits of what J1939 reserves, of an error, and of what is not available.
_TOPS = (0xFB, 0xFE, 0xFF)
# What J1939 reserves of fewer bits.
_FEW_BITS = {2: 0b10, 4: 0xE}
J1939 = "j1939"


class NoValueCodes:
    """Which raw numbers of a message's signals mean no value.

    Parameters
    ----------
    message : cantools message
    """

    def __init__(self, message: Any) -> None:
        j1939, extended = message.protocol == J1939, bool(message.is_extended_frame)
        pages = {signal.multiplexer_signal for signal in message.signals}
        self._spans = [
            (k, np.uint64(first), np.uint64(last))
            for k, signal in enumerate(message.signals)
            if signal.name not in pages and not signal.conversion.is_float
            for first, last in [*_reserved(signal, j1939, extended), *_named(signal)]
        ]

    def __bool__(self) -> bool:
        return bool(self._spans)

    def marked(self, raw: npt.NDArray[np.uint64]) -> npt.NDArray[np.bool_]:
        """Where a raw number, shape (n, signals), is one of them."""
        is_code = np.zeros(raw.shape, bool)
        for k, first, last in self._spans:
            is_code[:, k] |= (raw[:, k] >= first) & (raw[:, k] <= last)
        return is_code


def _named(signal: Any) -> list[tuple[int, int]]:
    mask = (1 << signal.length) - 1
    return [
        (int(raw) & mask, int(raw) & mask)
        for raw, text in (signal.choices or {}).items()
        if _NAMED.search(str(text).replace("_", " "))
    ]


def _reserved(signal: Any, j1939: bool, extended: bool) -> Sequence[tuple[int, int]]:
    """(first, last) raw numbers, as bits, at the ends of a signal's range."""
    bits = signal.length
    all_ones, sign = (1 << bits) - 1, 1 << (bits - 1)
    # of a signed number both ends; below 8 bits an end is a value like any other
    if signal.is_signed:
        ends = [(sign, -sign), (sign - 1, sign - 1)] if bits >= 8 else []
        return [(raw, raw) for raw, number in ends if _declared(signal, number) is False]
    if bits < 8 or not extended:
        # other buses send all ones; J1939's two and four bits are values where the file says so
        first = _FEW_BITS.get(bits) if extended else (all_ones if bits >= 8 else None)
        return [(first, all_ones)] if first is not None and _is_code(signal, first, j1939) else []
    starts = [top << (bits - 8) for top in _TOPS]
    beyond = [start for start in starts if _declared(signal, start) is False]
    if beyond:
        return [(beyond[0], all_ones)]
    if not j1939:
        return []
    # a range of all that the bits hold is written by tools, and makes no number of an error code
    return [(starts[_declared(signal, all_ones) is True], all_ones)]


def _is_code(signal: Any, number: int, j1939: bool) -> bool:
    within = _declared(signal, number)
    return within is False or (j1939 and within is None)


def _declared(signal: Any, number: int) -> bool | None:
    """Whether a raw number's value lies within the range that the file declares; None where it
    declares none.
    """
    low, high = signal.minimum, signal.maximum
    if low is None or high is None or not low < high:
        return None
    value = number * signal.conversion.scale + signal.conversion.offset
    # files print the ends of a range with few digits: half a step of the raw number is not outside
    slack = 0.5 * abs(signal.conversion.scale)
    return bool(low - slack <= value <= high + slack)


_STATEMENT = r'(?:[^;"]|"[^"]*")*;'
_MESSAGE = re.compile(
    r"^BO_ +(?P<id>\d+) +(?P<name>\w+) *:.*\n?(?P<signals>(?:[ \t]+SG_.*\n?|[ \t]*\n)*)",
    re.MULTILINE,
)
_PAGED = re.compile(r"^[ \t]+SG_ +(?P<signal>\w+) +m\d* *:", re.MULTILINE)
_MULTIPLEXER = re.compile(r"^[ \t]+SG_ +\w+ +(?:m\d+)?M *:", re.MULTILINE)
_SIGNAL = re.compile(r"^[ \t]+SG_ +(\w+)", re.MULTILINE)
_CHOICES = re.compile(rf"^VAL_ +(?P<id>\d+) +(?P<signal>\w+) {_STATEMENT}", re.MULTILINE)
_EXTENDED = 1 << 31
# the message under which Vector's editor keeps signals of no message; its identifier is none
_INDEPENDENT = "VECTOR__INDEPENDENT_SIG_MSG"


def usable_text(text: str) -> tuple[str, dict[str, str]]:
    """The text without messages of impossible identifiers, or with pages that no signal names, and
    without value tables of signals that no message has. Also why each message was left out, by its
    name.

    >>> late = 'BO_ 2048 late: 8 A\\n SG_ x : 0|8@1+ (1,0) [0|0] "" A\\n'
    >>> text, why = usable_text(late + "BO_ 7 kept: 8 A\\n")
    >>> text, why["late"][:45]
    ('\\n\\nBO_ 7 kept: 8 A\\n', 'identifier 2048 is longer than 11 bits and is')
    """
    messages = list(_MESSAGE.finditer(text))
    why = {
        message["name"]: reason
        for message in messages
        if (
            reason := _impossible(int(message["id"]), message["name"])
            or _unnamed_page(message["signals"])
        )
    }
    signals = {
        (m["id"], name)
        for m in messages
        if m["name"] not in why
        for name in _SIGNAL.findall(m["signals"])
    }
    if not why and all(
        (choices["id"], choices["signal"]) in signals for choices in _CHOICES.finditer(text)
    ):
        return text, {}
    text = _CHOICES.sub(
        lambda choices: (
            choices[0] if (choices["id"], choices["signal"]) in signals else _lines_of(choices[0])
        ),
        text,
    )
    return (
        _MESSAGE.sub(
            lambda message: _lines_of(message[0]) if message["name"] in why else message[0], text
        ),
        why,
    )


def _unnamed_page(signals: str) -> str:
    paged = _PAGED.search(signals)
    if paged is None or _MULTIPLEXER.search(signals):
        return ""
    return (
        f"signal {paged['signal']!r} is on a page, and no signal names the page: mark that one"
        " with M"
    )


def _impossible(identifier: int, name: str) -> str:
    if name == _INDEPENDENT:
        return ""
    if identifier >= _EXTENDED:
        return (
            f"identifier {identifier} is longer than 29 bits: correct it"
            if identifier - _EXTENDED > 0x1FFFFFFF
            else ""
        )
    if identifier <= 0x7FF:
        return ""
    return (
        f"identifier {identifier} is longer than 11 bits and is not marked as extended: add"
        f" {_EXTENDED} to it"
    )


# Lines that cannot be read.

# Lines and messages; a file with more is none. It bounds the time, too: each costs a whole reading
# of the file.
_MOST_LEFT_OUT = 40
_AT = re.compile(r"nvalid syntax at line (\d+), column (\d+)")
_NO_ATTRIBUTE = re.compile(r"\"'(\w+)'\"")
_FLOAT_OF_NONE = re.compile(r"(SIG_VALTYPE_ \d+ \w+)")
_BEGIN = re.compile(r"^(?:[ \t]+SG_\b|VERSION\b|[A-Z]+_(?:[A-Z]+_)*(?=[\s:])).*", re.MULTILINE)
_SIGNALS = re.compile(r"(?:[ \t]+SG_ .*(?:\n|$)|[ \t]*\n)+")
# What ends in a semicolon.
_ENDS = ("CM_", "BA_", "VAL_", "SIG_", "SG_MUL", "EV_", "BO_TX")
# Statements that say how a message is read, with its identifier.
_CHANGES_VALUES = re.compile(
    r"(?:SIG_VALTYPE_|SG_MUL_VAL_)\s+(\d+)"
    r'|BA_\s+"(?:SampleTime|SourceAddress|GenMsgCycleTime|SamplesPerFrame|VFrameFormat)"\s+BO_\s+(\d+)'
)


def read_text(text: str) -> tuple[Database, dict[str, str]]:
    """The database in the text of a DBC file, and why each message (by its name) or line (`line 7`)
    was left out.

    Raises what cantools raises, where a line that cannot be read is not the whole fault.
    """
    why: dict[str, str] = {}
    first: DatabaseError | None = None
    # cantools names one place a time: each turn takes what is wrong there out of the text
    while True:
        usable, messages = usable_text(text)
        left_out = why | messages
        try:
            database = _load(usable)
        except DatabaseError as error:
            # the first complaint is about the file as it is; later ones may come of what was left
            # out
            first = first or error
            unread = _unread(usable, str(error)) if len(left_out) < _MOST_LEFT_OUT else []
            if not unread:
                raise first from None
            text, reasons = _without(usable, unread)
            why |= reasons | messages
        else:
            # what is left is no DBC file
            if first is not None and not (database.messages or messages):
                raise first
            return database, left_out


def _load(text: str) -> Database:
    # cantools refuses a text that is empty, which a file of nothing but unusable messages leaves
    content = text if text.strip() else 'VERSION ""'
    return cast(Database, load_string(content, database_format="dbc", strict=False))


def _without(text: str, statements: list[tuple[int, int]]) -> tuple[str, dict[str, str]]:
    """A text without these statements, and why each is left out."""
    spans = [(start, _with_signals(text, start, end)) for start, end in statements]
    why: dict[str, str] = {}
    for start, end in spans:
        why |= _reasons(text, start, end)
    # from the last on: what is cut out moves the places behind it
    for start, end in reversed(spans):
        text = text[:start] + _lines_of(text[start:end]) + text[end:]
    return text, why


def _lines_of(text: str) -> str:
    """Nothing, over as many lines: those that follow keep their numbers."""
    return "\n" * text.count("\n")


def _unread(text: str, complaint: str) -> list[tuple[int, int]]:
    """Where the statements begin and end for which a text is refused."""
    begins = [match.start() for match in _BEGIN.finditer(text)]
    statements = list(pairwise([*begins, len(text)]))
    if at := _AT.search(complaint):
        return _about(text, statements, int(at[1]), int(at[2]))
    # cantools names no line for these two, but what it missed: a definition of the attribute, or
    # the signal of which a number is said to be floating-point
    if attribute := _NO_ATTRIBUTE.search(complaint):
        named = f'"{attribute[1]}"'
        uses = [(a, b) for a, b in statements if text.startswith("BA_", a) and named in text[a:b]]
        return uses[:1]
    if number := _FLOAT_OF_NONE.search(complaint):
        return [(a, b) for a, b in statements if " ".join(text[a:b].split()).startswith(number[1])]
    return []


def _about(
    text: str, statements: list[tuple[int, int]], line: int, column: int
) -> list[tuple[int, int]]:
    """The statement at fault for what cannot be read there: one that does not close its quotes, or
    does not end, before it.
    """
    place = sum(map(len, text.splitlines(keepends=True)[: line - 1]))
    before = [part for part in statements if part[0] <= place]
    # an open quote makes everything behind it a text, up to where the next one closes it
    for part in before:
        if _leaves_a_quote_open(text[slice(*part)]):
            return [part]
    # without its semicolon a statement runs on into the next one, whose begin is then refused
    if column == 1 and len(before) > 1 and _does_not_end(text[slice(*before[-2])]):
        return before[-2:-1]
    begins_a_statement = place in dict(statements)
    if column != 1 or begins_a_statement:
        return before[-1:]
    # a line that begins no statement we know: all up to the next one that does
    end = next((a for a, _ in statements if a > place), len(text))
    return [(place, end)]


def _leaves_a_quote_open(statement: str) -> bool:
    return statement.replace('\\"', "").count('"') % 2 == 1


def _with_signals(text: str, start: int, end: int) -> int:
    """Where a statement ends with the signals below it: left alone they would be those of the
    message above.
    """
    below = _SIGNALS.match(text, end) if not text[start:end].lstrip().startswith("SG_") else None
    return below.end() if below else end


def _does_not_end(statement: str) -> bool:
    return statement.startswith(_ENDS) and not statement.rstrip().endswith(";")


def _reasons(text: str, start: int, end: int) -> dict[str, str]:
    """What is left out with a statement, and why: a message that it says how to read, too."""
    statement = text[start:end].strip().partition("\n SG_")[0]
    line = text.count("\n", 0, start) + 1
    reason = f"{' '.join(statement.split())[:60]!r} cannot be read: correct the line"
    signals = (
        "the signals below it"
        if not statement.startswith("SG_") and re.search(r"^[ \t]+SG_", text[start:end], re.M)
        else ""
    )
    left_out = {f"line {line}": f"{reason}; it is left out{f', and {signals}' if signals else ''}"}
    # a message that is read without what the line says of it would have wrong values: it goes, too
    if match := _CHANGES_VALUES.match(statement):
        identifier = match[1] or match[2]
        of = re.search(rf"^BO_ +{identifier} +(\w+)", text, re.MULTILINE)
        if of:
            left_out[of[1]] = f"line {line} says how it is read, and cannot be read itself"
    return left_out
