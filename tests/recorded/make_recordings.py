"""Makes the recordings in this folder: simulated machines as a bus logger would have stored them; run once and committed."""

import itertools
from pathlib import Path

import can
import numpy as np

from residuum.service.fieldbus.can.frame_layout import read_dbc
from residuum.service.fieldbus.can.frame_sender import FrameSender
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.fieldbus.modbus.register_trace import TracedPage, write_trace
from residuum.service.fieldbus.settings import MAPS
from residuum.service.simulated.wiring import wiring_of
from residuum.simulation import MACHINES

HERE = Path(__file__).parent
_STEP = 0.1


def record_can(device, path, seconds, fault, fault_at, skip=0.0):
    """`seconds` of a device's CAN traffic; the fault comes at `fault_at`."""
    wiring = wiring_of(device)
    layouts = read_dbc(MAPS / wiring.dbc)
    senders = {stream: FrameSender(layouts[message]) for stream, message in wiring.messages.items()}
    machine = MACHINES[wiring.machine](seed=11)
    if skip:
        machine.advance(skip)
    with can.BLFWriter(str(path), compression_level=9) as log:
        for k in range(round(seconds / _STEP)):
            if k == round(fault_at / _STEP):
                machine.set_fault(fault)
            for message in merged(machine.advance(_STEP), senders, k * _STEP):
                log.on_message_received(message)


def merged(streams, senders, begin):
    """The frames of all streams in the order in which a logger would have seen them."""
    messages = []
    for stream, signals in streams.items():
        layout = senders[stream].layout
        frames = senders[stream].frames(
            {name: np.asarray(values) for name, values in signals.channels.items()}
        )
        for at, data in zip(
            begin + _STEP * (np.arange(len(frames)) + 1) / max(1, len(frames)), frames, strict=True
        ):
            message = can.Message(
                timestamp=1.0 + at,
                arbitration_id=layout.frame_id,
                data=data.tobytes(),
                is_extended_id=False,
                is_fd=layout.is_fd,
                bitrate_switch=layout.is_fd,
            )
            messages.append(message)
    return sorted(messages, key=lambda message: message.timestamp)


def plant_pages(seconds, fault, fault_at):
    wiring = wiring_of("process-plant")
    stream = read_register_map(MAPS / wiring.registers).streams["process"]
    machine = MACHINES[wiring.machine](seed=11)
    for k in itertools.count(1):
        if k * stream.sample_time > seconds:
            return
        if k == round(fault_at / stream.sample_time):
            machine.set_fault(fault)
        channels = machine.advance(stream.sample_time)["signals"].channels
        yield TracedPage(k * stream.sample_time, "process", stream.encode(channels))


if __name__ == "__main__":
    record_can("gate-actuator", HERE / "gate_actuator.blf", 31.0, "pinion-tooth", 13.0, skip=0.5)
    record_can("gripping-pliers", HERE / "gripping_pliers.blf", 20.0, "plier-bearing", 10.0)
    write_trace(
        HERE / "process_plant.trace",
        "process_plant.yaml",
        plant_pages(120.0, "sensor-offset", 60.0),
    )
