"""Demo: the three simulated machines as processes on real buses of this computer, and the training
of their diagnosers.
"""

from __future__ import annotations

import contextlib
import random
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import structlog
from threadpoolctl import threadpool_limits

from residuum.code_digest import code_digest
from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.fieldbus.can.frame_layout import read_dbc
from residuum.service.fieldbus.can.frame_sender import FrameSender
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.fieldbus.settings import (
    MAPS,
    MachineSettings,
    SecondOpinion,
    SourceSettings,
    WindowSettings,
)
from residuum.service.fieldbus.source import Backoff, Block
from residuum.service.machines.windows import make_cutter
from residuum.service.simulated.wiring import Wiring, wiring_of
from residuum.service.work.worker_pool import WorkerPool
from residuum.simulation import MACHINES, Machine

log = structlog.get_logger()

# [s] For all machines' processes together to end.
_STOP_TIMEOUT = 3.0
# [s] Between looks at whether they live.
_LOOK = 0.5
_ON_OPCUA = "process-plant"


class Demo:
    """Starts the machines' processes, keeps them alive, and trains what judges them.

    Everything stays on this computer: the CAN buses are multicast groups with no hop, the Modbus
    servers listen on the loopback address. A machine's process ends when this one does, however it
    ends: it watches its standard input.

    Training has a worker process of its own: findings of a machine that is ready do not wait for
    the training of another.

    Parameters
    ----------
    speed : float
        How many times faster than real time the machines live.
    opcua : str
        Address at which the process plant offers itself over OPC UA beside Modbus; empty: none.
        BadInput without the extra.
    """

    def __init__(self, speed: float = 1.0, opcua: str = "") -> None:
        if opcua and find_spec("asyncua") is None:
            raise BadInput(
                "setting demo_opcua: needs the extra `opcua`: pip install 'residuum[opcua]'"
            )
        self._speed, self._opcua = speed, {_ON_OPCUA: opcua} if opcua else {}
        self._pool = WorkerPool(1)
        self.machines = _demo_machines()
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._stopped = threading.Event()
        self._watch = threading.Thread(target=self._keep_alive, name="demo machines", daemon=True)
        self._folder = Path(tempfile.mkdtemp(prefix="residuum-training-"))

    def start(self) -> None:
        """Start every machine's process."""
        for machine in self.machines:
            self._processes[machine.asset] = self._start(machine)
        self._watch.start()

    def wait_until_ready(self, machine: str) -> None:
        """Return when a machine is on its buses (its process then says so), or has ended before."""
        output = self._processes[machine].stdout
        if output is not None:
            output.readline()

    def stop(self) -> None:
        """End the machines' processes."""
        self._stopped.set()
        self.end_training()
        # their input closed, all end side by side; then one end of waiting for all of them
        for process in self._processes.values():
            if process.stdin:
                with contextlib.suppress(OSError):
                    process.stdin.close()
        end = time.monotonic() + _STOP_TIMEOUT
        for process in self._processes.values():
            try:
                process.wait(max(0.1, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdout:
                process.stdout.close()

    def _start(self, machine: MachineSettings) -> subprocess.Popen[bytes]:
        return _start(machine, self._speed, self._opcua.get(machine.asset))

    def _keep_alive(self) -> None:
        backoffs = {machine.asset: Backoff(first=0.5, longest=30.0) for machine in self.machines}
        while not self._stopped.wait(_LOOK):
            for machine in self.machines:
                # asked again: the demo may have been stopped while this loop was at another machine
                status = self._processes[machine.asset].poll()
                if status is not None and not self._stopped.is_set():
                    log.warning(
                        "a demo machine ended and is started again",
                        machine=machine.asset,
                        status=status,
                    )
                    if not self._stopped.wait(backoffs[machine.asset].next()):
                        self._processes[machine.asset] = self._start(machine)

    def describe_faults(self, machine: str) -> Mapping[str, dict[str, Any]]:
        """Default size, unit and meaning of each fault of a demo machine."""
        if machine not in TRAINING_RECIPES:
            return {}
        faults = MACHINES[wiring_of(machine).machine].faults
        return {
            name: {"default_size": fault.default_size, "unit": fault.unit, "meaning": fault.meaning}
            for name, fault in faults.items()
        }

    def training_key(self, machine: str) -> str:
        """Changes whenever anything of this program does; a baseline stored under it is still
        right.
        """
        return f"demo {machine} {code_digest('residuum')[:16]}"

    def train(self, machine: str) -> bytes:
        """Train a machine's diagnoser in a worker process and return its baseline file."""
        return self._pool.call(train, machine, str(self._folder))

    def progress(self, machine: str) -> tuple[float, str]:
        """How far a training is: share done and what is being done."""
        try:
            done, doing = orjson.loads((self._folder / f"{machine}.progress").read_bytes())
        except (OSError, ValueError):
            return 0.0, "waiting to be trained"
        return float(done), str(doing)

    def end_training(self) -> None:
        """Give the training's process and folder back."""
        self._pool.terminate()
        shutil.rmtree(self._folder, ignore_errors=True)


def _demo_machines() -> list[MachineSettings]:
    gate = SourceSettings(kind="can", channel=_free_group(), map="gate_actuator.dbc")
    vibration = SourceSettings(kind="can", channel=_free_group(), map="gripping_pliers.dbc")
    signals = SourceSettings(kind="modbus", port=_free_port(), map="gripping_pliers.yaml")
    plant = SourceSettings(kind="modbus", port=_free_port(), map="process_plant.yaml")
    sliding = WindowSettings(cut="sliding", length=30, step=5)
    return [
        _machine("process-plant", sliding, [plant]),
        _machine("gripping-pliers", WindowSettings(cut="round"), [vibration, signals]),
        _machine("gate-actuator", WindowSettings(cut="movement"), [gate]),
    ]


# Machines of which a second opinion can be trained, by the model that is built in for them.
_MODEL_OF = {"gate-actuator": "gate-drive", "process-plant": "process"}


def _machine(asset: str, window: WindowSettings, sources: list[SourceSettings]) -> MachineSettings:
    model = _MODEL_OF.get(asset)
    second = None if model is None else SecondOpinion(model=model)
    return MachineSettings(
        asset=asset, diagnoser=DIAGNOSER_OF[asset], window=window, sources=sources, second=second
    )


def _free_group() -> str:
    """A multicast group and port of our own, chosen at random: two demos on one computer must not
    hear each other.
    """
    numbers = random.SystemRandom()
    group = f"239.{numbers.randint(1, 250)}.{numbers.randint(1, 250)}.{numbers.randint(1, 250)}"
    return f"udp_multicast:{group}:{numbers.randint(20_000, 32_000)}/0"


def _free_port() -> int:
    """A port that nobody listens at, below those that outgoing connections are given: one of these
    could take it meanwhile.
    """
    while True:
        port = random.SystemRandom().randint(20_000, 32_000)
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


def _start(machine: MachineSettings, speed: float, opcua: str | None) -> subprocess.Popen[bytes]:
    # by this interpreter: the console command may not be on the path of a service
    command = [
        sys.executable,
        "-c",
        "from residuum.service.cli import main; main()",
        "machine",
        machine.asset,
        "--with-parent",
    ]
    command += ["--speed", str(speed)]
    for source in machine.sources:
        command += (
            ["--can", source.channel]
            if source.kind == "can"
            else ["--modbus", f"{source.host}:{source.port}"]
        )
    command += ["--opcua", opcua] if opcua else []
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)


# Training of the demo's diagnosers on simulated records, taken through the same bus coding and
# window cutting as live ones.

# Of the machines that are trained on: those of the demo have the seed 0, so nothing is judged that
# was learned.
_SEED = 1000
# [s] Of a machine's life that is simulated at once.
_STEP = 1.0
_GATE_EXEMPLARS = 6
# Of each exemplar, with each of three faults: 6 · (5 + 3 · 2) = 66 movements in all.
_HEALTHY_MOVEMENTS, _FAULTY_MOVEMENTS = 5, 2
_ROUNDS = 40
_PLANT_SECONDS = 600.0

Tell = Callable[[float, str], None]
Training = tuple[Sequence[Record], Sequence[str] | None]


def coded_blocks(machine: Machine, wiring: Wiring, on_can: bool = False) -> Iterator[Block]:
    """What a source would deliver of a machine's life, second by second, without a bus: encoded,
    decoded, in blocks.
    """
    layouts = read_dbc(MAPS / wiring.dbc) if wiring.dbc else {}
    registers = read_register_map(MAPS / wiring.registers).streams if wiring.registers else {}
    in_registers = {} if on_can else wiring.register_streams
    senders = {
        stream: FrameSender(layouts[name])
        for stream, name in wiring.messages.items()
        if stream not in in_registers
    }
    sent = dict.fromkeys([*senders, *in_registers], 0)
    while True:
        # through the coding of the bus: what is learned is rounded as what is judged will be
        for stream, signals in machine.advance(_STEP).items():
            channels = {
                name: np.asarray(values, np.float64) for name, values in signals.channels.items()
            }
            if stream in in_registers:
                name = in_registers[stream]
                table = registers[name].encode(channels).reshape(-1, registers[name].words)
                decoded = {
                    channel: where.decode(table)
                    for channel, where in registers[name].channels.items()
                }
            else:
                name = wiring.messages[stream]
                _, decoded = layouts[name].decode(senders[stream].frames(channels))
            n = len(next(iter(decoded.values())))
            yield Block(name, sent[stream] + np.arange(n, dtype=np.int64), decoded)
            sent[stream] += n


def simulated_windows(
    machine: Machine, wiring: Wiring, window: WindowSettings, count: int
) -> list[Record]:
    """The first `count` windows of a machine's life."""
    layouts = read_dbc(MAPS / wiring.dbc) if wiring.dbc else {}
    registers = read_register_map(MAPS / wiring.registers).streams if wiring.registers else {}
    formats = [registers[name].format(name) for name in wiring.register_streams.values()]
    formats += [
        layouts[name].format
        for stream, name in wiring.messages.items()
        if stream not in wiring.register_streams
    ]
    cutter = make_cutter(window, formats, machine.name)
    records: list[Record] = []
    for block in coded_blocks(machine, wiring):
        records += cutter.push(block)
        if len(records) >= count:
            break
    return records[:count]


def gate_actuator(tell: Tell) -> Training:
    """Movements of several specimens, healthy and with each fault, labelled with the classes that
    the diagnoser tells apart.
    """
    wiring, window = wiring_of("gate-actuator"), WindowSettings(cut="movement")
    plan = [
        ("healthy", None, _HEALTHY_MOVEMENTS),
        ("pinion-or-gear", "gear-notch", _FAULTY_MOVEMENTS),
    ]
    plan += [
        ("pinion-or-gear", "pinion-tooth", _FAULTY_MOVEMENTS),
        ("rack", "rack-tooth", _FAULTY_MOVEMENTS),
    ]
    records: list[Record] = []
    labels: list[str] = []
    for exemplar in range(_GATE_EXEMPLARS):
        tell(exemplar / _GATE_EXEMPLARS, f"simulating actuator {exemplar + 1} of {_GATE_EXEMPLARS}")
        for k, (label, fault, count) in enumerate(plan):
            faults = {fault: None} if fault else {}
            machine = MACHINES[wiring.machine](
                seed=_SEED + 10 * exemplar + k, exemplar=exemplar, faults=faults
            )
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


DIAGNOSER_OF = {
    "gate-actuator": "gate-actuator",
    "gripping-pliers": "gripping-pliers",
    "process-plant": "robust-residual",
}
"""Demo machine → what watches it."""


def train(machine: str, folder: str) -> bytes:
    """Train the diagnoser of a demo machine and return its baseline file; runs in a worker process.

    Progress goes to a small file in `folder`, where the service reads it.
    """
    progress = Path(folder) / f"{machine}.progress"

    def tell(done: float, doing: str) -> None:
        # moved into place: the service reads it at any moment
        part = progress.with_suffix(".part")
        part.write_bytes(orjson.dumps([done, doing]))
        part.replace(progress)

    diagnoser = DIAGNOSER_OF[machine]
    records, labels = TRAINING_RECIPES[machine](lambda done, doing: tell(0.6 * done, doing))
    tell(0.6, f"fitting {diagnoser} to {len(records)} records")
    # small matrices: more threads than cores that are free cost a hundred times over
    with threadpool_limits(1):
        trained = DIAGNOSERS[diagnoser]().fit(records, labels)
    file = Path(folder) / f"{machine}.zip"
    trained.save(file)
    tell(1.0, "trained")
    return file.read_bytes()
