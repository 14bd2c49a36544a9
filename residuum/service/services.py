"""What a request can reach: the parts of the running service, handed to the HTTP routes by the
app.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ParamSpec, Protocol, TypeVar

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import Depends, Request

from residuum.identification.errors import BadInput
from residuum.service.memory_budget import MIB, MemoryBudget
from residuum.service.security.access import ANYBODY, ApiKeys, Caller

# The parts themselves are made by the app: a route that holds them needs none of their modules.
if TYPE_CHECKING:
    from residuum.service.alarms.alarm_states import AlarmRule
    from residuum.service.alarms.events import Events
    from residuum.service.fieldbus.settings import MachineSettings
    from residuum.service.machines.scoring import Judges
    from residuum.service.metrics import Metrics
    from residuum.service.settings import Settings
    from residuum.service.storage.disk_store import DiskStore
    from residuum.service.work.jobs import Jobs
    from residuum.service.work.worker_pool import WorkerPool

P = ParamSpec("P")
T = TypeVar("T")
# Long bodies that are read at once. A reader may take `upload_memory` and a processor each.
_READERS = 2
# Windows of gateways that are judged and stored at once. Each takes a thread for as long as it waits
# for a worker; in those of all requests, a hundred machines would leave none for the page.
_UNATTENDED = 8
# Bytes that answers may take together while they are made. Without a bound one list took 595 MiB
# and five of them 2.4 GiB; with it, any hundred questions at once take at most 256 MiB (`python -m
# benchmarks.memory_by_question`).
_MEMORY = 160 * MIB
# Bytes that a page of a list takes while it is made: rows of 1 MiB as values of Python, and as
# JSON.
_LISTED = 16 * MIB
# Times its samples that a question about a stored signal takes: the block, what is made of it, the
# answer.
_COPIES = 5
# Bytes that a single answer may take. So that a question about one signal is made of 12.8 MiB of
# samples at most.
_ONE = 64 * MIB


class LivePipeline(Protocol):
    """The part that reads buses and has windows scored
    (`residuum.service.machines.pipeline.Pipeline`).
    """

    async def start(self) -> None:
        """Begin to read; returns at once, training and connecting go on beside."""

    async def stop(self) -> None:
        """Stop reading, keep what is in flight."""

    def status(self) -> dict[str, Any]:
        """State of every machine and source, with every loss counter."""

    def faults(self, machine: str) -> Mapping[str, Any]:
        """The faults a demo machine has, and which are on."""

    async def put_machine(self, machine: MachineSettings) -> None:
        """Watch a machine from now on, or watch it by other settings."""

    async def remove_machine(self, asset: str) -> None:
        """Watch a machine no more."""

    def refuse_fixed(self, asset: str) -> None:
        """Conflict for a machine that cannot be changed while the service runs."""

    def machine(self, asset: str) -> MachineSettings:
        """The settings of a watched machine; NotFound."""

    def live(self, asset: str) -> Mapping[str, Any]:
        """What the signals of a machine read now."""

    def units(self, asset: str) -> Mapping[str, str]:
        """Name and unit of every signal on a machine's buses; NotFound."""

    def alarm_rule(self, asset: str) -> AlarmRule:
        """The rule of a machine's alarms."""

    async def switch_fault(self, machine: str, fault: str, size: float | None) -> None:
        """Switch a fault of a demo machine on (size None: its default), or off (fault `none`, or
        size 0).
        """


@dataclass(frozen=True)
class Services:
    """The running service."""

    settings: Settings
    store: DiskStore
    events: Events
    jobs: Jobs
    judges: Judges
    metrics: Metrics
    pipeline: LivePipeline
    keys: ApiKeys
    workers: WorkerPool
    receiver_troubles: Callable[[], Mapping[str, str]] = dict
    _readers: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(_READERS))
    _unattended: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(_UNATTENDED))
    _writer: CapacityLimiter = field(default_factory=lambda: CapacityLimiter(1))
    _memory: MemoryBudget = field(default_factory=lambda: MemoryBudget(_MEMORY))

    async def listing(self, page: Callable[P, T], *arguments: P.args, **more: P.kwargs) -> T:
        """Make a page of a list in a thread, when there is room for it; TooBusy when there is none
        in time.
        """
        async with self._memory.hold(_LISTED):
            return await run_sync(partial(page, *arguments, **more))

    async def sampling(
        self, size: int, make: Callable[P, T], *arguments: P.args, **more: P.kwargs
    ) -> T:
        """Make something of stored samples of `size` bytes in a thread, when there is room for it;
        TooBusy as `listing`.

        BadInput for so many that this question alone would take too much.
        """
        if _COPIES * size > _ONE:
            raise BadInput(
                f"signal: its samples take {size / MIB:.1f} MiB, and this is made of at most"
                f" {_ONE // _COPIES / MIB:.1f} MiB; ask for the signal itself (GET …/signal), or"
                " take the record (GET …/record) and look at it by the command line"
            )
        async with self._memory.hold(_COPIES * size):
            return await run_sync(partial(make, *arguments, **more))

    async def reading(self, read: Callable[P, T], *arguments: P.args, **more: P.kwargs) -> T:
        """Read something long in a thread, with few others; the rest wait, and take no thread from
        other requests meanwhile.
        """
        return await run_sync(partial(read, *arguments, **more), limiter=self._readers)

    async def judging(self, judge: Callable[P, T], *arguments: P.args, **more: P.kwargs) -> T:
        """Judge and store a window that nobody waits at, with few others; as `reading`."""
        return await run_sync(partial(judge, *arguments, **more), limiter=self._unattended)

    async def writing(self, write: Callable[P, T], *arguments: P.args, **more: P.kwargs) -> T:
        """Write a long answer in a thread, one at a time: each takes memory and disk, and together
        they would take all.
        """
        return await run_sync(partial(write, *arguments, **more), limiter=self._writer)


def caller_of(request: Request) -> Caller:
    """Who sent a request that the gate has let in."""
    caller: Caller = getattr(request.state, "caller", ANYBODY)
    return caller


async def _services(request: Request) -> Services:
    """The services of the app that got the request (async: a plain function would cost a
    thread).
    """
    services: Services = request.app.state.services
    return services


Running = Annotated[Services, Depends(_services)]
