"""WorkerPool: worker processes that compute for the service, and that are replaced when one of them
dies.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import cache
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from residuum.identification.record import Record

# What the C library does with the memory of large arrays once they are freed: each process says
# which it wants, when it begins.
# A service gives it back to the system at once, so that a burst of requests leaves no mark on it.
# A command that computes for seconds, in a process of its own, keeps it for the next array.

LARGE = 1 << 20
"""Bytes from which an array gets pages of its own in a service."""
# Bytes up to which an array comes from kept memory, and which at most are kept at the end of the
# heap.
_KEPT = 64 << 20
# Names of the settings in glibc's malloc.h.
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8


def give_back_large_arrays() -> bool:
    """Fix the size from which the C library maps allocations apart; False where the library has no
    such setting.

    Left alone, glibc raises this size up to 32 MB with every large array that is freed; such arrays
    then come from the heaps of the threads, which keep what they once held: twenty pages that each
    look at 10⁶ samples left tens of megabytes behind.
    """
    return _set({_MMAP_THRESHOLD: LARGE})


def keep_large_arrays() -> bool:
    """Keep freed memory for the next array; False where the library has no such settings.

    Simulations with sensitivities allocate a few megabytes each, thousands of times: left alone,
    the system gives and takes every page anew, and zeroes it, which is a fifth of the time that
    explaining takes.
    """
    return _set({_MMAP_THRESHOLD: _KEPT, _TRIM_THRESHOLD: _KEPT, _ARENA_MAX: 2})


def _set(settings: Mapping[int, int]) -> bool:
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    return all(mallopt(name, value) for name, value in settings.items())


# A record as it travels to a worker process.

RecordParts = tuple[dict[str, Any], dict[str, str], float, float, tuple[str, ...], str]
"""The arguments of `Record`."""


def parts_of(record: Record, source: str | None = None) -> RecordParts:
    """The record's content, for a worker process; `source` is what results and messages call it
    (default: as the record does).
    """
    named = record.source if source is None else source
    return (
        dict(record.channels),
        dict(record.units),
        record.sample_time,
        record.t0,
        record.notes,
        named,
    )


class PlainRecord(NamedTuple):
    """A window as it travels to who judges it; a record's notes are not needed for that."""

    channels: Mapping[str, npt.NDArray[np.floating[Any]]]
    units: Mapping[str, str]
    sample_time: float
    t0: float
    source: str

    @classmethod
    def of(cls, record: Record) -> PlainRecord:
        """The record's content."""
        return cls(
            dict(record.channels), dict(record.units), record.sample_time, record.t0, record.source
        )

    def record(self) -> Record:
        """The record again."""
        return Record(self.channels, self.units, self.sample_time, t0=self.t0, source=self.source)


T = TypeVar("T")
# Times that work is done whose worker was killed; see `WorkerPool.call`.
_ATTEMPTS = 3
# [s] Between looks at whether the pool was closed while its server loads.
_LOOK = 0.1
_SERVER = multiprocessing.get_context("forkserver")


class WorkerPool(Executor):
    """A process pool that survives a killed worker.

    A pool of the standard library is of no more use once one of its processes has been killed. Here
    the pool is then made anew, and `call` tries again: the work must therefore be such that doing
    it twice does no harm.

    Parameters
    ----------
    workers : int
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._lock = threading.Lock()
        self._closed = False
        self._pool = self._new_pool()
        self._server_ready = _begin_server()
        self.replaced = 0

    @property
    def closed(self) -> bool:
        """Whether it takes no more work."""
        return self._closed

    def _new_pool(self) -> ProcessPoolExecutor:
        # Not forked from here: a fork would take along the threads' locks. A server without threads
        # that has loaded what workers need makes them: a worker then costs some milliseconds
        # instead of the seconds of its imports.
        return ProcessPoolExecutor(self._workers, mp_context=_SERVER, initializer=_begin_worker)

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Hand work to a worker process; waits while the server loads, and gives up when the pool
        is closed meanwhile.
        """
        while not self._server_ready.wait(_LOOK):
            if self._closed:
                raise BrokenProcessPool("the pool was closed before it had begun")
        with self._lock:
            pool = self._pool
        try:
            return pool.submit(fn, *args, **kwargs)
        except BrokenProcessPool:
            self._replace(pool)
            return self._pool.submit(fn, *args, **kwargs)

    def call(self, fn: Callable[..., T], *args: Any) -> T:
        """Do work in a worker process and wait for it; when its worker is killed, do it again
        (three times at most).
        """
        for _ in range(_ATTEMPTS - 1):
            pool = self._pool
            try:
                return self.submit(fn, *args).result()
            except BrokenProcessPool:
                if self._closed:
                    raise
                self._replace(pool)
        return self.submit(fn, *args).result()

    def begin(self, fn: Callable[..., T], *args: Any) -> Callable[[], T]:
        """Hand work to a worker process at once; what is returned waits for it, as `call` does."""
        pool = self._pool
        begun = self.submit(fn, *args)

        def end() -> T:
            try:
                return begun.result()
            except BrokenProcessPool:
                if self._closed:
                    raise
                self._replace(pool)
                return self.call(fn, *args)

        return end

    def _replace(self, broken: ProcessPoolExecutor) -> None:
        with self._lock:
            # all threads whose work was lost come here: the first makes a new pool
            if self._pool is broken and not self._closed:
                broken.shutdown(wait=False, cancel_futures=True)
                self._pool = self._new_pool()
                self.replaced += 1

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the worker processes."""
        with self._lock:
            self._closed = True
        self._pool.shutdown(wait=wait, cancel_futures=cancel_futures)

    def terminate(self) -> None:
        """End the worker processes at once, whatever they are doing; who waits for their work gets
        BrokenProcessPool.
        """
        with self._lock:
            self._closed = True
        workers = list((self._pool._processes or {}).values())
        self._pool.shutdown(wait=False, cancel_futures=True)
        for worker in workers:
            worker.terminate()


@cache
def _begin_server() -> threading.Event:
    """Start the server of workers, once; set when it can make them. Nothing waits for it at the end
    of this process.
    """
    ready = threading.Event()

    def begin() -> None:
        try:
            first = _SERVER.Process(target=_nothing, daemon=True)
            first.start()  # returns when the server has loaded all
            first.join()
        finally:
            ready.set()

    _SERVER.set_forkserver_preload(["residuum.service.fleet.worker_preload"])
    threading.Thread(target=begin, name="server of workers", daemon=True).start()
    return ready


def _nothing() -> None:
    """The first worker's work."""


def _begin_worker() -> None:
    """Ctrl-C is for the service; without the service there is nothing to do."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_the_service, name="end with the service", daemon=True).start()


def _end_with_the_service() -> None:
    """End this worker when the process that it works for has ended, however it did (a kill tells
    nobody).

    A worker waits for work at a pipe whose writing end it holds itself, so the pipe never says that
    nobody is left; and the server of workers stays as long as one of them does.
    """
    service = multiprocessing.parent_process()
    if service is not None:
        service.join()
        os._exit(1)
