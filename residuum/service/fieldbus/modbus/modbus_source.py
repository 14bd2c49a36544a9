"""ModbusSource: streams of samples from the registers of a Modbus TCP device, after a register
map.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from pymodbus.exceptions import ModbusException

from residuum.service.fieldbus.modbus.channel_registers import Registers
from residuum.service.fieldbus.modbus.device_reading import MISSING, ChannelReading, readings_of
from residuum.service.fieldbus.modbus.modbus_client import (
    BadReply,
    CheckedModbusClient,
    DeviceRefused,
)
from residuum.service.fieldbus.modbus.register_map import (
    MOST_REGISTERS,
    Pages,
    PolledStream,
    RegisterMap,
    StreamRegisters,
    float_registers,
    read_blocks,
    read_page,
    registers_float,
)
from residuum.service.fieldbus.sequence import BREAK
from residuum.service.fieldbus.source import (
    Backoff,
    Block,
    FaultsUnavailable,
    Sink,
    Source,
    StreamFormat,
)

# [s] Between two looks for new pages: those that come faster are read several at once.
_LEAST_PERIOD = 0.1
# [s] Between two looks at which faults are on.
_STATE_PERIOD = 1.0
# Oldest pages of a ring that are not begun with: they would be written over while they are read.
_SPARE_PAGES = 2
# Times that a page number which goes back is asked for again before it is believed.
_CONFIRMATIONS = 2
# [s] For which a command is tried again, and for which one reply to it is waited for.
_SWITCH_TIMEOUT = 3.0
_SWITCH_AGAIN = 0.1


class ModbusSource(Source):
    """Streams that a register map describes, read from one device.

    Parameters
    ----------
    host, port : str, int
    registers : RegisterMap
    sink : callable
    timeout : float
        For each reply [s].
    """

    def __init__(
        self, host: str, port: int, registers: RegisterMap, sink: Sink, timeout: float = 1.0
    ) -> None:
        super().__init__(f"modbus:{host}:{port}", sink)
        self._host, self._port, self._timeout = host, port, timeout
        self._map = registers
        self._readers = [
            _stream_reader(name, stream, registers.address_base, self)
            for name, stream in registers.streams.items()
        ]
        self._sizes: dict[str, float] = {}
        self._backoff = Backoff(first=0.05)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._client: CheckedModbusClient | None = None

    @property
    def streams(self) -> Sequence[StreamFormat]:
        """The streams of the register map."""
        return [stream.format(name) for name, stream in self._map.streams.items()]

    @property
    def fault_ids(self) -> Sequence[str]:
        """The faults of the register map."""
        return self._map.faults.ids if self._map.faults else []

    @property
    def fault_sizes(self) -> Mapping[str, float]:
        """Faults whose state registers are not zero."""
        return {fault: size for fault, size in self._sizes.items() if size}

    def switch_fault(self, fault: str, size: float) -> None:
        """Write the command registers; tried again for some seconds, because the connection may be
        just coming back.
        """
        faults = self._map.faults
        if faults is None or fault not in faults.ids:
            raise FaultsUnavailable(f"{self.name}: cannot switch fault {fault!r}")
        command = [faults.ids.index(fault) + 1, *float_registers(size)]
        end = time.monotonic() + _SWITCH_TIMEOUT
        while (refusal := self._write(faults.command, command)) is not None:
            if time.monotonic() > end or self._stopped.wait(_SWITCH_AGAIN):
                raise FaultsUnavailable(f"{self.name}: cannot switch fault {fault!r}: {refusal}")

    def _write(self, address: int, registers: list[int]) -> str | None:
        """Write registers from any thread; what went wrong, None when nothing did."""
        client, loop = self._client, self._loop
        if client is None or loop is None:
            return "the device is not connected"
        waiting = asyncio.run_coroutine_threadsafe(client.write(address, registers), loop)
        try:
            waiting.result(_SWITCH_TIMEOUT)
        except (BadReply, DeviceRefused, TimeoutError, RuntimeError) as error:
            waiting.cancel()
            return f"the device did not take the command: {error}"
        return None

    def deliver(self, block: Block, pages: int) -> None:
        """Hand on samples that were read (called by the stream readers)."""
        self._backoff.reset()
        self._deliver(block, pages)

    def _run(self) -> None:
        asyncio.run(self._keep_reading())

    async def _keep_reading(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._loop.set_exception_handler(self._note)
        opened_before = False
        while not self._stopped.is_set():
            client = CheckedModbusClient(
                self._host, self._port, self._map.unit_id, self._timeout, self._map.address_base
            )
            try:
                await client.connect()
                if opened_before:
                    self.health.count("reconnects")
                opened_before, self._client = True, client
                await self._read_while_it_works(client)
            except BadReply as error:
                self.health.count(error.counter, 1, str(error))
            except OSError as error:
                self.health.count("bus_errors", 1, str(error))
            finally:
                self._client = None
                client.close()
            await self._pause(self._backoff.next())

    def _note(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Count what pymodbus cannot decode: it lets that end the connection, and the reply does
        not come.
        """
        error = context.get("exception")
        if isinstance(error, ModbusException):
            self.health.count("undecodable", 1, str(error))
        else:
            loop.default_exception_handler(context)

    async def _read_while_it_works(self, client: CheckedModbusClient) -> None:
        period = min(reader.period for reader in self._readers)
        state_due, due = 0.0, time.monotonic()
        while not self._stopped.is_set():
            try:
                for reader in self._readers:
                    await reader.read(client)
                now = time.monotonic()
                if now >= state_due:
                    await self._read_state(client)
                    state_due = now + _STATE_PERIOD
            except DeviceRefused as error:
                self.health.count("modbus_exceptions", 1, str(error))
            # by the clock, not by the length of a read; of turns that were missed one is made up
            # for
            due = max(due + period, time.monotonic() - period)
            await self._pause(due - time.monotonic())

    async def _read_state(self, client: CheckedModbusClient) -> None:
        if faults := self._map.faults:
            words = await client.read(faults.state, 2 * len(faults.ids))
            sizes = [registers_float(high, low) for high, low in words.reshape(-1, 2).tolist()]
            self._sizes = dict(zip(faults.ids, sizes, strict=True))

    async def _pause(self, seconds: float) -> None:
        """Wait in steps short enough to stop soon."""
        end = time.monotonic() + seconds
        while not self._stopped.is_set() and (left := end - time.monotonic()) > 0:
            await asyncio.sleep(min(left, 0.1))


