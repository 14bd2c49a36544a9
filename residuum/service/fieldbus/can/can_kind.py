"""CAN as a kind of source."""

from __future__ import annotations

from pathlib import Path

from residuum.service.fieldbus.can.can_bus import open_bus
from residuum.service.fieldbus.can.can_source import CanSource, streamed
from residuum.service.fieldbus.can.frame_layout import read_dbc
from residuum.service.fieldbus.source import StreamFormat
from residuum.service.fieldbus.source_kind import Address, BusText, SourceKind


def _of_dbc(file: Path) -> tuple[list[StreamFormat], list[str]]:
    messages = read_dbc(file)
    read = streamed(messages)
    remarks = [f"message {layout.name}: {layout.remark}" for layout in read if layout.remark]
    left_out = [
        f"message {name} is not read: it {msg.why_no_stream}"
        for name, msg in messages.items()
        if msg.why_no_stream
    ]
    return [layout.format for layout in read], [*remarks, *left_out, *messages.unusable.values()]


def _check(source: Address) -> None:
    if not source.channel:
        raise ValueError("a CAN source needs a channel, for example socketcan:can0")


def _look(source: Address, _seconds: float) -> tuple[str, str]:
    messages = read_dbc(source.map_file)
    layouts = streamed(messages)
    # Opened and not read: a bus on which nothing is sent at this moment is not wrong.
    open_bus(source.channel).close()
    remarks = [f"{layout.name}: {layout.remark}" for layout in layouts if layout.remark]
    remarks += messages.unusable.values()
    names = ", ".join(layout.name for layout in layouts)
    says = f"{source.channel} can be opened; {source.map} streams {names}"
    silent = [
        f"{layout.name} {layout.why_no_stream}"
        for layout in messages.values()
        if layout.why_no_stream
    ]
    if silent:
        says += f"; of {len(silent)} not streamed the first: {silent[0]}"
    return says, "; ".join(remarks)


CAN = SourceKind(
    called="CAN bus",
    open=lambda source, sink: CanSource(source.channel, read_dbc(source.map_file), sink),
    map_called="DBC file (CAN)",
    asked="CAN bus, for example socketcan:can0.",
    example="socketcan:can0",
    texts={"dbc": BusText("a DBC file", _of_dbc, ".dbc")},
    check=_check,
    look=_look,
    template=(
        '- {kind: can, channel: "socketcan:can0", map: my-machine.dbc}         ',
        "FILL IN, or the next line in its place",
    ),
)
