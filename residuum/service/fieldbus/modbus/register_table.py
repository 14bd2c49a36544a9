"""A register map from a table, as device manuals and spreadsheets have it: a row a signal, with
register, type and unit.

    name;register;type;unit;scale
    speed;40001;uint16;rpm;0.1
    temperature;40002;int16;°C;0.1

Columns may be called as in the row of headings below; `,`, `;` and tab part them. Numbers of the
kind 40001 … are holding registers, those of the kind 30001 … input registers, counted from 1 as
many manuals do; others count from 0. A column `function` says the table of each row.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable
from typing import Any

import yaml
from pydantic import ValidationError

from residuum.nearest_names import known_names
from residuum.service.fieldbus.can.frame_layout import BadBusDescription
from residuum.service.fieldbus.modbus.channel_registers import MANUAL_NUMBERS
from residuum.service.fieldbus.modbus.register_map import RegisterMap, first_error

HEADINGS: dict[str, tuple[str, ...]] = {
    "name": ("name", "signal", "tag", "channel", "variable"),
    "register": ("register", "address", "reg", "offset address", "modbus address"),
    "type": ("type", "data type", "datatype", "format"),
    "unit": ("unit", "units", "engineering unit"),
    "scale": ("scale", "factor", "gain", "multiplier", "resolution"),
    "offset": ("offset", "zero"),
    "bit": ("bit",),
    "bits": ("bits", "number of bits"),
    "registers": ("registers", "length", "size", "count", "words", "number of registers"),
    "word_order": ("word order", "words order"),
    "byte_order": ("byte order",),
    "missing": ("missing", "not available", "invalid", "no value", "n a"),
    "function": ("function", "table"),
}
"""Column → what it may be called."""
TYPES: dict[str, tuple[str, ...]] = {
    "uint16": ("uint16", "u16", "word", "uint", "unsigned", "unsigned16"),
    "int16": ("int16", "s16", "i16", "int", "short", "signed", "signed16"),
    "uint32": ("uint32", "u32", "dword", "udint", "unsigned32"),
    "int32": ("int32", "s32", "i32", "dint", "long", "signed32"),
    "uint64": ("uint64", "u64", "qword", "ulint", "unsigned64"),
    "int64": ("int64", "s64", "i64", "lint", "signed64"),
    "float32": ("float32", "f32", "float", "real", "single"),
    "float64": ("float64", "f64", "double", "lreal"),
    "bit": ("bit", "bool", "boolean"),
}
"""Type → what it may be called."""
# Rows: each makes a channel.
_LONGEST = 1000


def register_map_of(
    text: str, sample_time: float, where: str = "table", unit_id: int = 1
) -> dict[str, Any]:
    """The register map that a table describes, as the values of its YAML file.

    Parameters
    ----------
    text : str
        The table.
    sample_time : float
        Seconds between two reads.
    where : str
        Name of the table for messages.
    unit_id : int
        Of the device.

    Raises
    ------
    BadBusDescription
        A column, number or type that cannot be understood, with its row; registers that two rows
        name.
    """
    rows = _rows(text, where)
    # how the table numbers its registers shows in all of them together, not in one
    registers = [_whole(row, "register", f"{where}, row {number}") for number, row in rows]
    function, shift = _numbering(registers)
    lowest = min(registers)
    channels: dict[str, Any] = {}
    for (number, row), register in zip(rows, registers, strict=True):
        name = row["name"]
        if not name or name in channels:
            raise BadBusDescription(
                f"{where}, row {number}: the name {name!r} is empty or stands in two rows"
            )
        channels[name] = {"register": register - lowest, **_channel(row, f"{where}, row {number}")}
    stream = {
        "sample_time": sample_time,
        "poll": {"address": lowest - shift, **function},
        "channels": channels,
    }
    register_map = {"unit_id": unit_id, "streams": {"signals": stream}}
    try:
        RegisterMap.model_validate(register_map)
    except ValidationError as error:
        raise BadBusDescription(f"{where}: {first_error(error)}") from None
    return register_map


def register_map_text(register_map: dict[str, Any]) -> str:
    """The YAML file of a register map."""
    return yaml.safe_dump(register_map, sort_keys=False, allow_unicode=True)


def _rows(text: str, where: str) -> list[tuple[int, dict[str, str]]]:
    """Number and cells (by column) of every row below the headings."""
    lines = [
        line
        for line in text.lstrip("\ufeff").splitlines()
        if line.strip() and not line.startswith("#")
    ]
    if len(lines) < 2 or len(lines) > _LONGEST:
        raise BadBusDescription(
            f"{where}: needs a row of headings and up to {_LONGEST} rows; it has {len(lines)} lines"
        )
    # what parts the headings most often; of two as often `;`, since a `,` may stand in numbers
    delimiter = max(";\t,", key=lines[0].count)
    table = list(csv.reader(io.StringIO("\n".join(lines)), delimiter=delimiter))
    heads = _heads(table[0], where)
    return [
        (number, _cells(heads, row, f"{where}, row {number}"))
        for number, row in enumerate(table[1:], start=2)
    ]


def _heads(row: list[str], where: str) -> list[str | None]:
    """The column of each cell of the headings; None of one that we have no use for."""
    heads = [_heading(cell) for cell in row]
    for needed in ("name", "register"):
        if needed not in heads:
            raise BadBusDescription(
                f"{where}: has no column {needed!r}; {known_names(needed, row, 'the columns are')}"
            )
    return heads


def _cells(heads: list[str | None], row: list[str], where: str) -> dict[str, str]:
    """A row's cells by column; empty where it has none: spreadsheets leave out those at the end."""
    if len(row) > len(heads):
        raise BadBusDescription(f"{where}: has {len(row)} cells, the headings are {len(heads)}")
    cells = {head: cell.strip() for head, cell in zip(heads, row, strict=False) if head}
    return dict.fromkeys(HEADINGS, "") | cells


