"""What a DBC file, a map or a table of registers says of a bus, before any machine is read by it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from residuum.service.fieldbus.block import StreamFormat
from residuum.service.fieldbus.can.can_source import streamed
from residuum.service.fieldbus.can.frame_layout import read_dbc
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.fieldbus.modbus.register_table import register_map_of, register_map_text
from residuum.service.fieldbus.opcua.node_map import read_node_map
from residuum.service.fieldbus.sparkplug.metric_map import read_metric_map

OF_SOURCE = {"dbc": "can", "table": "modbus", "registers": "modbus", "nodes": "opcua", "metrics": "sparkplug"}
"""Kind of a bus description → kind of the sources that are read by it."""
_MAPS: Mapping[str, Callable[[Path], Any]] = {
    "registers": read_register_map,
    "nodes": read_node_map,
    "metrics": read_metric_map,
}


@dataclass(frozen=True)
class BusDescription:
    """A bus description that was understood: its file, and the streams of samples that it gives."""

    name: str
    text: str
    streams: Sequence[StreamFormat]
    remarks: Sequence[str]

    def to_json(self) -> dict[str, Any]:
        """As plain values."""
        streams = [{"name": s.name, "sample_time": s.sample_time, "channels": dict(s.units)} for s in self.streams]
        return {"name": self.name, "text": self.text, "streams": streams, "remarks": list(self.remarks)}


def bus_description(kind: str, name: str, text: str, sample_time: float = 0.1, unit_id: int = 1) -> BusDescription:
    """Understand a description: `dbc`, `table` (made into a register map), or a map in YAML: `registers`, `nodes`, `metrics`.

    BadBusDescription when it cannot be read, or carries no stream of samples.
    """
    stem = Path(name).stem or "bus"
    if kind == "table":
        text, kind = register_map_text(register_map_of(text, sample_time, name, unit_id)), "registers"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{stem}{'.dbc' if kind == 'dbc' else '.yaml'}"
        file.write_text(text, encoding="utf-8")
        streams, remarks = _of_dbc(file) if kind == "dbc" else _of_map(_MAPS[kind](file).streams)
    return BusDescription(file.name, text, streams, remarks)


def _of_dbc(file: Path) -> tuple[list[StreamFormat], list[str]]:
    messages = read_dbc(file)
    read = streamed(messages)
    remarks = [f"message {layout.name}: {layout.remark}" for layout in read if layout.remark]
    left_out = [f"message {name} is not read: it {each.why_no_stream}" for name, each in messages.items() if each.why_no_stream]
    return [layout.format for layout in read], [*remarks, *left_out, *messages.unusable.values()]


def _of_map(streams: Mapping[str, Any]) -> tuple[list[StreamFormat], list[str]]:
    slow = [name for name, each in streams.items() if getattr(each, "poll", None)]
    polled = [f"stream {name} is polled: a read that comes late leaves a hole" for name in slow]
    formats = [each.format(name) for name, each in streams.items()]
    bare = [name for each in formats for name, unit in each.units.items() if not unit]
    says = f"no unit is said for {', '.join(bare)}: a model takes a signal with a unit only where it is said"
    return formats, [*polled, *([says] if bare else [])]
