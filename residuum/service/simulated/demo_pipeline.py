"""DemoPipeline: a pipeline that also starts simulated machines, trains their diagnosers and watches
them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

import structlog

from residuum.service.alarms.events import Events
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.machines.baselines import baseline_file
from residuum.service.machines.pipeline import Pipeline
from residuum.service.settings import Settings
from residuum.service.simulated.demo import Demo
from residuum.service.storage.disk_store import DiskStore
from residuum.service.store import NotFound
from residuum.service.work.worker_pool import WorkerPool

log = structlog.get_logger()

_TRAIN_AGAIN = "see the log; stop the service and start it again to train once more"


class DemoPipeline(Pipeline):
    """The machines of the settings, and those of the demo.

    `start` returns at once: the demo's machines and the training of their diagnosers go on beside.
    Parameters as `Pipeline`; of the settings `demo_speed` and `demo_opcua` too.
    """

    def __init__(
        self, settings: Settings, store: DiskStore, events: Events, executor: WorkerPool
    ) -> None:
        self._demo = Demo(settings.demo_speed, settings.demo_opcua)
        super().__init__(settings, store, events, executor, self._demo.machines)

    async def start(self) -> None:
        """Begin to read; a machine of the demo is read once it is on its buses."""
        await super().start()
        await asyncio.to_thread(self._demo.start)
        self._tasks += [
            asyncio.create_task(self._read_when_ready(machine)) for machine in self._demo.machines
        ]
        self._tasks.append(asyncio.create_task(self._train_all()))

    def _stops(self) -> list[Callable[[], None]]:
        return [*super()._stops(), self._demo.stop]

    def _described_faults(self, machine: str) -> Mapping[str, Mapping[str, Any]]:
        return self._demo.describe_faults(machine)

    async def _read_when_ready(self, machine: MachineSettings) -> None:
        await asyncio.to_thread(self._demo.wait_until_ready, machine.asset)
        self._lines[machine.asset].start()

    async def _train_all(self) -> None:
        async with asyncio.TaskGroup() as group:
            for machine in self._demo.machines:
                group.create_task(self._train(machine))
        await asyncio.to_thread(self._demo.end_training)

    async def _train(self, machine: MachineSettings) -> None:
        line = self._lines[machine.asset]
        line.set_state("training", 0.0, "waiting to be trained")
        try:
            content = await self._stored_or_trained(machine, line.set_state)
            line.use_baseline(await asyncio.to_thread(baseline_file, self._settings.data, content))
            self._tasks.append(asyncio.create_task(self._find_baseline(machine)))
        except Exception as error:  # the machine's state tells it, and the others go on
            reason = " ".join(f"training failed: {type(error).__name__}: {error}".split())
            log.exception(
                "training failed", machine=machine.asset, reason=reason, way_on=_TRAIN_AGAIN
            )
            line.set_state("failed", 0.0, reason, _TRAIN_AGAIN)

    async def _stored_or_trained(
        self, machine: MachineSettings, tell: Callable[[str, float, str], None]
    ) -> bytes:
        # reads the program's files
        note = await asyncio.to_thread(self._demo.training_key, machine.asset)
        try:
            versions = await asyncio.to_thread(self._store.model_versions, machine.asset)
            # what was stored since, somebody accepted
            if any(version.note == note for version in versions):
                return await asyncio.to_thread(
                    self._store.model_content, machine.asset, versions[0].number
                )
        except NotFound:
            pass
        training = asyncio.create_task(asyncio.to_thread(self._demo.train, machine.asset))
        # also when nobody waits any more
        training.add_done_callback(lambda over: over.cancelled() or over.exception())
        while not (await asyncio.wait([training], timeout=0.5))[0]:
            tell("training", *self._demo.progress(machine.asset))
        content = training.result()
        await asyncio.to_thread(
            self._store.add_model_version, machine.asset, "baseline", content, note
        )
        return content
