"""JudgeAndStore: a window is judged in a worker process and kept with its finding.

Judging begins when the window is handed over, storing when its turn has come: while one window waits for the disk, the next one
is judged.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import structlog

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.machines.scoring import PlainRecord, score_window
from residuum.service.store import StorageUnavailable, Store
from residuum.service.work.worker_pool import WorkerPool

log = structlog.get_logger()

_STORAGE_RETRY = 2.0


class JudgeAndStore:
    """What is done with the windows of machines whose buses this service reads itself.

    Parameters
    ----------
    pool : WorkerPool
        Runs the diagnosers.
    store : Store
        Keeps windows and findings.
    """

    def __init__(self, pool: WorkerPool, store: Store) -> None:
        self._pool, self._store = pool, store

    def __call__(
        self, machine: MachineSettings, window: Record, baseline: str, stopped: threading.Event
    ) -> Callable[[], Finding | None]:
        """Begin to judge; the call that is returned stores the window and gives its finding.

        It gives None when the service stopped before the window could be stored.
        """
        judged = self._pool.begin(score_window, machine.diagnoser, baseline, PlainRecord.of(window), machine.method)

        def store() -> Finding | None:
            finding = judged()
            while True:
                try:
                    self._store.add_window(asset=machine.asset, record=window, finding=finding)
                    return finding
                except StorageUnavailable as error:
                    log.error("window not stored, trying again", machine=machine.asset, reason=str(error))
                    if stopped.wait(_STORAGE_RETRY):
                        return None

        return store
