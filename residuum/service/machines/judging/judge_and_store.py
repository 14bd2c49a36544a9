"""JudgeAndStore: a window is judged in a worker process and kept with its finding.

Judging begins when the window is handed over, storing when its turn has come: while one window waits for the disk, the next one
is judged.
"""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable

import structlog

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.machines.baselines.deciding_method import deciding_method
from residuum.service.machines.judging.scoring import PlainRecord, score_window
from residuum.service.machines.judging.second_opinion import with_second_opinion
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
        self.second_baselines: dict[str, str] = {}
        """Machine → file of the baseline of its second opinion, once there is one."""

    def __call__(
        self, machine: MachineSettings, window: Record, baseline: str | None, stopped: threading.Event
    ) -> Callable[[], Finding | None]:
        """Begin to judge; the call that is returned stores the window and gives its finding.

        Without a baseline nothing is judged: the window is kept, so that one can be trained.
        It gives None when the service stopped before the window could be stored.
        """
        judged = self._judged(machine, window, baseline)

        def store() -> Finding | None:
            finding, key = judged(), secrets.token_hex(16)  # tried again under one key: a first try may have been kept
            while True:
                try:
                    self._store.add_window(asset=machine.asset, record=window, finding=finding, idempotency_key=key)
                    return finding
                except StorageUnavailable as error:
                    log.error("window not stored, trying again", machine=machine.asset, reason=str(error))
                    if stopped.wait(_STORAGE_RETRY):
                        return None

        return store

    def _method(self, machine: MachineSettings) -> str | None:
        """What decides: as chosen for the machine while the service runs, else as its settings say."""
        try:
            return deciding_method(self._store, machine.asset, machine.diagnoser, machine.method)
        except StorageUnavailable:  # the window is judged all the same, and stored when the store is back
            return machine.method

    def _judged(self, machine: MachineSettings, window: Record, baseline: str | None) -> Callable[[], Finding]:
        if baseline is None:
            return lambda: Finding.recorded(machine.diagnoser)
        plain = PlainRecord.of(window)
        first = self._pool.begin(score_window, machine.diagnoser, baseline, plain, self._method(machine))
        second = self.second_baselines.get(machine.asset)
        if machine.second is None or second is None:
            return first
        other = self._pool.begin(score_window, machine.second.diagnoser, second, plain, None)
        return lambda: with_second_opinion(first(), other())
