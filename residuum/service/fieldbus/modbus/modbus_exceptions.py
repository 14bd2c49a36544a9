"""What a Modbus device means by an exception, and what to do about it."""

from __future__ import annotations

import logging

_MEANINGS = {
    1: (
        "the device does not know this function; take another table (function: holding, input,"
        " coils or discrete)"
    ),
    2: "the device has no such register, or not all of these",
    3: "the device takes no such request; read fewer registers at once",
    4: "the device failed at it",
    6: "the device is busy; poll it less often",
    10: "the gateway has no way to this unit; look at unit_id",
    11: "no answer from behind the gateway; look at unit_id",
}
_TABLES = {
    "holding": "holding registers",
    "input": "input registers",
    "coils": "coils",
    "discrete": "discrete inputs",
}
_HOLES = "holes: name registers that are there, gap: 0"
_MANUAL = {
    "holding": ((400_001, 465_536), (40_001, 49_999)),
    "input": ((300_001, 365_536), (30_001, 39_999)),
}
"""How manuals number a table: with a digit for the table before, and from 1."""


def explained(code: int, function: str, address: int, count: int, address_base: int = 0) -> str:
    """An exception in one line: the registers by their address on the wire (from 0), what it means,
    what to do.

    `address_base` is what the map calls the first register, in which the advice is given.

    >>> explained(2, "holding", 40001, 2)[:71]
    'exception 2 for holding registers 40001 to 40002 (on the wire, from 0):'
    """
    span = f"{address}" if count == 1 else f"{address} to {address + count - 1}"
    says = (
        f"exception {code} for {_TABLES[function]} {span} (on the wire, from 0):"
        f" {_MEANINGS.get(code, 'see its manual')}"
    )
    if code != 2:
        return says
    written = address + address_base
    manual = next(
        (first for first, last in _MANUAL.get(function, ()) if first <= written <= last), None
    )
    if manual is not None:
        meant = written - manual + address_base
        off = f"take {manual - address_base} off the address" + " (address_base: 1)" * address_base
        return f"{says}; a manual's {written} is address {meant} of this table: {off}"
    if address_base:
        return f"{says}; one off? where the manual counts from 0, leave address_base out; {_HOLES}"
    return f"{says}; one off? where the manual counts from 1, say address_base: 1; {_HOLES}"


logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # the counters say it