class _PagedReader:
    """Reads the pages of one stream in turn, from the oldest that the ring holds."""

    def __init__(
        self, name: str, stream: StreamRegisters, pages: Pages, source: ModbusSource
    ) -> None:
        self.period = max(_LEAST_PERIOD, stream.sample_time * pages.samples)
        self._name, self._stream, self._pages, self._source = name, stream, pages, source
        self._slots = (
            max(1, MOST_REGISTERS // pages.stride) if pages.stride == stream.page_registers else 1
        )
        self._next: int | None = None
        self._base = 0

    async def read(self, client: CheckedModbusClient) -> None:
        """Deliver every page that is complete and not read yet."""
        # newest: the number of the newest complete page + 1, so the end of what can be read
        newest = await self._newest(client)
        if self._next is not None and newest < self._next:
            newest = await self._confirm_restart(client, newest)
        oldest = max(0, newest - self._pages.count + _SPARE_PAGES)
        if self._next is None:
            self._next = oldest
        elif self._next < oldest:
            self._source.health.count(
                "lost", oldest - self._next, f"{self._name}: the ring went round before it was read"
            )
            self._next = oldest
        whole: list[Registers] = []
        try:
            await self._read_pages(client, self._next, newest, whole)
        finally:  # what was whole before a failure is as good as any
            if whole:
                self._deliver(self._next, whole)

    def _deliver(self, first: int, whole: list[Registers]) -> None:
        number = (
            self._base
            + first * self._stream.samples
            + np.arange(len(whole) * self._stream.samples, dtype=np.int64)
        )
        self._next = first + len(whole)
        values = self._stream.decode(np.concatenate(whole))
        none = {name: int(np.isnan(its).sum()) for name, its in values.items()}
        self._source.count_no_value({name: count for name, count in none.items() if count})
        self._source.deliver(Block(self._name, number, values), len(whole))

    async def _read_pages(
        self, client: CheckedModbusClient, first: int, end: int, whole: list[Registers]
    ) -> None:
        """Add the samples of pages `first` … `end` − 1 to those that are whole, until one of them
        has been written over.
        """
        for number, count in self._requests(first, end):
            reply = await client.read(*self._place(number, count))
            for k, registers in enumerate(reply.reshape(count, self._stream.page_registers)):
                page = self._checked(number + k, registers)
                if page is None:
                    return
                whole.append(page)

    def _requests(self, first: int, end: int) -> Iterator[tuple[int, int]]:
        """Each read as the first of its pages and how many: neighbours in the ring, as many as one
        read takes.
        """
        while first < end:
            count = min(self._slots, end - first, self._pages.count - first % self._pages.count)
            yield first, count
            first += count

    def _place(self, number: int, count: int) -> tuple[int, int]:
        """Address and registers of the pages from this one on."""
        return (
            self._pages.address + self._pages.stride * (number % self._pages.count),
            count * self._stream.page_registers,
        )

    def _checked(self, number: int, registers: Registers) -> Registers | None:
        """The samples of a page; None when a later page stands in its place: the device was faster,
        and it is lost.
        """
        page = read_page(registers)
        if page is None:
            raise BadReply("corrupt_replies", f"{self._name}, page {number}: the checksum is wrong")
        if page.number > number and (page.number - number) % self._pages.count == 0:
            return None
        if page.number != number:
            raise BadReply(
                "corrupt_replies", f"{self._name}: page {page.number} came, {number} was asked for"
            )
        return page.registers

    async def _newest(self, client: CheckedModbusClient) -> int:
        high, low = (await client.read(self._pages.newest, 2)).tolist()
        return int(high << 16 | low)

    async def _confirm_restart(self, client: CheckedModbusClient, newest: int) -> int:
        """The device counts from 0 again; asked anew and anew, because this number alone has no
        checksum.
        """
        for _ in range(_CONFIRMATIONS):
            again = await self._newest(client)
            if self._next is None or not newest <= again < self._next:
                raise BadReply(
                    "corrupt_replies",
                    f"{self._name}: page numbers {newest} and {again} cannot both be right",
                )
            newest = again
        self._source.health.count(
            "counter_jumps", 1, f"{self._name}: the device began to count anew"
        )
        self._base += BREAK
        self._next = None
        return newest


class _PolledReader:
    """Reads plain registers once a sample time, on the reader's clock; a read that is late leaves a
    hole.
    """

    def __init__(
        self, name: str, stream: StreamRegisters, polled: PolledStream, source: ModbusSource
    ) -> None:
        self.period = stream.sample_time
        self._name, self._polled, self._source = name, polled, source
        self._blocks = polled.blocks()
        self._doubtful, self._stream = DoubtfulChannels(), stream
        self._started: float | None = None
        self._last = -1

    async def read(self, client: CheckedModbusClient) -> None:
        """Deliver one sample when its time has come; what the device refuses is missing in it, and
        counted.
        """
        now = time.monotonic()
        if self._started is None:
            self._started = now
        number = round((now - self._started) / self.period)
        if number <= self._last:
            return
        read, refusals = await read_blocks(client, self._blocks)
        for refusal in refusals:
            self._source.health.count("modbus_exceptions", 1, f"{self._name}: {refusal}")
        if not read:
            return
        if self._last >= 0 and number > self._last + 1:
            self._source.health.count(
                "lost", number - self._last - 1, f"{self._name}: the device was polled too late"
            )
        # also where some registers were refused: their channels are missing in this sample
        self._last = number
        values = self._polled.samples(read)
        readings = readings_of(self._name, self._stream, self._polled, read, values)
        self._source.count_no_value({r.channel: 1 for r in readings if r.remark == MISSING})
        self._doubtful.look(readings)
        self._source.health.doubts[self._name] = self._doubtful.sentences
        self._source.deliver(Block(self._name, np.array([number], np.int64), values), 1)


def _stream_reader(
    name: str, stream: StreamRegisters, base: int, source: ModbusSource
) -> _PagedReader | _PolledReader:
    if stream.pages:
        return _PagedReader(name, stream, stream.pages, source)
    if stream.poll is None:
        raise ValueError(f"stream {name}: neither pages nor poll")
    return _PolledReader(name, stream, PolledStream(stream, stream.poll, base), source)


# Which channels of a polled device look wrong: another order of words is far likelier, or what
# stands there means no value.

# [samples] That are looked at before anything is said.
_JUDGED = 10
# Part of them that has to look wrong: now and then a register may well hold such a number.
_OFTEN = 0.3
# Judgements that a doubt outlasts: a sensor that is there now and then must not turn its channel
# good in between.
_OUTLASTS = 10


class DoubtfulChannels:
    """Readings of one stream counted; `sentences` says what looks wrong, or did lately."""

    def __init__(self) -> None:
        self.sentences: list[str] = []
        self._samples = 0
        self._wrong: Counter[str] = Counter()
        self._remarks: Counter[tuple[str, str]] = Counter()
        self._says: dict[str, tuple[str, int]] = {}

    def look(self, readings: Iterable[ChannelReading]) -> None:
        """Count one sample's readings."""
        self._samples += 1
        for reading in readings:
            if reading.remark not in ("", MISSING):
                self._wrong[reading.channel] += 1
                self._remarks[
                    reading.channel, f"{reading.stream}.{reading.channel}: {reading.remark}"
                ] += 1
        if self._samples % _JUDGED == 0:
            self._judge()

    def _judge(self) -> None:
        """Say of each channel that often looks wrong what is most often said of it, and forget what
        has long been right.
        """
        now: dict[str, tuple[str, int]] = {}
        for (channel, sentence), _ in self._remarks.most_common():
            if self._wrong[channel] >= _OFTEN * _JUDGED:
                now.setdefault(channel, (sentence, self._samples + _OUTLASTS * _JUDGED))
        lately = {
            channel: doubt for channel, doubt in self._says.items() if doubt[1] > self._samples
        }
        self._says = lately | now
        self.sentences = [sentence for sentence, _ in self._says.values()]
        self._wrong, self._remarks = Counter(), Counter()
