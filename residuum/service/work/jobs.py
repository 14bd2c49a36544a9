"""Jobs: long work in processes of its own, with progress, that can be cancelled at any moment."""

from __future__ import annotations

import multiprocessing
import os
import secrets
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from contextvars import copy_context
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from enum import StrEnum
from multiprocessing.connection import Connection
from typing import Any

import structlog

from residuum.identification.discrepancy import compile_ahead
from residuum.identification.errors import SAID_IN, BadInput
from residuum.service.remedies_over_http import as_key
from residuum.service.store import NotFound

# Compiles what explanations need behind the running service, in a process of its own that gives
# way to everything else.

log = structlog.get_logger()

_LOWEST_PRIORITY = 19  # of nice(2)
# [s] For a process to end by itself.
_STOP_TIMEOUT = 3.0


class CompilingBehind:
    """The process that compiles; none where everything was compiled before.

    An explanation that is asked for meanwhile waits for it and says so: nothing is compiled twice.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._stopped = False

    def start(self) -> None:
        """Begin, where there is something to compile."""
        if compile_ahead.is_compiled():
            return
        log.info("compiling behind what the first explanation needs")
        command = [sys.executable, "-m", compile_ahead.__name__, "--with-parent"]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        os.setpriority(os.PRIO_PROCESS, self._process.pid, _LOWEST_PRIORITY)
        threading.Thread(
            target=self._wait, args=(self._process,), name="compiling behind", daemon=True
        ).start()

    def stop(self) -> None:
        """End it; what was compiled by then is kept."""
        self._stopped = True
        if self._process is not None:
            self._process.terminate()
            try:
                self._process.wait(_STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                self._process.kill()

    def _wait(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stderr is not None
        output = process.stderr.read()
        process.wait()
        if process.returncode == 0:
            log.info("compiled what the first explanation needs")
        elif not self._stopped:
            reason = (
                output.decode("utf-8", "replace").strip().rpartition("\n")[-1]
                or f"exit status {process.returncode}"
            )
            log.error("compiling behind failed; the first explanation compiles", reason=reason)


Progress = Callable[[float, str], None]
"""Told by the work how far it is: (share done 0 … 1, what it is doing)."""
Work = Callable[..., Mapping[str, Any]]
"""A function of a module: `work(progress, *arguments)`; arguments and result travel between
processes.
"""
Then = Callable[[Mapping[str, Any]], Mapping[str, Any]]
Announce = Callable[[str, Mapping[str, Any]], None]

_SPAWN = multiprocessing.get_context("spawn")  # a fork would take the threads' locks along
# Jobs that are remembered: their results stay in memory.
_MOST_KEPT = 500


class JobState(StrEnum):
    """How far a job is."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    REFUSED = "refused"
    FAILED = "failed"
    CANCELLED = "cancelled"


OVER = (JobState.DONE, JobState.REFUSED, JobState.FAILED, JobState.CANCELLED)


class TooManyJobs(BadInput):
    """The queue of jobs is full; ask again later."""


@dataclass(frozen=True)
class Job:
    """One job: `refused` is bad input (the message says which), `failed` an internal error."""

    id: str
    kind: str
    state: JobState
    progress: float
    doing: str
    created_at: datetime
    finished_at: datetime | None = None
    result: Mapping[str, Any] | None = None
    error: str | None = None

    def to_json(self, *, with_result: bool = True) -> dict[str, Any]:
        """The job as plain values."""
        plain = asdict(self)
        if not with_result:
            del plain["result"]
        return plain


