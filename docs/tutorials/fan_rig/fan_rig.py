"""A small fan on a bench, simulated as somebody else's device: a process of its own, that knows nothing of Residuum.

It turns a fan by a DC motor at ever new voltages. It tells voltage, current and speed on a CAN bus, 100 times a second
(`fan.dbc`), and the same with the motor's temperature in Modbus registers (`registers.csv`).

    python fan_rig.py --can 239.74.163.9:43117 --modbus 5021

Type an order and Enter: `rub 0.01` (a rubbing bearing, N·m), `offset 60` (the speed sensor reads 60 rpm too much),
`brake 5` (motor resistance, Ω), `healthy`, or `stop`.
"""

import argparse
import asyncio
import struct
import sys
import threading

import can
import numpy as np

STEP = 0.01  # s between two frames
FINE = 20  # steps of the integration in one of these
FRAME = 0x310
R, K, J = 1.2, 0.05, 4e-4  # Ω, V·s/rad, kg·m²
DRAG, FRICTION = 1.6e-6, 3e-3  # N·m·s²/rad², N·m
RPM = 60 / (2 * np.pi)


class Fan:
    """The rig's physics."""

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)
        self.omega = self.voltage = self.current = self.left = 0.0
        self.temperature = 20.0
        self.rub = self.offset = self.extra = 0.0

    def order(self, words):
        """Take an order; False for one that asks to stop."""
        what, size = words[0], float(words[1]) if len(words) > 1 else 0.0
        if what == "healthy":
            self.rub = self.offset = self.extra = 0.0
        elif what in ("rub", "offset", "brake"):
            self.rub, self.offset, self.extra = [
                size if what == one else 0.0 for one in ("rub", "offset", "brake")
            ]
        return what != "stop"

    def step(self):
        """One frame's time on: voltage, current and speed as they are measured at its begin."""
        if self.left <= 0:
            self.voltage, self.left = self.random.uniform(3.0, 12.0), self.random.uniform(0.4, 1.5)
        self.left -= STEP
        measured = [
            self.voltage,
            self.current_of(self.omega) + 0.01 * self.random.standard_normal(),
            self.omega * RPM + self.offset + 1.5 * self.random.standard_normal(),
            self.temperature + 0.1 * self.random.standard_normal(),
        ]
        for _ in range(FINE):
            current = self.current_of(self.omega)
            torque = K * current - DRAG * self.omega**2
            torque -= (FRICTION + self.rub) * np.tanh(self.omega / 0.5)
            self.omega = max(0.0, self.omega + STEP / FINE * torque / J)
        self.temperature += STEP * (0.02 * R * current**2 - 0.002 * (self.temperature - 20.0))
        return measured

    def current_of(self, omega):
        """The motor's current at a speed [A]."""
        return (self.voltage - K * omega) / (R + self.extra)


def frame(counter, measured):
    """The eight bytes that `fan.dbc` describes."""
    voltage, current, speed, _ = measured
    values = [round(voltage * 1000), round(current * 1000), round(speed * 10), counter]
    return b"".join((value & 0xFFFF).to_bytes(2, "little") for value in values)


def registers(measured):
    """The four holding registers that `registers.csv` describes."""
    voltage, current, speed, temperature = measured
    return [
        round(value) & 0xFFFF for value in (voltage * 100, current * 100, speed, temperature * 10)
    ]


async def answer(reader, writer, held):
    """Answer Modbus TCP requests for holding registers: the first has the number 0 on the wire, 40001 in the manual."""
    try:
        while True:
            number, _, length, unit = struct.unpack(">HHHB", await reader.readexactly(7))
            request = await reader.readexactly(length - 1)
            function, first, count = (
                struct.unpack(">BHH", request[:5]) if len(request) >= 5 else (request[0], 0, 0)
            )
            if function == 3 and 0 < count <= len(held) - first:
                data = struct.pack(f">{count}H", *held[first : first + count])
                reply = struct.pack(">BB", function, len(data)) + data
            else:
                reply = struct.pack(">BB", function | 0x80, 2 if function == 3 else 1)
            writer.write(struct.pack(">HHHB", number, 0, len(reply) + 1, unit) + reply)
            await writer.drain()
    except (asyncio.IncompleteReadError, ConnectionError):
        writer.close()


def listen(loop, fan, stopped):
    """Take orders from the keyboard, or from who started this process."""
    for line in sys.stdin:
        if line.split() and not fan.order(line.split()):
            break
    loop.call_soon_threadsafe(stopped.set)


async def live(arguments):
    """Turn the fan until it is told to stop."""
    fan, stopped, loop = Fan(arguments.seed), asyncio.Event(), asyncio.get_running_loop()
    group, _, port = arguments.can.partition(":")
    bus = can.Bus(
        interface="udp_multicast",
        channel=group,
        port=int(port),
        hop_limit=0,
        receive_own_messages=False,
    )
    held = [0] * 4
    server = await asyncio.start_server(
        lambda reader, writer: answer(reader, writer, held), "127.0.0.1", arguments.modbus
    )
    threading.Thread(target=listen, args=(loop, fan, stopped), daemon=True).start()
    sys.stdout.write("The fan turns.\n")
    sys.stdout.flush()
    begun, count = loop.time(), 0
    while not stopped.is_set():
        while count * STEP < (loop.time() - begun) * arguments.speed:
            measured = fan.step()
            bus.send(
                can.Message(arbitration_id=FRAME, data=frame(count, measured), is_extended_id=False)
            )
            count += 1
        held[:] = registers(measured)
        await asyncio.sleep(0.01)
    server.close()
    bus.shutdown()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--can", default="239.74.163.9:43117", help="multicast group and port of the CAN bus"
    )
    parser.add_argument("--modbus", type=int, default=5021, help="TCP port of the registers")
    parser.add_argument(
        "--speed", type=float, default=1.0, help="how many times faster than real time it lives"
    )
    parser.add_argument("--seed", type=int, default=1)
    asyncio.run(live(parser.parse_args()))
