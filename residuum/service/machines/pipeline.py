"""Pipeline: the machines that are watched, from their buses to stored findings."""

from __future__ import annotations

import asyncio
import secrets
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import structlog

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.nearest_names import known_names
from residuum.service.alarms.alarm_states import AlarmRule
from residuum.service.alarms.events import Events
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.fieldbus.source import FaultsUnavailable, Source
from residuum.service.machines.adding import kept_machines
from residuum.service.machines.baselines import (
    baseline_file,
    deciding_method,
    newest_baseline,
    second_name,
    with_second_opinion,
)
from residuum.service.machines.machine_line import MachineLine, unreadable
from residuum.service.machines.scoring import score_window
from residuum.service.settings import Settings
from residuum.service.storage.disk_store import DiskStore
from residuum.service.store import Conflict, NotFound, StorageUnavailable
from residuum.service.work.worker_pool import PlainRecord, WorkerPool

# JudgeAndStore: a window is judged in a worker process and kept with its finding.
# Judging begins when the window is handed over, storing when its turn has come: while one window
# waits for the disk, the next one is judged.

log = structlog.get_logger()

# [s] Between two tries to store a window while the database is away.
_STORAGE_RETRY = 2.0


class JudgeAndStore:
    """What is done with the windows of machines whose buses this service reads itself.

    Parameters
    ----------
    pool : WorkerPool
        Runs the diagnosers.
    store : DiskStore
        Keeps windows and findings.
    """

    def __init__(self, pool: WorkerPool, store: DiskStore, *, fmus: bool = False) -> None:
        self._pool, self._store, self._fmus = pool, store, fmus
        self.second_baselines: dict[str, str] = {}
        """Machine → file of the baseline of its second opinion, once there is one."""

    def __call__(
        self,
        machine: MachineSettings,
        window: Record,
        baseline: str | None,
        stopped: threading.Event,
    ) -> Callable[[], Finding | None]:
        """Begin to judge; the call that is returned stores the window and gives its finding.

        Without a baseline nothing is judged: the window is kept, so that one can be trained.
        It gives None when the service stopped before the window could be stored.
        """
        judged = self._judged(machine, window, baseline)

        def store() -> Finding | None:
            # tried again under one key: a first try may have been kept
            finding, key = (judged(), secrets.token_hex(16))
            while True:
                try:
                    self._store.add_window(
                        asset=machine.asset, record=window, finding=finding, idempotency_key=key
                    )
                    return finding
                except StorageUnavailable as error:
                    log.error(
                        "window not stored, trying again", machine=machine.asset, reason=str(error)
                    )
                    if stopped.wait(_STORAGE_RETRY):
                        return None

        return store

    def _method(self, machine: MachineSettings) -> str | None:
        """What decides: as chosen for the machine while the service runs, else as its settings
        say.
        """
        try:
            return deciding_method(self._store, machine.asset, machine.diagnoser, machine.method)
        except StorageUnavailable:
            # the window is judged all the same, and stored when the store is back
            return machine.method

    def _judged(
        self, machine: MachineSettings, window: Record, baseline: str | None
    ) -> Callable[[], Finding]:
        if baseline is None:
            return lambda: Finding.recorded(machine.diagnoser)
        # both opinions are under way at once, in worker processes
        plain = PlainRecord.of(window)
        first = self._pool.begin(
            *(score_window, machine.diagnoser, baseline, plain),
            *(self._method(machine), self._fmus),
        )
        second = self.second_baselines.get(machine.asset)
        if machine.second is None or second is None:
            return first
        opinion = self._pool.begin(
            score_window, machine.second.diagnoser, second, plain, None, self._fmus
        )
        return lambda: with_second_opinion(first(), opinion())


# [s] Between looks for a newer baseline, which a command or another process may have stored.
_LOOK_FOR_BASELINE = 2.0
# Seconds between looks at which machines have come to a stop or gone on, which no event of theirs
# tells.
_LOOK_AT_STATES = 1.0