def _heading(cell: str) -> str | None:
    plain = re.sub(r"[_\s]+", " ", cell.strip().lower())
    return next((column for column, names in HEADINGS.items() if plain in names), None)


def _channel(row: dict[str, str], where: str) -> dict[str, Any]:
    """A channel of the map, with what the row says of it; what it leaves out has the map's default."""
    kind = _type(row["type"], where)
    channel: dict[str, Any] = {"type": kind, "unit": row["unit"]}
    if kind == "bit":
        channel["bit"] = _whole(row, "bit", where) if row["bit"] else 0
    for column, value_of in _VALUES.items():
        if row[column]:
            channel[column] = value_of(row, column, where)
    return channel


def _type(text: str, where: str) -> str:
    kind = re.sub(r"[_\s-]+", "", text.lower()) or "uint16"
    known = next((name for name, aliases in TYPES.items() if kind in aliases), None)
    if known is None:
        raise BadBusDescription(f"{where}: type {text!r} is not known; {known_names(text, TYPES)}")
    return known


def _numbering(registers: list[int]) -> tuple[dict[str, str], int]:
    """The table that a manual's numbers name, where they name one, and what it calls its first
    register.
    """
    for function, spans in MANUAL_NUMBERS.items():
        for first, last in spans:
            if all(first <= register <= last for register in registers):
                return ({} if function == "holding" else {"function": function}), first
    return {}, 0


def _word(row: dict[str, str], column: str, _where: str) -> str:
    return row[column].lower()


def _sentinels(row: dict[str, str], column: str, where: str) -> list[float]:
    """Numbers that mean that there is no value, parted by blanks; in hexadecimal, too."""
    return [_sentinel(text, column, where) for text in row[column].split()]


def _sentinel(text: str, column: str, where: str) -> float:
    try:
        return _integer(text)
    except ValueError:
        return _number(text, column, where)


def _whole(row: dict[str, str], column: str, where: str) -> int:
    try:
        return _integer(row[column])
    except ValueError:
        raise BadBusDescription(
            f"{where}: {column} {row[column]!r} is not a whole number"
        ) from None


def _integer(text: str) -> int:
    """Decimal, also with zeros before it, as manuals pad their numbers; 0x… is hexadecimal."""
    return int(text, 10 if text.strip().lstrip("+-").isdigit() else 0)


def _figure(row: dict[str, str], column: str, where: str) -> float:
    return _number(row[column], column, where)


def _number(text: str, column: str, where: str) -> float:
    """A number, with a decimal comma as well."""
    try:
        return float(text.replace(",", "."))
    except ValueError:
        raise BadBusDescription(f"{where}: {column} {text!r} is not a number") from None


# Column → how its cell is read, in the order in which the map has them.
_VALUES: dict[str, Callable[[dict[str, str], str, str], Any]] = {
    "bits": _whole,
    "registers": _whole,
    "word_order": _word,
    "byte_order": _word,
    "function": _word,
    "missing": _sentinels,
    "scale": _figure,
    "offset": _figure,
}
