"""Device: a simulated machine that lives in real time on its buses and takes orders from them."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from typing import Any

import can
import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadInput
from residuum.service.fieldbus.can.can_bus import CanBus, open_bus
from residuum.service.fieldbus.can.can_source import COMMAND, STATE
from residuum.service.fieldbus.can.frame_layout import FrameLayout, read_dbc
from residuum.service.fieldbus.can.frame_sender import FrameSender
from residuum.service.fieldbus.modbus.device_reading import DeviceRegisters
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.fieldbus.modbus.register_server import RegisterServer
from residuum.service.fieldbus.settings import MAPS
from residuum.service.simulated.wiring import Wiring
from residuum.simulation.machine import BadSetting, Machine

# [s] Between two looks at the clock.
_TICK = 0.02
# [s] Between two reports of which faults are on.
_STATE_PERIOD = 0.5
# [s] After which the machine's life pauses. What it missed came in a burst once that went round its
# own ring of pages.
_FURTHEST_BEHIND = 0.2


class Device:
    """A machine on a CAN bus, a Modbus server, or both.

    Time runs `speed` times as fast as real time. When the computer cannot keep up for a fifth of a
    second, the machine's life pauses: nothing is skipped, and nothing is sent in a burst that no
    machine could make and no reader be ready for.

    Parameters
    ----------
    machine : Machine
    wiring : Wiring
    can_channel : str or None
        Bus for the streams that the wiring has on CAN.
    modbus : (host, port) or None
        Address to serve the streams that the wiring has in registers; without it they go to CAN
        too, where the DBC file has them.
    speed : float
    say : callable
        Told, in one line, of every order that was refused.
    opcua : str or None
        Address of an OPC UA server for the streams that the wiring has in registers:
        `ns=2;s=MACHINE.STREAM.CHANNEL`.
    """

    def __init__(
        self,
        machine: Machine,
        wiring: Wiring,
        can_channel: str | None,
        modbus: tuple[str, int] | None,
        speed: float,
        say: Callable[[str], None],
        opcua: str | None = None,
    ) -> None:
        self.machine = machine
        self._speed, self._say = speed, say
        self._bus: CanBus | None = open_bus(can_channel) if can_channel else None
        layouts = read_dbc(MAPS / wiring.dbc) if can_channel else {}
        self._command: FrameLayout | None = layouts.get(COMMAND)
        self._state: FrameLayout | None = layouts.get(STATE)
        self._registers = (
            DeviceRegisters(read_register_map(MAPS / wiring.registers), self._switch)
            if modbus
            else None
        )
        self._server = (
            RegisterServer(self._registers, *modbus) if self._registers and modbus else None
        )
        self._register_streams = dict(wiring.register_streams) if modbus else {}
        self._offered = (
            NodeStreams(opcua, machine.name, wiring.register_streams, speed) if opcua else None
        )
        self._senders = self._senders_of(wiring, layouts) if self._bus else {}

    def _senders_of(
        self, wiring: Wiring, layouts: Mapping[str, FrameLayout]
    ) -> dict[str, FrameSender]:
        """What sends each stream over CAN, but for those that registers carry."""
        return {
            stream: FrameSender(layouts[message])
            for stream, message in wiring.messages.items()
            if stream not in self._register_streams
        }

    async def run(self, stopped: asyncio.Event, ready: Callable[[int | None], None]) -> None:
        """Live until stopped; `ready` is told the Modbus port once the device is on its buses."""
        if self._offered:
            await self._offered.start()
        ready(await self._server.start() if self._server else None)
        try:
            await self._live(stopped)
        finally:
            if self._offered:
                await self._offered.stop()
            if self._server:
                await self._server.stop()
            if self._bus:
                self._bus.close()

    async def _live(self, stopped: asyncio.Event) -> None:
        begun, lived, state_due = time.monotonic(), 0.0, 0.0
        while not stopped.is_set():
            now = time.monotonic()
            due = (now - begun) * self._speed - lived
            # the machine's clock is put off by what it does not live through
            if due > _FURTHEST_BEHIND * self._speed:
                begun += due / self._speed - _FURTHEST_BEHIND
                due = _FURTHEST_BEHIND * self._speed
            if due >= self._least_step:
                self._advance(due)
                lived += due
            if self._offered:
                await self._offered.write()
            self._take_orders()
            if now >= state_due:
                self._show_state()
                state_due = now + _STATE_PERIOD
            await asyncio.sleep(_TICK)

    @property
    def _least_step(self) -> float:
        """Never ask the machine for less than a few samples of its slowest stream [s]."""
        return max(2 * self.machine.sample_time, 0.005)

    def _advance(self, duration: float) -> None:
        for stream, signals in self.machine.advance(duration).items():
            channels = {
                name: np.asarray(values, np.float64) for name, values in signals.channels.items()
            }
            if self._offered:
                self._offered.take(stream, channels, signals.sample_time)
            # registers before CAN: a stream that both could carry goes one way
            if self._registers and stream in self._register_streams:
                self._registers.pages[self._register_streams[stream]].append(channels)
            elif self._bus and stream in self._senders:
                self._send(self._senders[stream], channels)

    def _send(self, sender: FrameSender, channels: dict[str, npt.NDArray[np.float64]]) -> None:
        if self._bus:
            try:
                sender.send(self._bus, channels)
            except (OSError, can.CanError) as error:
                self._say(f"cannot send: {error}")

    def _take_orders(self) -> None:
        """Read all that waits: behind what was sent here, which some buses bring back, an order
        would wait for long.
        """
        while self._bus is not None and not (batch := self._bus.read(0.0)).empty:
            if self._command is not None:
                for frames in batch.frames.get(self._command.bus_id, ()):
                    self._take_order(self._command, frames)

    def _take_order(self, layout: FrameLayout, frames: npt.NDArray[np.uint8]) -> None:
        if not layout.fits(frames.shape[1]):
            return
        _, values = layout.decode(frames)
        for number, size in zip(values["fault"], values["size"], strict=True):
            self._switch(layout.choices["fault"].get(int(number), ""), float(size))

    def _switch(self, fault: str, size: float) -> None:
        try:
            if size == 0:
                self.machine.clear_fault(fault)
            else:
                self.machine.set_fault(fault, None if size < 0 else size)
        except BadSetting as error:
            self._say(str(error))
        self._show_state()

    def _show_state(self) -> None:
        active = self.machine.active_faults
        if self._registers:
            self._registers.show_faults(active)
        if self._bus and self._state:
            choices = self._state.choices["fault"]
            sizes = [active.get(fault, 0.0) for fault in choices.values()]
            frames = self._state.encode(
                np.zeros(len(sizes)), {"fault": list(choices), "size": sizes}
            )
            try:
                self._bus.send_many(self._state.frame_id, frames)
            except (OSError, can.CanError) as error:
                self._say(f"cannot send: {error}")


# NodeStreams: a simulated machine's slow streams as nodes of an OPC UA server of its own.


class NodeStreams:
    """Nodes `ns=2;s=MACHINE.STREAM.CHANNEL`, each value with the time at which the machine had it.

    Parameters
    ----------
    url : str
    machine : str
    streams : names of the streams that are offered
    speed : float
        How many times faster than real time the machine lives.
    """

    def __init__(self, url: str, machine: str, streams: Collection[str], speed: float) -> None:
        try:
            self._server: Any = import_module(
                "residuum.service.fieldbus.opcua.node_server"
            ).NodeServer(url)
        except ModuleNotFoundError:
            raise BadInput(
                "--opcua: needs the extra `opcua`: pip install 'residuum[opcua]'"
            ) from None
        self._machine, self._streams, self._speed = machine, streams, speed
        # stamps are of the computer's clock, as those of a plant's server are
        self._begun = time.time()
        self._lived = dict.fromkeys(streams, 0)
        self._waiting: list[tuple[str, float, float]] = []

    async def start(self) -> None:
        """Begin to serve."""
        await self._server.start()

    async def stop(self) -> None:
        """End all sessions."""
        await self._server.stop()

    def take(
        self, stream: str, channels: Mapping[str, npt.NDArray[np.float64]], sample_time: float
    ) -> None:
        """Samples that the machine gave; `write` offers them."""
        if stream not in self._streams:
            return
        first = self._lived[stream]
        for name, values in channels.items():
            stamps = self._begun + (first + np.arange(len(values))) * sample_time / self._speed
            self._waiting += [
                (f"{stream}.{name}", *pair)
                for pair in zip(values.tolist(), stamps.tolist(), strict=True)
            ]
            self._lived[stream] = first + len(values)

    async def write(self) -> None:
        """Offer what waits."""
        waiting, self._waiting = self._waiting, []
        for node, value, stamp in waiting:
            await self._server.write(self._machine, node, value, stamp)
