"""JudgeAndStore: a window is judged in a worker process and kept with its finding."""

from __future__ import annotations

import threading

import structlog

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.scoring import PlainRecord, score_window
from residuum.service.store import StorageUnavailable, Store
from residuum.service.worker_pool import WorkerPool

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

    def __call__(self, machine: MachineSettings, window: Record, baseline: str, stopped: threading.Event) -> Finding | None:
        """The stored finding; None when the service stopped before the window could be stored."""
        finding = self._pool.call(score_window, machine.diagnoser, baseline, PlainRecord.of(window))
        while True:
            try:
                self._store.add_window(asset=machine.asset, record=window, finding=finding)
                return finding
            except StorageUnavailable as error:
                log.error("window not stored, trying again", machine=machine.asset, reason=str(error))
                if stopped.wait(_STORAGE_RETRY):
                    return None
