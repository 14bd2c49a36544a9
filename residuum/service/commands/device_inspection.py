"""What `inspect` says of a Modbus device beside its register map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from residuum.identification.errors import BadInput
from residuum.service.fieldbus.modbus.device_reading import (
    MISSING,
    ChannelReading,
    as_plain,
    read_device,
)
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.fieldbus.settings import map_file

MODBUS = "modbus:"


def inspect_device(address: str, map_path: Path) -> tuple[dict[str, Any], str]:
    """What is found, as plain values and as text; BadInput when nothing is there, or the map cannot
    be read.
    """
    host, _, port = address.removeprefix(MODBUS).rpartition(":")
    if not (host and port.isdecimal() and int(port) <= 65535):
        raise BadInput(f"{address}: must be modbus:HOST:PORT")
    registers = read_register_map(map_file(str(map_path)))
    try:
        readings, refusals = read_device(host, int(port), registers)
    except OSError as error:
        raise BadInput(
            f"{address}: cannot be read: {error}; look at host, port and unit_id"
            f" ({registers.unit_id})"
        ) from None
    plain = {
        "device": address,
        "map": str(map_path),
        "channels": [as_plain(entry) for entry in readings],
        "refused": refusals,
    }
    lines = [f"{address} by {map_path}: {len(readings)} channels read"]
    lines += [line for reading in readings for line in _lines(reading)]
    return plain, "\n".join(lines + [f"  refused: {entry}" for entry in refusals])


def _lines(reading: ChannelReading) -> list[str]:
    words = " ".join(f"{word:04X}" for word in reading.words)
    value = MISSING if reading.value is None else f"{reading.value:.8g} {reading.unit}".rstrip()
    remark = f"   ({reading.remark})" if reading.remark not in ("", MISSING) else ""
    lines = [
        f"  {reading.stream}.{reading.channel}, {reading.function} {reading.address}: {words} ="
        f" {value}{remark}"
    ]
    # A manual seldom says the order of words: each is shown, and the one whose value is plausible
    # marked.
    if reading.orders:
        marked = (
            f"{name} {_number(number)}{' *' * (name == reading.plausible)}"
            for name, number in reading.orders.items()
        )
        lines.append(
            f"      {', '.join(marked)}{'   * the plausible one' if reading.plausible else ''}"
        )
    return lines


def _number(value: float | None) -> str:
    return "no number" if value is None else f"{value:.6g}"