class Jobs:
    """Runs jobs, a few at a time, each in a worker process; cancelling one ends its process.

    Workers stay warm between jobs (a fresh one costs the imports). A worker that dies takes only
    its own job along.
    """

    def __init__(self, announce: Announce, at_once: int = 2, queued: int = 64) -> None:
        self._announce = announce
        self._jobs: dict[str, Job] = {}
        self._running: dict[str, _Worker] = {}
        self._idle: list[_Worker] = []
        self._lock = threading.RLock()
        self._slots = threading.Semaphore(at_once)
        self._most = at_once + queued
        self._closed = False

    def submit(self, kind: str, work: Work, *arguments: Any, then: Then = dict) -> Job:
        """Queue a job; `then` makes its result of what the work returned, in this process.
        TooManyJobs when the queue is full.
        """
        job = Job(secrets.token_hex(8), kind, JobState.QUEUED, 0.0, "waiting", datetime.now(UTC))
        with self._lock:
            if sum(listed.state not in OVER for listed in self._jobs.values()) >= self._most:
                raise TooManyJobs(
                    f"job {kind!r}: {self._most} are waiting or running; try again later"
                )
            self._forget_oldest()
            self._jobs[job.id] = job
        threading.Thread(
            target=self._run,
            args=(job.id, work, arguments, then),
            name=f"job-{job.id}",
            daemon=True,
        ).start()
        return job

    def get(self, job: str) -> Job:
        """One job; NotFound when it is unknown or forgotten."""
        with self._lock:
            if job not in self._jobs:
                raise NotFound(f"job {job[:40]!r}: there is none of this name")
            return self._jobs[job]

    def list(self) -> Sequence[Job]:
        """All jobs that are remembered, newest first."""
        with self._lock:
            return list(self._jobs.values())[::-1]

    def cancel(self, job: str) -> Job:
        """End a job now; one that is over stays as it is."""
        with self._lock:
            if self.get(job).state in OVER:
                return self._jobs[job]
            changed = self._update(
                job, state=JobState.CANCELLED, doing="cancelled", finished_at=datetime.now(UTC)
            )
            if worker := self._running.get(job):
                worker.kill()
        return changed

    def close(self) -> None:
        """Cancel everything and end the workers."""
        with self._lock:
            self._closed = True
            for job in [job.id for job in self._jobs.values() if job.state not in OVER]:
                self.cancel(job)
            for worker in self._idle:
                worker.kill()

    def _run(self, job: str, work: Work, arguments: tuple[Any, ...], then: Then) -> None:
        with self._slots:
            with self._lock:
                # it may have been cancelled while it waited
                if self._jobs[job].state in OVER or self._closed:
                    return
                worker = self._idle.pop() if self._idle else _Worker()
                self._running[job] = worker
                self._update(job, state=JobState.RUNNING, doing="starting")
            try:
                state, outcome = self._follow(job, worker, (work, arguments))
            finally:  # before the job is over: whoever sees it over finds its worker idle
                with self._lock:
                    del self._running[job]
                    if worker.alive and not self._closed:
                        self._idle.append(worker)
            self._conclude(job, state, outcome, then)

    def _follow(
        self, job: str, worker: _Worker, order: tuple[Work, tuple[Any, ...]]
    ) -> tuple[JobState, Any]:
        """The state that the work ended in, and its result or what it said."""
        try:
            worker.channel.send(order)
            while True:
                kind, *parts = worker.channel.recv()
                if kind != "progress":
                    return JobState(kind), parts[0]
                self._update(job, progress=min(1.0, max(0.0, float(parts[0]))), doing=str(parts[1]))
        except (EOFError, OSError):  # the process is gone: cancelled, or it died
            worker.kill()
            return JobState.FAILED, "the worker process ended unexpectedly (out of memory?)"
        # what cannot travel to the worker: the job has failed, it must not stay running
        except Exception as error:
            worker.kill()
            return JobState.FAILED, f"{type(error).__name__}: {error}"

    def _conclude(self, job: str, state: JobState, outcome: Any, then: Then) -> None:
        if state is JobState.DONE:
            try:
                outcome = then(outcome)
            except BadInput as error:
                state, outcome = JobState.REFUSED, error.told(as_key)
            except Exception as error:
                # what was computed cannot be kept: the job has failed, and says why
                state, outcome = JobState.FAILED, f"{type(error).__name__}: {error}"
        self._finish(job, state, outcome)

    def _finish(self, job: str, state: JobState, outcome: Any) -> None:
        done = state is JobState.DONE
        answer = outcome if done else (str(outcome).strip().splitlines() or [state.value])[-1]
        fields = {"result": answer, "progress": 1.0} if done else {"error": answer}
        ended = self._update(
            job, state=state, doing=state.value, finished_at=datetime.now(UTC), **fields
        )
        # said last: a log that cannot be written must not leave the job running
        if ended.state is JobState.FAILED:
            log.error("job failed", job=job, reason=outcome)

    def _update(self, job: str, **fields: Any) -> Job:
        with self._lock:
            # what a cancelled job's process still tells changes nothing
            if self._jobs[job].state in OVER:
                return self._jobs[job]
            changed = self._jobs[job] = replace(self._jobs[job], **fields)
            # in the order of the changes: the last one is the end
            self._announce("job", changed.to_json(with_result=False))
        return changed

    def _forget_oldest(self) -> None:
        over = [job.id for job in self._jobs.values() if job.state in OVER]
        for job in over[: max(0, len(self._jobs) - _MOST_KEPT)]:
            del self._jobs[job]


class _Worker:
    """A process that works on one job after the other."""

    def __init__(self) -> None:
        self.channel, theirs = _SPAWN.Pipe()
        self._process = _SPAWN.Process(target=_work_on, args=(theirs,), daemon=True)
        self._process.start()
        # else the channel has a second end here, and never says that the process is gone
        theirs.close()
        self.alive = True

    def kill(self) -> None:
        """End the process at once."""
        self.alive = False
        self._process.kill()
        self._process.join(5)


def _work_on(channel: Connection[Any, Any]) -> None:
    """The worker process: take jobs until the service closes the channel."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the service decides when a job ends
    SAID_IN.set(as_key)

    def progress(share: float, doing: str) -> None:
        channel.send(("progress", share, doing))

    with suppress(EOFError, OSError):
        while True:
            work, arguments = channel.recv()
            try:
                # in a context of its own: what a job's model brings, effects of its own above all,
                # is no other job's
                channel.send(
                    (JobState.DONE.value, dict(copy_context().run(work, progress, *arguments)))
                )
            except BadInput as error:
                channel.send((JobState.REFUSED.value, " ".join(str(error).split())))
            except Exception:
                channel.send((JobState.FAILED.value, traceback.format_exc()))
