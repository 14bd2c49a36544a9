"""Training of the demo's diagnosers on simulated records, taken through the same bus coding and window cutting as live ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import orjson
from threadpoolctl import threadpool_limits

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.identification.record import Record
from residuum.service.fieldbus.block import Block
from residuum.service.fieldbus.can.frame_layout import read_dbc
from residuum.service.fieldbus.can.frame_sender import FrameSender
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.fieldbus.settings import MAPS, WindowSettings
from residuum.service.machines.windows.cut_windows import make_cutter
from residuum.service.simulated.wiring import Wiring, wiring_of
from residuum.simulation import MACHINES, Machine

_SEED = 1000
_STEP = 1.0
_GATE_EXEMPLARS = 6
_HEALTHY_MOVEMENTS, _FAULTY_MOVEMENTS = 5, 2
_ROUNDS = 40
_PLANT_SECONDS = 600.0

Tell = Callable[[float, str], None]
Training = tuple[Sequence[Record], Sequence[str] | None]


def coded_blocks(machine: Machine, wiring: Wiring, on_can: bool = False) -> Iterator[Block]:
    """What a source would deliver of a machine's life, second by second, without a bus: encoded, decoded, in blocks."""
    layouts = read_dbc(MAPS / wiring.dbc) if wiring.dbc else {}
    registers = read_register_map(MAPS / wiring.registers).streams if wiring.registers else {}
    in_registers = {} if on_can else wiring.register_streams
    senders = {stream: FrameSender(layouts[name]) for stream, name in wiring.messages.items() if stream not in in_registers}
    sent = dict.fromkeys([*senders, *in_registers], 0)
    while True:
        for stream, signals in machine.advance(_STEP).items():
            channels = {name: np.asarray(values, np.float64) for name, values in signals.channels.items()}
            if stream in in_registers:
                name = in_registers[stream]
                table = registers[name].encode(channels).reshape(-1, registers[name].words)
                decoded = {channel: where.decode(table) for channel, where in registers[name].channels.items()}
            else:
                name = wiring.messages[stream]
                _, decoded = layouts[name].decode(senders[stream].frames(channels))
            n = len(next(iter(decoded.values())))
            yield Block(name, sent[stream] + np.arange(n, dtype=np.int64), decoded)
            sent[stream] += n


def simulated_windows(machine: Machine, wiring: Wiring, window: WindowSettings, count: int) -> list[Record]:
    """The first `count` windows of a machine's life."""
    layouts = read_dbc(MAPS / wiring.dbc) if wiring.dbc else {}
    registers = read_register_map(MAPS / wiring.registers).streams if wiring.registers else {}
    formats = [registers[name].format(name) for name in wiring.register_streams.values()]
    formats += [layouts[name].format for stream, name in wiring.messages.items() if stream not in wiring.register_streams]
    cutter = make_cutter(window, formats, machine.name)
    records: list[Record] = []
    for block in coded_blocks(machine, wiring):
        records += cutter.push(block)
        if len(records) >= count:
            break
    return records[:count]


def gate_actuator(tell: Tell) -> Training:
    """Movements of several specimens, healthy and with each fault, labelled with the classes that the diagnoser tells apart."""
    wiring, window = wiring_of("gate-actuator"), WindowSettings(cut="movement")
    plan = [("healthy", None, _HEALTHY_MOVEMENTS), ("pinion-or-gear", "gear-notch", _FAULTY_MOVEMENTS)]
    plan += [("pinion-or-gear", "pinion-tooth", _FAULTY_MOVEMENTS), ("rack", "rack-tooth", _FAULTY_MOVEMENTS)]
    records: list[Record] = []
    labels: list[str] = []
    for exemplar in range(_GATE_EXEMPLARS):
        tell(exemplar / _GATE_EXEMPLARS, f"simulating actuator {exemplar + 1} of {_GATE_EXEMPLARS}")
        for k, (label, fault, count) in enumerate(plan):
            faults = {fault: None} if fault else {}
            machine = MACHINES[wiring.machine](seed=_SEED + 10 * exemplar + k, exemplar=exemplar, faults=faults)
            cut = simulated_windows(machine, wiring, window, count)
            records += cut
            labels += [label] * len(cut)
    return records, labels


def gripping_pliers(tell: Tell) -> Training:
    """Healthy rounds."""
    tell(0.1, f"simulating {_ROUNDS} rounds")
    wiring = wiring_of("gripping-pliers")
    machine = MACHINES[wiring.machine](seed=_SEED)
    return simulated_windows(machine, wiring, WindowSettings(cut="round"), _ROUNDS), None


def process_plant(tell: Tell) -> Training:
    """One healthy record."""
    tell(0.1, f"simulating {_PLANT_SECONDS:g} s of the plant")
    wiring = wiring_of("process-plant")
    machine = MACHINES[wiring.machine](seed=_SEED)
    window = WindowSettings(cut="sliding", length=_PLANT_SECONDS, step=_PLANT_SECONDS)
    return simulated_windows(machine, wiring, window, 1), None


TRAINING_RECIPES: dict[str, Callable[[Tell], Training]] = {
    "gate-actuator": gate_actuator,
    "gripping-pliers": gripping_pliers,
    "process-plant": process_plant,
}
"""Demo machine → what its diagnoser is trained on."""


DIAGNOSER_OF = {"gate-actuator": "gate-actuator", "gripping-pliers": "gripping-pliers", "process-plant": "robust-residual"}
"""Demo machine → what watches it."""


def train(machine: str, folder: str) -> bytes:
    """Train the diagnoser of a demo machine and return its baseline file; runs in a worker process.

    Progress goes to a small file in `folder`, where the service reads it.
    """
    progress = Path(folder) / f"{machine}.progress"

    def tell(done: float, doing: str) -> None:
        part = progress.with_suffix(".part")
        part.write_bytes(orjson.dumps([done, doing]))
        part.replace(progress)

    diagnoser = DIAGNOSER_OF[machine]
    records, labels = TRAINING_RECIPES[machine](lambda done, doing: tell(0.6 * done, doing))
    tell(0.6, f"fitting {diagnoser} to {len(records)} records")
    with threadpool_limits(1):  # small matrices: more threads than cores that are free cost a hundred times over
        trained = DIAGNOSERS[diagnoser]().fit(records, labels)
    file = Path(folder) / f"{machine}.zip"
    trained.save(file)
    tell(1.0, "trained")
    return file.read_bytes()
