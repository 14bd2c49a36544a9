"""Modbus TCP as a kind of source."""

from __future__ import annotations

from typing import Any

from residuum.service.fieldbus.modbus.device_reading import read_device
from residuum.service.fieldbus.modbus.modbus_source import ModbusSource
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.fieldbus.modbus.register_table import register_map_of, register_map_text
from residuum.service.fieldbus.source_kind import (
    Address,
    BusText,
    SourceKind,
    Told,
    Wrong,
    text_of_map,
)


def _look(source: Address, seconds: float) -> Told:
    """Read the device once by its map."""
    registers = read_register_map(source.map_file)
    address = f"{source.host}:{source.port}"
    try:
        readings, refusals = read_device(source.host, source.port, registers, seconds)
    # A remark and not wrong: the device is there and answers, but not for this unit.
    except TimeoutError as error:
        return (
            f"{address} accepts connections",
            f"but gives no reply that fits: {error}; look at unit_id ({registers.unit_id})",
        )
    if refusals:
        raise Wrong(f"{address}: {'; '.join(refusals)}")
    remarks = [
        f"{entry.stream}.{entry.channel}: {entry.remark}"
        for entry in readings
        if entry.remark not in ("", "missing")
    ]
    return f"{address} answers; {source.map}: {len(readings)} channels read", "; ".join(remarks)


def _reached(where: str) -> dict[str, Any]:
    host, _, port = where.rpartition(":")
    return {"host": host or "127.0.0.1", "port": int(port)}


_MAP = text_of_map("a map of registers", read_register_map)
MODBUS = SourceKind(
    called="Modbus TCP",
    open=lambda source, sink: ModbusSource(
        source.host, source.port, read_register_map(source.map_file), sink
    ),
    map_called="register map (Modbus)",
    asked="HOST:PORT of a Modbus TCP device.",
    example="192.168.0.10:502",
    texts={
        "table": BusText(
            "a table of registers",
            _MAP.read,
            made=lambda text, sample_time, name, unit_id: register_map_text(
                register_map_of(text, sample_time, name, unit_id)
            ),
        ),
        "registers": _MAP,
    },
    look=_look,
    by_host=True,
    reached=_reached,
    template=(
        "- {kind: modbus, host: 192.168.0.10, port: 502, map: registers.yaml}  ",
        "`residuum watch map` makes the map",
    ),
)