class Pipeline:
    """Reads the buses of all machines, has their windows judged, and stores what was found.

    `start` returns at once: connecting goes on beside.

    Parameters
    ----------
    settings : Settings
        Its `machines` are watched.
    store : DiskStore
    events : Events
        Told `pipeline` whenever a machine's state changes.
    executor : WorkerPool
    beside : sequence of MachineSettings
        Machines that are watched once whoever gives them begins to: their buses are not there yet.
    """

    def __init__(
        self,
        settings: Settings,
        store: DiskStore,
        events: Events,
        executor: WorkerPool,
        beside: Sequence[MachineSettings] = (),
    ) -> None:
        self._settings, self._store, self._events, self._pool = settings, store, events, executor
        self._beside = beside
        machines = [*settings.machines, *beside]
        names = [machine.asset for machine in machines]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise BadInput(
                f"settings, machines: {', '.join(sorted(twice))}: there are two of this name"
            )
        self._of_settings = frozenset(names)
        self._handle = JudgeAndStore(executor, store, fmus=settings.allow_fmus)
        self._lines = {
            machine.asset: MachineLine(machine, self._handle, self._announce)
            for machine in machines
        }
        self._unreadable: dict[str, dict[str, Any]] = {}
        self._tasks: list[asyncio.Task[None]] = []
        self._watched: dict[str, asyncio.Task[None]] = {}
        self._changing = asyncio.Lock()

    async def start(self) -> None:
        """Begin to read; everything else goes on beside."""
        await asyncio.to_thread(self._add_kept)
        for line in self._lines.values():
            self._store.ensure_asset(line.settings.asset, diagnoser=line.settings.diagnoser)
        for name, line in self._lines.items():
            if line.settings not in self._beside:
                self._watch(name)
        self._tasks.append(asyncio.create_task(self._watch_states()))

    async def stop(self) -> None:
        """Stop reading, give what is being judged three seconds to finish, and end all worker
        processes.
        """
        for task in (*self._tasks, *self._watched.values()):
            task.cancel()
        stops = self._stops()
        if stops:
            # of their own: those of the loop may all wait for what is stopped here
            threads = ThreadPoolExecutor(len(stops))
            await asyncio.gather(
                *(asyncio.get_running_loop().run_in_executor(threads, stop) for stop in stops)
            )
            threads.shutdown(wait=False)
        self._pool.terminate()

    def _stops(self) -> list[Callable[[], None]]:
        """What is stopped with the pipeline, all side by side."""
        return [line.stop for line in self._lines.values()]

    def _add_kept(self) -> None:
        """The machines that were added while the service ran; one that can no longer be read is
        left out and logged.
        """
        for machine in kept_machines(self._store, self._settings):
            if machine.asset in self._lines:
                log.warning(
                    "a machine of the settings stands before one of this name that was added",
                    machine=machine.asset,
                )
                continue
            try:
                self._lines[machine.asset] = MachineLine(machine, self._handle, self._announce)
            except BadInput as error:
                self._unreadable[machine.asset] = unreadable(machine, str(error))
                log.error(
                    "a machine that was added cannot be read",
                    machine=machine.asset,
                    reason=str(error),
                )

    async def _watch_states(self) -> None:
        """Tell what time alone changed, and log which machines are not judged and why, and which
        are again.
        """
        troubled: set[str] = set()
        while True:
            for asset, line in list(self._lines.items()):
                state = line.tell_of_time()
                if state is None:
                    continue
                if state.way_on:
                    troubled.add(asset)
                    details = {
                        "machine": asset,
                        "state": state.state,
                        "reason": state.doing,
                        "way_on": state.way_on,
                    }
                    log.error("a machine is not judged", **details)
                elif state.state == "running" and asset in troubled:
                    troubled.discard(asset)
                    log.info("a machine is judged again", machine=asset)
            await asyncio.sleep(_LOOK_AT_STATES)

    def _watch(self, asset: str) -> None:
        line = self._lines[asset]
        line.start()
        self._watched[asset] = asyncio.create_task(self._find_baseline(line.settings))

    async def put_machine(self, machine: MachineSettings) -> None:
        """Watch a machine from now on, or watch it by other settings; Conflict for one of the
        settings or the demo.
        """
        self.refuse_fixed(machine.asset)
        # one change a time, and the new line is made before the old one ends: settings that are
        # refused leave the machine watched as it was
        async with self._changing:
            line = await asyncio.to_thread(MachineLine, machine, self._handle, self._announce)
            await self._end(machine.asset)
            await asyncio.to_thread(
                self._store.ensure_asset, machine.asset, diagnoser=machine.diagnoser
            )
            self._lines[machine.asset] = line
            self._unreadable.pop(machine.asset, None)
            self._watch(machine.asset)
        self._announce(machine.asset)

    async def remove_machine(self, asset: str) -> None:
        """Watch a machine no more; what was found of it stays."""
        self.refuse_fixed(asset)
        self._line(asset)
        async with self._changing:
            await self._end(asset)

    async def _end(self, asset: str) -> None:
        task = self._watched.pop(asset, None)
        if task is not None:
            task.cancel()
        line = self._lines.pop(asset, None)
        if line is not None:
            await asyncio.to_thread(line.stop)

    def refuse_fixed(self, asset: str) -> None:
        """Conflict for a machine that stands in the settings' file or belongs to the demo."""
        if asset in self._of_settings:
            raise Conflict(
                f"machine {asset!r}: stands in the settings' file or is the demo's; change it there"
            )

    def machine(self, asset: str) -> MachineSettings:
        """The settings of a watched machine; NotFound."""
        return self._line(asset).settings

    def live(self, asset: str) -> Mapping[str, Any]:
        """What the signals of a machine read now: unit, value and the last half minute of each;
        NotFound.
        """
        units = self.units(asset)
        return {
            name: {"unit": units.get(name, ""), **value}
            for name, value in self._line(asset).live.now().items()
        }

    def units(self, asset: str) -> Mapping[str, str]:
        """Name and unit of every signal on a machine's buses; NotFound."""
        sources = self._line(asset).sources
        return {
            name: unit
            for source in sources
            for stream in source.streams
            for name, unit in stream.units.items()
        }

    def alarm_rule(self, asset: str) -> AlarmRule:
        """The rule of a machine's alarms: its own, or that of the service."""
        rule = self._settings.alarms
        return self._lines[asset].settings.alarm_rule(rule) if asset in self._lines else rule

    def _line(self, asset: str) -> MachineLine:
        if asset not in self._lines:
            raise NotFound(
                f"machine {asset!r}: there is none of this name; {known_names(asset, self._lines)}"
            )
        return self._lines[asset]

    def status(self) -> dict[str, Any]:
        """State of every machine, and rates and loss counters of every source."""
        return {
            "machines": (
                {name: line.status() for name, line in self._lines.items()} | self._unreadable
            ),
            "sources": {
                name: state
                for line in self._lines.values()
                for name, state in line.source_status().items()
            },
        }

    def faults(self, machine: str) -> Mapping[str, Any]:
        """The faults that a simulated machine offers, and the sizes of those that it reports as
        on.
        """
        source = self._fault_source(machine)
        on = dict(source.fault_sizes)
        described = self._described_faults(machine)
        return {
            "machine": machine,
            "faults": [
                {"id": fault, **described.get(fault, {}), "on": fault in on, "size": on.get(fault)}
                for fault in source.fault_ids
            ],
        }

    def _described_faults(self, _machine: str) -> Mapping[str, Mapping[str, Any]]:
        """Default size, unit and meaning of each fault, where somebody knows them."""
        return {}

    async def switch_fault(self, machine: str, fault: str, size: float | None) -> None:
        """Send the order over the machine's own bus: `none` clears all; size None takes the
        default, 0 clears.
        """
        source = self._fault_source(machine)
        if fault != "none" and fault not in source.fault_ids:
            raise BadInput(
                f"machine {machine!r}: has no fault {fault!r};"
                f" {known_names(fault, ['none', *source.fault_ids])}"
            )
        orders = (
            [(name, 0.0) for name in source.fault_ids]
            if fault == "none"
            else [(fault, -1.0 if size is None else size)]
        )
        try:
            for name, wanted in orders:
                await asyncio.to_thread(source.switch_fault, name, wanted)
        except FaultsUnavailable as error:
            raise BadInput(str(error)) from None

    def _fault_source(self, machine: str) -> Source:
        sources = [source for source in self._line(machine).sources if source.fault_ids]
        if not sources:
            raise NotFound(
                f"machine {machine!r}: is not a simulated one; it has no faults to switch"
            )
        return sources[0]

    def _announce(self, asset: str) -> None:
        self._events.publish("pipeline", {"machine": asset, **self._lines[asset].status()})

    async def _find_baseline(self, machine: MachineSettings) -> None:
        """Wait until the machine's baseline is in the store, and take up each new version of it."""
        line, known, second = self._lines[machine.asset], "", ""
        while True:
            try:
                version = await asyncio.to_thread(
                    newest_baseline, self._store, machine.asset, machine.baseline
                )
                if version.checksum != known:
                    content = await asyncio.to_thread(
                        self._store.model_content, version.model, version.number
                    )
                    line.use_baseline(
                        await asyncio.to_thread(baseline_file, self._settings.data, content)
                    )
                    known = version.checksum
            except NotFound:
                recorded = await asyncio.to_thread(self._store.recorded_windows, machine.asset)
                line.record_windows(waits_for_baseline(machine, len(recorded)))
            # the disk may come back: ask again; whatever it is, the machine is not given up
            except Exception as error:
                log.exception("baseline not taken up", machine=machine.asset, reason=str(error))
                if not known:
                    line.set_state(
                        "failed",
                        0.0,
                        f"its baseline cannot be taken up: {error}",
                        "see the log; it is tried again",
                    )
            second = await self._look_for_second(machine, second)
            await asyncio.sleep(_LOOK_FOR_BASELINE)

    async def _look_for_second(self, machine: MachineSettings, known: str) -> str:
        """Take up a new version of the baseline of a machine's second opinion; gives the checksum
        that is at work.
        """
        if machine.second is None:
            return known
        try:
            name = await asyncio.to_thread(
                second_name, self._store, machine.asset, machine.second.baseline
            )
            version = (await asyncio.to_thread(self._store.model_versions, name))[0]
            if version.checksum == known:
                return known
            content = await asyncio.to_thread(
                self._store.model_content, version.model, version.number
            )
            file = await asyncio.to_thread(baseline_file, self._settings.data, content)
        except (NotFound, OSError, StorageUnavailable):
            # there is none yet, or the disk may come back: ask again
            return known
        self._handle.second_baselines[machine.asset] = file
        return version.checksum


def waits_for_baseline(machine: MachineSettings, recorded: int) -> str:
    """How a machine that has no baseline comes to one."""
    windows = "1 window" if recorded == 1 else f"{recorded} windows"
    return (
        f"waiting for a baseline: {windows} recorded, train with: residuum watch train"
        f" {machine.asset}"
    )
