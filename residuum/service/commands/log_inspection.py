"""What `inspect` says of a CAN log beside its DBC file: each message as it is in the log, and what
its signals make of it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from residuum.service.fieldbus.can.can_log import read_can_log
from residuum.service.fieldbus.can.frame_layout import NO_COUNTER, read_dbc
from residuum.service.fieldbus.can.logged_messages import LoggedMessage, logged_messages
from residuum.service.fieldbus.settings import map_file


def inspect_log(file: Path, dbc: Path) -> tuple[dict[str, Any], str]:
    """What is found, as plain values and as text; BadBusDescription when the log or the DBC file
    cannot be read.
    """
    log, messages = read_can_log(file), read_dbc(map_file(str(dbc)))
    logged, unknown = logged_messages(log, messages)
    plain = {
        "file": str(file),
        "dbc": str(dbc),
        "frames": len(log.frames),
        "messages": [_message(message) for message in logged],
        "absent": [
            name for name in messages if name not in {message.layout.name for message in logged}
        ],
        "unusable": dict(messages.unusable),
        "unknown": unknown,
        "remarks": [*log.remarks, *(remark for message in logged for remark in message.remarks)],
    }
    return plain, _text(plain)


def _message(message: LoggedMessage) -> dict[str, Any]:
    layout = message.layout
    return {
        "message": layout.name,
        "identifier": f"0x{layout.frame_id:X}",
        "frames": len(message.frames),
        "frame_time": message.frame_time,
        "jitter": message.jitter,
        "lost": message.lost,
        "counter": "counted" if layout.counter_bits else layout.remark or NO_COUNTER,
        "first_bytes": message.frames[0].tobytes().hex(" "),
        "channels": _channels(message),
    }


def _channels(message: LoggedMessage) -> list[dict[str, Any]]:
    layout = message.layout
    # The first frame beside its bytes: by hand it shows whether start bit and byte order are right.
    _, first = layout.decode(message.frames[:1])
    return [
        {
            "channel": name,
            "unit": layout.units[name],
            "first": _number(first[name][0]),
            "lowest": _number(values[held].min()) if held.any() else None,
            "highest": _number(values[held].max()) if held.any() else None,
            "missing": int((~held).sum()),
        }
        for name, values in layout.decode(message.frames)[1].items()
        for held in [~np.isnan(values)]
    ]


def _number(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _text(plain: dict[str, Any]) -> str:
    lines = [f"{plain['file']}: {plain['frames']} frames by {plain['dbc']}"]
    for message in plain["messages"]:
        lost = message["counter"] if message["lost"] is None else f"{message['lost']} lost"
        name, rate = (
            f"{message['message']} {message['identifier']}",
            f"one every {message['frame_time']:.6g} s",
        )
        lines += [
            f"  {name}: {message['frames']} frames, {rate}, {lost}",
            f"    first frame  {message['first_bytes']}",
        ]
        lines += ["    " + _channel_line(channel) for channel in message["channels"]]
    lines += [f"  not in the log: {', '.join(plain['absent'])}"] if plain["absent"] else []
    lines += [f"  not usable: {why}" for why in plain["unusable"].values()]
    lines += [
        f"  not in the DBC file: {name}, {count} frames" for name, count in plain["unknown"].items()
    ]
    return "\n".join(lines + [f"  {remark}" for remark in plain["remarks"]])


def _channel_line(channel: dict[str, Any]) -> str:
    first = "not in it" if channel["first"] is None else f"{channel['first']:.6g}"
    span = (
        "never"
        if channel["lowest"] is None
        else f"{channel['lowest']:.6g} … {channel['highest']:.6g}"
    )
    missing = f", missing in {channel['missing']}" if channel["missing"] else ""
    return f"{channel['channel']} [{channel['unit']}]: {first} there; {span}{missing}"
