"""A Modbus TCP server written by hand (no pymodbus), which answers wrongly when it is told to.

`away` closes the connections and answers nobody for a while, as a device does that is restarted.
"""

import asyncio
import contextlib
import random
import struct
import threading
import time

import numpy as np

from residuum.service.fieldbus.modbus.register_map import build_page, read_register_map
from residuum.service.fieldbus.settings import MAPS

STREAM = read_register_map(MAPS / "process_plant.yaml").streams["process"]
KINDS = (
    "short", "long", "odd bytes", "other transaction", "transaction zero", "other unit", "other function", "exception",
    "silence", "late", "twice", "flipped bit", "old content", "wrong protocol", "garbage", "cut off", "reset",
    "away",
)  # fmt: skip

NO_REPLY_AT_ALL = ("unknown function", "count beyond the end")
"""Replies that pymodbus cannot decode; they are no part of the campaign."""


def truth(number):
    return {"u": np.float32(np.sin(number)), "y": np.float32(number * 0.5)}


class FaultyModbus:
    """Pages appear by `publish`; `faults` is an iterator that says for each request which fault its reply has (None: none).

    `ended` has (kind, time) of every fault, `away` and `late` are how long these two last [s].
    """

    def __init__(self, faults, away=0.5, late=0.25):
        self.away, self.late = away, late
        self.ended = []
        self._writers = set()
        self.memory = np.zeros(65536, np.uint16)
        self.complete, self.faults, self.done = 0, faults, 0
        self.old = {}
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        assert self._ready.wait(120)

    def publish(self, count):
        pages = STREAM.pages
        for _ in range(count):
            values = {name: [value] for name, value in truth(self.complete).items()}
            page = build_page(self.complete, STREAM.encode(values))
            begin = pages.address + pages.stride * (self.complete % pages.count)
            self.memory[begin : begin + len(page)] = page
            self.complete += 1
        # all at once
        self.memory[pages.newest : pages.newest + 2] = (self.complete >> 16, self.complete & 0xFFFF)

    def stop(self):
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stopping.set)
            self._thread.join(120)

    def _run(self):
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self):
        self._stopping = asyncio.Event()
        self._server = await self._listen_somewhere()
        self.port = self._server.sockets[0].getsockname()[1]
        self._ready.set()
        await self._stopping.wait()
        self._server.close()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)
        await asyncio.sleep(0)  # the connections close

    async def _listen_somewhere(self):
        """At a port below those of outgoing connections: while this device is away, one of these could take its port."""
        while True:
            with contextlib.suppress(OSError):
                return await asyncio.start_server(
                    self._talk, "127.0.0.1", random.SystemRandom().randint(20_000, 32_000)
                )

    async def _be_away(self):
        self._server.close()
        await asyncio.sleep(self.away)
        await self._come_back()
        self.ended.append(("away", time.monotonic()))

    async def _come_back(self):
        self._server = await asyncio.start_server(self._talk, "127.0.0.1", self.port)

    def cut(self):
        """Close the connections and answer nobody, until `restore`."""
        self._loop.call_soon_threadsafe(self._leave)

    def _leave(self):
        self._server.close()
        for writer in self._writers:
            writer.close()

    def restore(self):
        asyncio.run_coroutine_threadsafe(self._come_back(), self._loop).result(120)

    async def _talk(self, reader, writer):
        self._writers.add(writer)
        with contextlib.suppress(
            asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError
        ):
            while True:
                head = await reader.readexactly(6)
                body = await reader.readexactly(struct.unpack(">H", head[4:])[0])
                transaction = struct.unpack(">H", head[:2])[0]
                address, count = struct.unpack(">HH", body[2:6])
                await self._answer(writer, transaction, body[0], address, count)
        self._writers.discard(writer)
        with contextlib.suppress(Exception):
            writer.close()

    async def _answer(self, writer, transaction, unit, address, count):
        if writer.is_closing():  # requests that came with one whose answer ended the connection
            return
        words = self.memory[address : address + count].astype(">u2")
        fault = next(self.faults, None)
        before, self.old[address] = (
            np.resize(self.old.get(address, np.zeros(1, ">u2")), count),
            words,
        )
        reply = _reply(transaction, unit, words)
        if fault is None:
            writer.write(reply)
            return
        self.done += 1
        if fault == "away":
            for each in self._writers:
                each.close()
            self._leaving = self._loop.create_task(self._be_away())
            return
        self.ended.append((fault, time.monotonic()))
        if fault == "silence":
            return
        if fault == "late":
            self._loop.call_later(self.late, _write_if_open, writer, reply)
            return
        if fault in ("reset", "cut off"):
            if fault == "cut off":
                writer.write(reply[: len(reply) // 2])
            writer.close()
            return
        if fault == "flipped bit":
            words = words.copy()
            words[-1] ^= 0x40
        wrong = {
            "short": lambda: _reply(transaction, unit, words[:-1]),
            "long": lambda: _reply(transaction, unit, np.append(words, words[:1])),
            "odd bytes": lambda: (
                struct.pack(">HHHBBB", transaction, 0, 3 + 2 * count - 1, unit, 3, 2 * count - 1)
                + words.tobytes()[:-1]
            ),
            "other transaction": lambda: _reply((transaction + 7) & 0xFFFF, unit, words),
            "transaction zero": lambda: _reply(0, unit, before),
            "other unit": lambda: _reply(transaction, unit + 1, words),
            "other function": lambda: _reply(transaction, unit, words, function=4),
            "exception": lambda: struct.pack(">HHHBBB", transaction, 0, 3, unit, 0x83, 6),
            "twice": lambda: reply + reply,
            "flipped bit": lambda: _reply(transaction, unit, words),
            "old content": lambda: _reply(transaction, unit, before),
            "wrong protocol": lambda: (
                struct.pack(">HHH", transaction, 9, len(reply) - 6) + reply[6:]
            ),
            "unknown function": lambda: _reply(transaction, unit, words, function=0x55),
            "count beyond the end": lambda: reply[:8] + bytes([reply[8] + 2]) + reply[9:],
            "garbage": lambda: bytes(range(200, 255)),
        }
        writer.write(wrong[fault]())


def _write_if_open(writer, reply):
    if not writer.is_closing():
        writer.write(reply)


def _reply(transaction, unit, words, function=3):
    payload = words.astype(">u2").tobytes()
    return (
        struct.pack(">HHHBBB", transaction, 0, 3 + len(payload), unit, function, len(payload))
        + payload
    )
